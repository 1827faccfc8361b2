"""Picture of a map of gaits: the fitness of the best individual in every cell."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from evo_cpg.evolution.archive import Axis
from evo_cpg.view.figure import RED, framed, new_figure
from evo_cpg.view.units import UNITS, in_words

_EMPTY, _COLOURS = "#eef0f3", "viridis"

# Sizes in inches: a panel, space to the right of all panels, space above them, a single panel.
_PANEL, _BESIDE, _ABOVE = 2.6, 1.5, 1.0
_ALONE = 4.6
_PANELS_IN_A_ROW = 5
_MOST_PANELS = 25


@framed
def map_figure(axes: Sequence[Axis], fitness: Float[np.ndarray, "..."], title: str) -> Figure:
    """Draw a map of gaits.

    Two axes make a picture, a third several pictures. Further axes, and a third axis with more than
    25 cells, are not drawn: each place shows the best of all cells along them.

    Args:
        axes: axes of the map.
        fitness: fitness of the elites, one array axis for each map axis, or NaN in empty cells.
        title: text above the picture.
    """
    head = f"{title}: {np.isfinite(fitness).mean():.0%} of {fitness.size} cells filled"
    axes, shown = _at_most_three(axes, fitness)
    finite = shown[np.isfinite(shown)]
    low, high = (finite.min(), finite.max()) if finite.size else (0.0, 1.0)
    # One elite, or several with equal fitness, get the middle of a colour bar around this fitness.
    least = 1e-3 * max(abs(low), abs(high), 1e-6)
    middle, half = (low + high) / 2, max((high - low) / 2, least)
    scale = Normalize(middle - half, middle + half)
    draw = _bars if len(axes) == 1 else _panels
    return draw(axes, shown, scale, head)


def _at_most_three(
    axes: Sequence[Axis], fitness: Float[np.ndarray, "..."]
) -> tuple[Sequence[Axis], np.ndarray]:
    """Return at most three axes of a map, and the best fitness over all others."""
    most = 3 if len(axes) > 2 and axes[2].cells <= _MOST_PANELS else 2
    rest = tuple(range(most, len(axes)))
    filled = np.where(np.isfinite(fitness), fitness, -np.inf)
    best = filled.max(axis=rest) if rest else filled
    return axes[:most], np.where(np.isfinite(best), best, np.nan)


def _bars(axes: Sequence[Axis], fitness: np.ndarray, scale: Normalize, title: str) -> Figure:
    (axis,) = axes
    figure = new_figure(_ALONE + _BESIDE, _ALONE, title)
    panel = figure.subplots()
    middles = (axis.edges[1:] + axis.edges[:-1]) / 2
    width = 0.9 * np.diff(axis.edges)
    colours = ScalarMappable(scale, _COLOURS).to_rgba(np.nan_to_num(fitness))
    panel.bar(middles, np.nan_to_num(fitness), width, color=colours)
    panel.set_xlabel(_label(axis))
    panel.set_ylabel("fitness")
    return figure


def _panels(axes: Sequence[Axis], fitness: np.ndarray, scale: Normalize, title: str) -> Figure:
    slices = [fitness] if len(axes) == 2 else [fitness[..., i] for i in range(axes[2].cells)]
    across = min(len(slices), _PANELS_IN_A_ROW)
    down = -(-len(slices) // across)
    size = _ALONE if len(slices) == 1 else _PANEL
    figure = new_figure(size * across + _BESIDE, size * down + _ABOVE, title)
    grid = figure.subplots(down, across, squeeze=False, sharex=True, sharey=True)
    found = np.isfinite(fitness).any()
    best = np.unravel_index(np.nanargmax(fitness), fitness.shape) if found else None
    for i, panel in enumerate(grid.flat):
        if i >= len(slices):
            panel.set_axis_off()
            continue
        _picture(panel, axes, slices[i], scale)
        if len(slices) > 1:
            low, high = axes[2].edges[i : i + 2]
            unit = UNITS.get(axes[2].name, "")
            head = f"{in_words(axes[2].name)} {low:.3g} to {high:.3g} {unit}".strip()
            panel.set_title(head, fontsize=8)
        if best is not None and (len(slices) == 1 or best[2] == i):
            x, y = (axes[k].edges[best[k] : best[k] + 2].mean() for k in (0, 1))
            panel.plot(x, y, marker="*", ms=11, mfc="white", mec=RED, mew=1.4)
    for panel in grid[-1]:
        panel.set_xlabel(_label(axes[0]))
    for panel in grid[:, 0]:
        panel.set_ylabel(_label(axes[1]))
    colours, label = ScalarMappable(scale, _COLOURS), "fitness (star: best cell)"
    bar = figure.colorbar(colours, ax=list(grid.flat), label=label, shrink=0.8)
    bar.outline.set_visible(False)
    return figure


def _picture(panel: Axes, axes: Sequence[Axis], fitness: np.ndarray, scale: Normalize) -> None:
    first, second = axes[:2]
    panel.set_facecolor(_EMPTY)
    panel.pcolormesh(
        first.edges, second.edges, np.ma.masked_invalid(fitness.T), cmap=_COLOURS, norm=scale
    )
    panel.tick_params(labelsize=8)


def _label(axis: Axis) -> str:
    unit = UNITS.get(axis.name)
    return f"{in_words(axis.name)} ({unit})" if unit else in_words(axis.name)
