"""Draw an audit: energy by source, displacement kept in other trials, and paths from MuJoCo."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from evo_cpg.analysis.energy import Ledger
from evo_cpg.analysis.verdict import Check
from evo_cpg.view.figure import (
    BLUE,
    GREEN,
    GREY,
    INK,
    LIGHT_GREY,
    ORANGE,
    PINK,
    RED,
    SKY,
    framed,
    name_rows,
    new_figure,
)

# Label and colour of each kind of work, by its name in the ledger.
_WORKERS = {
    "motors": ("motors", BLUE),
    "dampers": ("joint dampers", SKY),
    "limits": ("joint limits", PINK),
    "lift": ("ground, normal forces", "#b45309"),
    "friction": ("ground, friction", ORANGE),
    "limbs": ("limb contacts", "#5b2a86"),
    "water": ("water", GREEN),
    "own": ("force laws of your own", "#7A5C00"),
    "pushes": ("random pushes", GREY),
}

# Colours of this program's path and of at most three paths from MuJoCo.
_OPINIONS = (INK, BLUE, SKY, ORANGE)

# Sizes in inches: width, height of the upper row, height of a bar, and height around the bars.
_WIDTH, _UPPER, _BAR, _REST = 10.0, 3.9, 0.3, 1.2

# About the largest number of points of a curve over a trial.
_POINTS = 1000


@framed
def audit_figure(
    ledger: Ledger,
    step: float,
    kept: Sequence[Check],
    paths: Mapping[str, Float[np.ndarray, "3 t"]],
    title: str,
) -> Figure:
    """Draw the energy, the paths and the displacements of an audit.

    Args:
        ledger: energy ledger of a trial.
        step: length of the trial's physics steps, s.
        kept: checks of trials under changed conditions, as fractions of the original displacement.
        paths: path of the root by program, m. Empty if MuJoCo was not run.
        title: text above the picture.
    """
    lower = _REST + _BAR * len(kept)
    figure = new_figure(_WIDTH, _UPPER + lower, title)
    places = figure.add_gridspec(2, 2, height_ratios=(_UPPER, lower), width_ratios=(4, 3))
    # Without MuJoCo there are no paths to compare, and the energy takes the whole row.
    _draw_energy(figure.add_subplot(places[0, 0] if paths else places[0, :]), ledger, step)
    if paths:
        _draw_paths(figure.add_subplot(places[0, 1]), paths)
    _draw_fractions(figure.add_subplot(places[1, :]), kept)
    for axes in figure.axes:
        axes.grid()
    return figure


def _draw_energy(axes: Axes, ledger: Ledger, step: float) -> None:
    """Draw the cumulative work of each contribution."""
    time = step * (1 + np.arange(len(ledger.stored)))
    each = slice(None, None, max(1, len(time) // _POINTS))
    for name, (label, color) in _WORKERS.items():
        work = ledger.work[name]
        if np.any(work):
            axes.plot(time[each], np.cumsum(work)[each], color=color, lw=1.5, label=label)
    left_over = np.cumsum(ledger.left_over)[each]
    axes.plot(time[each], left_over, color=INK, lw=2.2, label="unexplained (simulator error)")
    axes.axhline(0, color=GREY, lw=0.8)
    axes.set_xlabel("time (s)")
    axes.set_ylabel("cumulative work (J)")
    axes.set_title("Sources and sinks of energy")
    axes.legend(fontsize=8)


def _draw_paths(axes: Axes, paths: Mapping[str, Float[np.ndarray, "3 t"]]) -> None:
    """Draw the root's path in each program, from above."""
    axes.set_title("Paths of the root, from above")
    for (name, path), color in zip(paths.items(), _OPINIONS[: len(paths)], strict=True):
        axes.plot(path[0], path[1], color=color, lw=1.6, label=name)
        axes.plot(*path[:2, -1], "o", color=color, ms=5)
    first = next(iter(paths.values()))
    axes.plot(*first[:2, 0], "s", color=INK, ms=5, mfc="white", label="start")
    axes.set_aspect("equal", adjustable="box")
    every = np.concatenate([path[:2] for path in paths.values()], 1)
    middle, half = (every.max(1) + every.min(1)) / 2, 0.55 * np.ptp(every, 1).max() + 0.05
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")
    axes.legend(fontsize=8)


def _draw_fractions(axes: Axes, kept: Sequence[Check]) -> None:
    """Draw fractions of the displacement as bars, with their limits."""
    colors = {True: GREEN, False: RED, None: LIGHT_GREY}
    fractions = np.nan_to_num([100 * check.measured for check in kept])
    own = [colors[check.passed] for check in kept]
    axes.barh(np.arange(len(kept)), fractions, 0.62, color=own, zorder=2)
    for row, check in enumerate(kept):
        if check.limit is not None:
            limit, side = 100 * check.limit, ">" if check.least else "<"
            axes.plot([limit] * 2, [row - 0.42, row + 0.42], color=INK, lw=2, zorder=3)
            axes.text(limit, row, f" {side} {limit:.0f}", va="center", fontsize=8, zorder=4)
    name_rows(axes, [check.question for check in kept])
    axes.set_xlim(0, 105)
    axes.set_xlabel("displacement kept, relative to the original (%)")
