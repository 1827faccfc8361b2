"""A sweep in one figure: how fitness rises under every setting, and what the runs came to."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import matplotlib
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from evo_cpg.files import in_one_piece
from evo_cpg.view.legible import legible
from evo_cpg.view.output import PLOT_SUFFIXES, output_path

_INK, _LINES = "#1f2937", "#e5e7eb"

# Okabe and Ito's palette, as far as it is told from white; further settings take another one.
_PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#1f2937")

# Inches: the width of the figure, its least height, and the height of a setting.
_WIDTH, _LEAST, _ROW, _REST = 11.0, 4.2, 0.34, 1.3

# Longest name that is written beside the runs.
_LONGEST = 34


class Curves(NamedTuple):
    """The runs of one setting.

    Attributes:
        name: of the setting.
        evaluations: individuals that had been tried after every generation.
        best: fitness of the best so far, of every run, as evaluated in training; NaN before there
            is one.
        final: what the runs came to: their champions' fitness, under noise its mean in fresh draws
            of chance; NaN of a run without one.
    """

    name: str
    evaluations: Float[np.ndarray, " generations"]
    best: Float[np.ndarray, "runs generations"]
    final: Float[np.ndarray, " runs"]


def plot_sweep(curves: Sequence[Curves], title: str, path: str | os.PathLike[str]) -> Path:
    """Draw a sweep.

    On the left the best so far against the evaluations, the median of the runs and the band in
    which half of them lie; on the right every run's champion, with the median.

    Args:
        curves: of the settings, in the order in which they are shown.
        title: above the figure.
        path: ``.png``, ``.svg`` or ``.pdf``.

    Returns:
        The path.

    Raises:
        OutputError: nothing can be written there, or not this kind of file.
    """
    path = output_path(path, PLOT_SUFFIXES)
    colours = _colours(len(curves))
    figure = Figure((_WIDTH, max(_LEAST, _REST + _ROW * len(curves))), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1))
    for curve, colour in zip(curves, colours, strict=True):
        _draw_curve(left, curve, colour)
    left.set_xlabel("evaluations in a run")
    left.set_ylabel("fitness of the best so far")
    _draw_ends(right, curves, colours)
    for axes in (left, right):
        axes.grid(color=_LINES, lw=0.7)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    figure.suptitle(legible(title), color=_INK, fontsize=11)
    with in_one_piece(path) as partial:
        figure.savefig(partial, dpi=160)
    return path


def _draw_curve(axes: Axes, curve: Curves, colour) -> None:
    known = np.isfinite(curve.best).any(0)
    if not known.any():
        return
    instants = curve.evaluations[known]
    low, median, high = np.nanquantile(curve.best[:, known], (0.25, 0.5, 0.75), axis=0)
    axes.fill_between(instants, low, high, color=colour, alpha=0.16, lw=0)
    axes.plot(instants, median, color=colour, lw=1.8)


def _draw_ends(axes: Axes, curves: Sequence[Curves], colours: Sequence) -> None:
    rng = np.random.default_rng(0)
    for row, (curve, colour) in enumerate(zip(curves, colours, strict=True)):
        final = curve.final[np.isfinite(curve.final)]
        if not final.size:
            continue
        beside = row + 0.22 * (rng.random(final.size) - 0.5)
        axes.plot(final, beside, "o", ms=5, mfc=colour, mec="white", mew=0.6, alpha=0.85)
        axes.plot([np.median(final)] * 2, [row - 0.32, row + 0.32], color=colour, lw=2.6)
    axes.set_yticks(range(len(curves)), [_label(curve) for curve in curves], fontsize=9)
    axes.set_ylim(len(curves) - 0.4, -0.6)
    # Long numbers run into each other where there are many.
    axes.xaxis.set_major_locator(MaxNLocator(4))
    axes.set_xlabel("fitness of the champions (line: median)")


def _label(curve: Curves) -> str:
    name = legible(curve.name)
    name = name if len(name) <= _LONGEST else f"{name[: _LONGEST - 1]}..."
    return f"{name}  (n = {int(np.isfinite(curve.final).sum())})"


def _colours(count: int) -> Sequence:
    if count <= len(_PALETTE):
        return _PALETTE[:count]
    return list(matplotlib.colormaps["turbo"](np.linspace(0.05, 0.95, count)))
