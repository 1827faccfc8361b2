"""Pictures of searches: fitness over generations or evaluations, champions, and maps of gaits."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import matplotlib
import numpy as np
from jaxtyping import Float
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, to_hex
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from evo_cpg.evolution.strategy import Axis
from evo_cpg.view.figure import PALETTE, RED, draw_runs, framed, name_rows, new_figure
from evo_cpg.view.legible import UNITS, in_words

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
    axes.set(xlabel="generation", ylabel=label)
    axes.set_ylim(bottom=0)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
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
    axes.set(xlabel=labels[0], ylabel=labels[1])
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
    labels = []
    for row, (curve, next_one) in enumerate(zip(curves, colors(len(curves)), strict=True)):
        color, final = curve.color or next_one, curve.final[np.isfinite(curve.final)]
        draw_runs(left, curve.evaluations, curve.best, color, opacity=_INK_OF_BANDS / len(curves))
        if final.size:
            beside = row + 0.22 * (np.random.default_rng(row).random(final.size) - 0.5)
            right.plot(final, beside, "o", ms=5, mfc=color, mec="white", mew=0.6, alpha=0.85)
            right.plot([np.median(final)] * 2, [row - 0.32, row + 0.32], color=color, lw=2.6)
        long = len(curve.name) > _LONGEST
        name = f"{curve.name[: _LONGEST - 1]}..." if long else curve.name
        labels.append(f"{name}  (n = {final.size})")
    left.set(xlabel="evaluations per run", ylabel="best fitness so far")
    name_rows(right, labels)
    # Many long numbers would overlap.
    right.xaxis.set_major_locator(MaxNLocator(4))
    right.set_xlabel("fitness of the champions (line: median)")
    for axes in (left, right):
        axes.grid()
    return figure


def colors(count: int) -> Sequence[str]:
    """Return a colour for each setting, from a rainbow if the palette has too few."""
    if count <= len(PALETTE):
        return PALETTE[:count]
    return [
        to_hex(color) for color in matplotlib.colormaps["turbo"](np.linspace(0.05, 0.95, count))
    ]


_EMPTY, _COLOURS = "#eef0f3", "viridis"

# Sizes in inches: a panel, space to the right of all panels, space above them, a single panel.
_PANEL, _BESIDE, _ABOVE = 2.6, 1.5, 1.0
_ALONE = 4.6
_PANELS_IN_A_ROW = 5
_MOST_PANELS = 25


@framed
def map_figure(axes: Sequence[Axis], fitness: Float[np.ndarray, "..."], title: str) -> Figure:
    """Draw a map of gaits: the fitness of its elites, or NaN in empty cells.

    Two axes make a picture, a third several pictures. Further axes, and a third axis with more than
    25 cells, are not drawn: each place shows the best of all cells along them.
    """
    head = f"{title}: {np.isfinite(fitness).mean():.0%} of {fitness.size} cells filled"
    most = 3 if len(axes) > 2 and axes[2].cells <= _MOST_PANELS else 2
    filled = np.where(np.isfinite(fitness), fitness, -np.inf)
    best = filled.max(axis=tuple(range(most, len(axes))))
    axes, shown = axes[:most], np.where(np.isfinite(best), best, np.nan)
    finite = shown[np.isfinite(shown)]
    low, high = (finite.min(), finite.max()) if finite.size else (0.0, 1.0)
    # One elite, or several with equal fitness, get the middle of a colour bar around this fitness.
    least = 1e-3 * max(abs(low), abs(high), 1e-6)
    middle, half = (low + high) / 2, max((high - low) / 2, least)
    scale = Normalize(middle - half, middle + half)
    colours = ScalarMappable(scale, _COLOURS)
    if len(axes) == 1:
        (axis,), heights = axes, np.nan_to_num(shown)
        figure = new_figure(_ALONE + _BESIDE, _ALONE, head)
        panel = figure.subplots()
        middles, width = (axis.edges[1:] + axis.edges[:-1]) / 2, 0.9 * np.diff(axis.edges)
        panel.bar(middles, heights, width, color=colours.to_rgba(heights))
        panel.set(xlabel=_axis_label(axis), ylabel="fitness")
        return figure
    slices = [shown] if len(axes) == 2 else [shown[..., i] for i in range(axes[2].cells)]
    across = min(len(slices), _PANELS_IN_A_ROW)
    down = -(-len(slices) // across)
    size = _ALONE if len(slices) == 1 else _PANEL
    figure = new_figure(size * across + _BESIDE, size * down + _ABOVE, head)
    grid = figure.subplots(down, across, squeeze=False, sharex=True, sharey=True)
    star = np.unravel_index(np.nanargmax(shown), shown.shape) if finite.size else None
    for i, panel in enumerate(grid.flat):
        if i >= len(slices):
            panel.set_axis_off()
            continue
        panel.set_facecolor(_EMPTY)
        cells = np.ma.masked_invalid(slices[i].T)
        panel.pcolormesh(axes[0].edges, axes[1].edges, cells, cmap=_COLOURS, norm=scale)
        panel.tick_params(labelsize=8)
        if len(slices) > 1:
            low, high = axes[2].edges[i : i + 2]
            unit = UNITS.get(axes[2].name, "")
            words = f"{in_words(axes[2].name)} {low:.3g} to {high:.3g} {unit}"
            panel.set_title(words.strip(), fontsize=8)
        if star is not None and (len(slices) == 1 or star[2] == i):
            x, y = (axes[k].edges[star[k] : star[k] + 2].mean() for k in (0, 1))
            panel.plot(x, y, marker="*", ms=11, mfc="white", mec=RED, mew=1.4)
    for panel in grid[-1]:
        panel.set_xlabel(_axis_label(axes[0]))
    for panel in grid[:, 0]:
        panel.set_ylabel(_axis_label(axes[1]))
    label = "fitness (star: best cell)"
    bar = figure.colorbar(colours, ax=list(grid.flat), label=label, shrink=0.8)
    bar.outline.set_visible(False)
    return figure


def _axis_label(axis: Axis) -> str:
    unit = UNITS.get(axis.name)
    return f"{in_words(axis.name)} ({unit})" if unit else in_words(axis.name)
