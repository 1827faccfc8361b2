"""Picture of a map of bodies: fitness over three genes, and drawings of what the genes do."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure, SubFigure

from evo_cpg.view.figure import BLUE, INK, RED, framed, new_figure

# Panels, and least width that a drawing's caption needs (m in the drawing).
_MOST_PANELS, _ACROSS, _LEAST = 9, 3, 0.95
_COLOURS = "viridis"


@framed
def bodies_figure(
    axes: Sequence[tuple[str, str, float, float]],
    fitness: Float[np.ndarray, "a b c"],
    near: float,
    label: str,
    drawn: Mapping[str, Float[np.ndarray, "parts 4 2"]],
) -> Figure:
    """Draw the map of three genes, in panels for some values of the third.

    Args:
        axes: name, unit, least and largest value of each gene.
        fitness: best fitness of each body.
        near: fraction of the bodies that are outlined as the best.
        label: name of the fitness, with its unit.
        drawn: corners of the parts of some bodies from above (m), by their captions.
    """
    title = f"{fitness.size:,} bodies, each with its best rhythm (red: the best {100 * near:g} %)"
    figure = new_figure(10.5, 11, title)
    above, below = figure.subfigures(2, 1, height_ratios=(4, 1), squeeze=False)[:, 0]
    best = fitness >= np.quantile(fitness, 1 - near)
    scale = Normalize(fitness.min(), fitness.max())
    count = min(fitness.shape[2], _MOST_PANELS)
    shown = np.round(np.linspace(0, fitness.shape[2] - 1, count)).astype(int)
    panels = above.subplots(
        -(-count // _ACROSS), min(count, _ACROSS), sharex=True, sharey=True, squeeze=False
    )
    across, upwards, values = (
        low + (high - low) * (np.arange(n + 1) - 0.5) / (n - 1)
        for (_, _, low, high), n in zip(axes, fitness.shape, strict=True)
    )
    for panel, slice_ in zip(panels.flat, shown, strict=True):
        own, mask = fitness[..., slice_].T, best[..., slice_]
        panel.pcolormesh(across, upwards, own, cmap=_COLOURS, norm=scale)
        panel.add_collection(LineCollection(_border(mask, across, upwards), colors=RED, lw=1.8))
        value = (values[slice_] + values[slice_ + 1]) / 2
        panel.set_title(f"{axes[2][0]} {value:.0f} {axes[2][1]}", fontsize=9.5)
    for draw, (name, unit, *_) in zip((above.supxlabel, above.supylabel), axes[:2], strict=True):
        draw(f"{name} ({unit})", fontsize=10)
    bar = above.colorbar(ScalarMappable(scale, _COLOURS), ax=panels, label=label, shrink=0.8)
    bar.outline.set_visible(False)
    _draw_bodies(below, drawn)
    return figure


def _border(
    mask: Bool[np.ndarray, "a b"], across: np.ndarray, upwards: np.ndarray
) -> list[Float[np.ndarray, "2 2"]]:
    """Return the edges between cells inside and outside of a mask."""
    padded, lines = np.pad(mask, 1), []
    for i, j in zip(*np.nonzero(padded[1:] != padded[:-1]), strict=True):
        lines.append(np.array([[across[i], upwards[j - 1]], [across[i], upwards[j]]]))
    for i, j in zip(*np.nonzero(padded[:, 1:] != padded[:, :-1]), strict=True):
        lines.append(np.array([[across[i - 1], upwards[j]], [across[i], upwards[j]]]))
    return lines


def _draw_bodies(figure: SubFigure, drawn: Mapping[str, Float[np.ndarray, "parts 4 2"]]) -> None:
    """Draw bodies side by side to one scale, with the trunk's front upwards."""
    # From above, the left side (y) is to the left of the front (x).
    turned = [np.stack([-corners[..., 1], corners[..., 0]], -1) for corners in drawn.values()]
    halves = [max(np.abs(corners[..., 0]).max(), _LEAST / 2) for corners in turned]
    heights = np.concatenate(turned)[..., 1]
    panels = figure.subplots(1, len(drawn), width_ratios=halves, squeeze=False)
    for panel, name, corners, half in zip(panels.flat, drawn, turned, halves, strict=True):
        colors = [INK, *[BLUE] * (len(corners) - 1)]
        panel.add_collection(PolyCollection(list(corners), facecolors=colors, edgecolors="white"))
        panel.set(xlim=(-half, half), ylim=(heights.min(), heights.max()), aspect="equal")
        panel.set_title(name, fontsize=9)
        panel.set_axis_off()
