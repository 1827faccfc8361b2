"""A picture of an audit: where the energy goes, how much of the way is kept where, and MuJoCo."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from evo_cpg.analysis.energy import Ledger
from evo_cpg.analysis.verdict import Check
from evo_cpg.files import in_one_piece
from evo_cpg.view.legible import legible
from evo_cpg.view.output import PLOT_SUFFIXES, output_path

_INK, _GREY, _LINES = "#1f2937", "#6b7280", "#e5e7eb"
_PASSED, _FAILED, _REPORTED = "#009E73", "#D55E00", "#9ca3af"

# Okabe and Ito's palette: what does work in a trial, by its name in the ledger.
_WORKERS = {
    "motors": ("motors", "#0072B2"),
    "dampers": ("dampers of joints", "#56B4E9"),
    "limits": ("limits of joints", "#CC79A7"),
    "lift": ("ground, upwards", "#b45309"),
    "friction": ("ground, friction", "#E69F00"),
    "limbs": ("limbs that meet", "#5b2a86"),
    "water": ("water", "#009E73"),
    "own": ("force laws of your own", "#7A5C00"),
    "pushes": ("pushes of chance", _GREY),
}

# Of the same palette: this program, and as many opinions of MuJoCo's as there may be.
_OPINIONS = (_INK, "#0072B2", "#56B4E9", "#E69F00")

# The picture, inches: its width, the height of its upper row, of a bar, and of what is around bars.
_WIDTH, _UPPER, _BAR, _REST = 10.0, 3.9, 0.3, 1.2

# A trial is drawn with so many points.
_POINTS = 1000


def plot_audit(
    ledger: Ledger,
    step: float,
    kept: Sequence[Check],
    paths: Mapping[str, Float[np.ndarray, "3 t"]],
    title: str,
    path: str | os.PathLike[str],
) -> Path:
    """Draw an audit.

    Args:
        ledger: of a trial.
        step: length of its physics steps, s.
        kept: checks that are shares of the way.
        paths: of the root, by program, m; none where MuJoCo was not asked.
        title: above the picture.
        path: ``.png``, ``.svg`` or ``.pdf``.

    Returns:
        The path.

    Raises:
        OutputError: nothing can be written there, or not this kind of file.
    """
    path = output_path(path, PLOT_SUFFIXES)
    lower = _REST + _BAR * len(kept)
    figure = Figure(figsize=(_WIDTH, _UPPER + lower), layout="constrained")
    FigureCanvasAgg(figure)
    places = figure.add_gridspec(2, 2, height_ratios=(_UPPER, lower), width_ratios=(4, 3))
    # Without a second opinion there are no paths to compare.
    _draw_energy(figure.add_subplot(places[0, 0] if paths else places[0, :]), ledger, step)
    if paths:
        _draw_paths(figure.add_subplot(places[0, 1]), paths)
    _draw_shares(figure.add_subplot(places[1, :]), kept)
    figure.suptitle(legible(title), parse_math=False, fontsize=13, fontweight="bold", color=_INK)
    with in_one_piece(path) as partial:
        figure.savefig(partial, dpi=160)
    return path


def _draw_energy(axes: Axes, ledger: Ledger, step: float) -> None:
    """Work done so far, by what does it."""
    time = step * (1 + np.arange(len(ledger.stored)))
    each = slice(None, None, max(1, len(time) // _POINTS))
    for name, (label, colour) in _WORKERS.items():
        work = ledger.work[name]
        if np.any(work):
            axes.plot(time[each], np.cumsum(work)[each], color=colour, lw=1.5, label=label)
    left_over = np.cumsum(ledger.left_over)[each]
    axes.plot(time[each], left_over, color=_INK, lw=2.2, label="the simulator's own")
    axes.axhline(0, color=_GREY, lw=0.8)
    axes.set_xlabel("time (s)", color=_INK)
    axes.set_ylabel("work so far (J)", color=_INK)
    axes.set_title("Where the energy comes from and goes", fontsize=11, color=_INK)
    axes.legend(frameon=False, fontsize=8, loc="best")
    _bare(axes)


def _draw_paths(axes: Axes, paths: Mapping[str, Float[np.ndarray, "3 t"]]) -> None:
    """Seen from above: where the root goes in two programs."""
    axes.set_title("Ways of the root, from above", fontsize=11, color=_INK)
    for (name, path), colour in zip(paths.items(), _OPINIONS[: len(paths)], strict=True):
        axes.plot(path[0], path[1], color=colour, lw=1.6, label=name)
        axes.plot(*path[:2, -1], "o", color=colour, ms=5)
    first = next(iter(paths.values()))
    axes.plot(*first[:2, 0], "s", color=_INK, ms=5, mfc="white", label="start")
    axes.set_aspect("equal", adjustable="box")
    every = np.concatenate([path[:2] for path in paths.values()], 1)
    middle, half = (every.max(1) + every.min(1)) / 2, 0.55 * np.ptp(every, 1).max() + 0.05
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)
    axes.set_xlabel("x (m)", color=_INK)
    axes.set_ylabel("y (m)", color=_INK)
    axes.legend(frameon=False, fontsize=8, loc="best")
    _bare(axes)


def _draw_shares(axes: Axes, kept: Sequence[Check]) -> None:
    """Shares of the way as bars, with what is asked for."""
    colours = {True: _PASSED, False: _FAILED, None: _REPORTED}
    places = np.arange(len(kept))
    shares = np.nan_to_num([100 * check.measured for check in kept])
    axes.barh(places, shares, 0.62, color=[colours[check.passed] for check in kept], zorder=2)
    for place, check in zip(places, kept, strict=True):
        if check.limit is not None:
            ends = [place - 0.42, place + 0.42]
            axes.plot([100 * check.limit] * 2, ends, color=_INK, lw=2, zorder=3)
            side = ">" if check.least else "<"
            axes.annotate(
                f"{side} {100 * check.limit:.0f}",
                (100 * check.limit, place),
                (4, 0),
                textcoords="offset points",
                va="center",
                fontsize=8,
                color=_INK,
                zorder=4,
            )
    axes.set_yticks(places, [check.question for check in kept], fontsize=9, color=_INK)
    axes.tick_params(axis="y", length=0)
    axes.invert_yaxis()
    axes.set_xlim(0, 105)
    axes.set_xlabel("share of the way as it evolved (%)", color=_INK)
    _bare(axes)


def _bare(axes: Axes) -> None:
    axes.grid(color=_LINES, lw=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(colors=_GREY)
