"""Pictures of searches: fitness over generations or evaluations by setting, and champions."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import matplotlib
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from evo_cpg.view.figure import (
    PALETTE,
    count_in_whole_numbers,
    draw_runs,
    framed,
    name_rows,
    new_figure,
)

# Sizes of a sweep in inches: width, least height, height of a setting, and height of the rest.
_WIDTH, _LEAST, _ROW, _REST = 11.0, 4.2, 0.34, 1.3

# Number of the bands of settings, times their opacity: many bands are faint.
_INK_OF_BANDS = 0.5

# Letters of the longest name beside the runs.
_LONGEST = 34


class Curves(NamedTuple):
    """The runs of one setting.

    Attributes:
        name: name of the setting.
        evaluations: number of evaluated individuals after every generation.
        best: fitness of the best so far in every run, as evaluated in training, or NaN before the
            first one.
        final: fitness of each run's champion. With noise, the mean of its re-evaluation. NaN for a
            run without a champion.
        color: colour, or None for the next one in the figure.
    """

    name: str
    evaluations: Float[np.ndarray, " generations"]
    best: Float[np.ndarray, "runs generations"]
    final: Float[np.ndarray, " runs"]
    color: str | None = None


@framed
def generations_figure(
    bests: Mapping[str, Float[np.ndarray, "generations runs"]],
    label: str,
    single_runs: bool = False,
) -> Figure:
    """Draw the best of every generation: medians over the runs, and the band of half the runs.

    Args:
        bests: best values of each setting, by its name.
        label: name of the values, with their unit.
        single_runs: whether to draw a thin line for each run, too.
    """
    figure = new_figure(8, 4.6)
    axes = figure.subplots()
    for (name, best), color in zip(bests.items(), colors(len(bests)), strict=True):
        if single_runs:
            axes.plot(best, color=color, lw=0.5, alpha=0.3)
        draw_runs(axes, np.arange(len(best)), best.T, color, name)
    axes.set_xlabel("generation")
    axes.set_ylabel(label)
    axes.set_ylim(bottom=0)
    count_in_whole_numbers(axes)
    axes.grid()
    counts = [best.shape[1] for best in bests.values()]
    least, most = min(counts), max(counts)
    runs = f"{most} runs" if least == most else f"{least} to {most} runs"
    axes.legend(title=f"median of {runs}, half of them in the band" if most > 1 else None)
    return figure


@framed
def champions_figure(
    groups: Mapping[str, tuple[Sequence[float], Sequence[float]]], labels: tuple[str, str]
) -> Figure:
    """Draw a dot for every champion.

    Args:
        groups: values to the right and upwards, by the name of each group. The second of every two
            groups has the colour of the first, and is filled.
        labels: labels of the axes, with units.
    """
    figure = new_figure(6.5, 4.6)
    axes = figure.subplots()
    for number, (name, (across, upwards)) in enumerate(groups.items()):
        color = PALETTE[number // 2 % len(PALETTE)]
        fill = color if number % 2 else "none"
        axes.scatter(across, upwards, edgecolors=color, facecolors=fill, label=name)
    axes.set_xlabel(labels[0])
    axes.set_ylabel(labels[1])
    axes.set_ylim(bottom=0)
    axes.grid()
    figure.legend(ncols=2, loc="outside upper center")
    return figure


@framed
def sweep_figure(curves: Sequence[Curves], title: str) -> Figure:
    """Draw a sweep.

    The left panel shows the best so far over the evaluations: the median of the runs, and the band
    in which half of them lie. The right panel shows every run's champion, with the median.

    Args:
        curves: curves of the settings, in the order of display.
        title: text above the figure.
    """
    figure = new_figure(_WIDTH, max(_LEAST, _REST + _ROW * len(curves)), title)
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1))
    for row, (curve, next_one) in enumerate(zip(curves, colors(len(curves)), strict=True)):
        color = curve.color or next_one
        draw_runs(left, curve.evaluations, curve.best, color, opacity=_INK_OF_BANDS / len(curves))
        _draw_finals(right, row, curve.final[np.isfinite(curve.final)], color)
    left.set_xlabel("evaluations per run")
    left.set_ylabel("best fitness so far")
    name_rows(right, [_label(curve) for curve in curves])
    # Many long numbers would overlap.
    right.xaxis.set_major_locator(MaxNLocator(4))
    right.set_xlabel("fitness of the champions (line: median)")
    for axes in (left, right):
        axes.grid()
    return figure


def _draw_finals(axes: Axes, row: int, final: Float[np.ndarray, " n"], color: str) -> None:
    if not final.size:
        return
    beside = row + 0.22 * (np.random.default_rng(row).random(final.size) - 0.5)
    axes.plot(final, beside, "o", ms=5, mfc=color, mec="white", mew=0.6, alpha=0.85)
    axes.plot([np.median(final)] * 2, [row - 0.32, row + 0.32], color=color, lw=2.6)


def _label(curve: Curves) -> str:
    name = curve.name
    name = name if len(name) <= _LONGEST else f"{name[: _LONGEST - 1]}..."
    return f"{name}  (n = {int(np.isfinite(curve.final).sum())})"


def colors(count: int) -> Sequence[str]:
    """Return a colour for each setting, from a rainbow if the palette has too few."""
    if count <= len(PALETTE):
        return PALETTE[:count]
    return [
        to_hex(color) for color in matplotlib.colormaps["turbo"](np.linspace(0.05, 0.95, count))
    ]
