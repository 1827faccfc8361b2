"""Picture of a map of bodies: fitness over three genes, and drawings of what the genes do."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure, SubFigure

from evo_cpg.creature.creature import Creature, neutral_pose
from evo_cpg.view.figure import BLUE, INK, RED, framed, new_figure

# Largest number of panels, panels in a row, and least width of a drawing, m, for its caption.
_PANELS, _IN_A_ROW, _LEAST = 9, 3, 0.95
_COLOURS = "viridis"
_CORNERS = np.array([[1, 1, 0], [1, -1, 0], [-1, -1, 0], [-1, 1, 0]])


@framed
def bodies_figure(
    axes: Sequence[tuple[str, str, float, float]],
    fitness: Float[np.ndarray, "c c c"],
    near: float,
    label: str,
    drawn: Mapping[str, Creature],
) -> Figure:
    """Draw the map of three genes, in panels for some values of the third, with the best framed.

    Args:
        axes: name, unit, least and largest value of each gene.
        fitness: best fitness of each body.
        near: fraction of the bodies that are framed as the best.
        label: name of the fitness, with its unit.
        drawn: creatures of boxes by their captions.
    """
    title = (
        f"{fitness.size:,} bodies, each with its best rhythm (framed: the best {100 * near:g} %)"
    )
    above, below = new_figure(10.5, 11, title).subfigures(2, 1, height_ratios=(4, 1), squeeze=False)
    best, cells = fitness >= np.quantile(fitness, 1 - near), len(fitness)
    scale, rows = Normalize(fitness.min(), fitness.max()), min(cells, _PANELS) // _IN_A_ROW
    panels = above[0].subplots(rows, _IN_A_ROW, sharex=True, sharey=True)
    x, y, values = (np.linspace(low, high, cells) for _, _, low, high in axes)
    for panel, k in zip(panels.flat, np.linspace(0, cells - 1, panels.size).round(), strict=True):
        own = np.s_[..., int(k)]
        panel.pcolormesh(x, y, fitness[own].T, cmap=_COLOURS, norm=scale)
        frames = np.stack([x, y], -1)[np.array(np.nonzero(best[own])).T, [0, 1]]
        frames = frames[:, None] + _CORNERS[None, :, :2] * [(x[1] - x[0]) / 2, (y[1] - y[0]) / 2]
        panel.add_collection(PolyCollection([*frames], facecolors="none", edgecolors=RED, lw=1.2))
        panel.set_title(f"{axes[2][0]} {values[int(k)]:z.0f} {axes[2][1]}", fontsize=9.5)
    above[0].supxlabel("{} ({})".format(*axes[0]), fontsize=10)
    above[0].supylabel("{} ({})".format(*axes[1]), fontsize=10)
    bar = above[0].colorbar(ScalarMappable(scale, _COLOURS), ax=panels, label=label, shrink=0.8)
    bar.outline.set_visible(False)
    _draw_bodies(below[0], drawn)
    return above[0].figure


def _draw_bodies(figure: SubFigure, drawn: Mapping[str, Creature]) -> None:
    """Draw bodies from above, side by side and to one scale, with the trunk's front upwards."""
    shapes = [_outlines(creature) for creature in drawn.values()]
    halves = [max(np.abs(shape[..., 0]).max(), _LEAST / 2) for shape in shapes]
    heights = np.concatenate(shapes)[..., 1]
    panels = figure.subplots(1, len(drawn), width_ratios=halves, squeeze=False)
    for panel, name, shape, half in zip(panels.flat, drawn, shapes, halves, strict=True):
        colors = [INK, *[BLUE] * (len(shape) - 1)]
        panel.add_collection(PolyCollection(list(shape), facecolors=colors, edgecolors="white"))
        panel.set(xlim=(-half, half), ylim=(heights.min(), heights.max()), aspect="equal")
        panel.set_title(name, fontsize=9)
        panel.set_axis_off()


def _outlines(creature: Creature) -> Float[np.ndarray, "b 4 2"]:
    """Return the corners of each box (m). The left side (y) is to the left of the front (x)."""
    halves = np.array([body.shape.half_extents for body in creature.bodies], float)
    centres, turns = map(np.asarray, neutral_pose(creature))
    corners = centres[:, None] + halves[:, None] * _CORNERS[None] @ np.swapaxes(turns, 1, 2)
    return np.stack([-corners[..., 1], corners[..., 0]], -1)
