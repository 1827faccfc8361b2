"""A picture of what an animal's success depends on: parameters as bars, the strongest on top."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from evo_cpg.analysis.sensitivity import CHANGE, Sensitivity
from evo_cpg.files import in_one_piece
from evo_cpg.view.legible import legible
from evo_cpg.view.output import PLOT_SUFFIXES, output_path

_INK, _GREY = "#1f2937", "#6b7280"
_MORE, _LESS, _DOUBTFUL = "#0072B2", "#D55E00", "#d1d5db"

# Of the picture: its width, and the height of a bar and of all else, inches.
_WIDTH, _BAR, _REST = 8.6, 0.27, 1.9


def plot_sensitivities(
    rows: Sequence[Sensitivity],
    measure: str,
    title: str,
    path: str | os.PathLike[str],
    most: int = 25,
) -> Path:
    """Draw elasticities as bars; what is not confirmed is grey and shows the change found.

    Parameters that are 0 have no elasticity and are left out.

    Args:
        rows: in the order in which they are drawn, from the top.
        measure: what it is of.
        title: above the picture.
        path: ``.png``, ``.svg`` or ``.pdf``.
        most: bars to draw.

    Returns:
        The path.

    Raises:
        OutputError: nothing can be written there, or not this kind of file.
    """
    path = output_path(path, PLOT_SUFFIXES)
    shown = [row for row in rows if row.value][:most]
    figure = Figure(figsize=(_WIDTH, _REST + _BAR * len(shown)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    lengths = np.array([row.elasticity if row.confirmed else row.finite for row in shown])
    lengths = np.where(np.isfinite(lengths), lengths, 0.0)
    places = np.arange(len(shown))
    colours = [
        (_MORE if length > 0 else _LESS) if row.confirmed else _DOUBTFUL
        for row, length in zip(shown, lengths, strict=True)
    ]
    axes.barh(places, lengths, 0.66, color=colours, zorder=2)
    finite = np.array([row.finite for row in shown])
    axes.plot(finite, places, "d", ms=5, mfc="white", mec=_INK, mew=1.0, zorder=3)
    axes.axvline(0, color=_INK, lw=0.9, zorder=4)
    axes.set_yticks(places, [_label(row) for row in shown], fontsize=8.5, color=_INK)
    axes.tick_params(axis="y", length=0)
    axes.invert_yaxis()
    axes.margins(x=0.06, y=0.01)
    axes.set_xlabel(f"change of the {measure} (%) where the parameter grows by 1 %", color=_INK)
    axes.set_title(
        legible(title), parse_math=False, fontsize=12, fontweight="bold", color=_INK, pad=12
    )
    axes.grid(axis="x", color="#e5e7eb", lw=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right", "left"]].set_visible(False)
    figure.legend(handles=_legend(), loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    with in_one_piece(path) as partial:
        figure.savefig(partial, dpi=160)
    return path


def _label(row: Sensitivity) -> str:
    return f"{legible(row.key)} = {row.value:.4g}"


def _legend() -> list[Patch | Line2D]:
    return [
        Patch(color=_MORE, label="derivative: more is faster"),
        Patch(color=_LESS, label="derivative: more is slower"),
        Line2D(
            [],
            [],
            ls="",
            marker="d",
            mfc="white",
            mec=_INK,
            ms=6,
            label=f"run anew with \N{PLUS-MINUS SIGN}{CHANGE:.0%}",
        ),
        Patch(color=_DOUBTFUL, label="derivative does not say what that does"),
    ]
