"""Pictures of body plans that evolve: the champion's line of descent, and diversity over time."""

import dataclasses
import textwrap
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from evo_cpg.analysis.descent import Milestone
from evo_cpg.analysis.diversity import BEST, Diversity
from evo_cpg.creature.creature import Creature, neutral_pose
from evo_cpg.view.camera import BodyBoxes, level_axes
from evo_cpg.view.figure import BLUE, GREY, RED, framed, new_figure
from evo_cpg.view.meshes import add_bodies
from evo_cpg.view.offscreen import canvas, placed

# Steps in a row, width and height of a step, and height of the title, inches.
_ROW, _WIDE, _HIGH, _TITLE = 4, 3.0, 2.9, 0.5
# Pixels along a side of a drawing, margin around the largest animal, and letters in a line.
_PIXELS, _MARGIN, _LETTERS = 520, 1.05, 44
# Direction of view, onto the left front, and directions to the right and up in a drawing.
_AHEAD = np.array([-0.62, -0.78, -0.72]) / np.linalg.norm([-0.62, -0.78, -0.72])
_PLANE = np.stack([level_axes(_AHEAD)[0], np.cross(level_axes(_AHEAD)[0], _AHEAD)])
# Colours of old and new parts.
_OLD, _NEW = "#9db8cc", "#f08a24"
# Kinds of birth, see `evo_cpg.training.family.Ancestor`.
_KINDS = ("first ancestor", "altered copy", "crossed with", "with a part of")


@framed
def family_figure(
    steps: Sequence[Milestone],
    animals: Sequence[Creature],
    others: Sequence[Creature | None],
    title: str,
) -> Figure:
    """Draw the most telling ancestors of a champion in one scale.

    Args:
        steps: the ancestors, see `evo_cpg.analysis.descent.descent`.
        animals: their bodies. New parts are orange.
        others: bodies of their second parents, or None.
        title: text above the figure.
    """
    height = _TITLE - (-len(steps) // _ROW) * _HIGH
    figure = new_figure(_ROW * _WIDE, height, f"{title} (orange: new parts)")
    figure.set_layout_engine("none")
    every = [*animals, *(other for other in others if other is not None)]
    reach = max(float(np.ptp(_extent(one), axis=0).max()) for one in every) / 2
    for number, step in enumerate(steps):
        bottom = height - _TITLE - (number // _ROW + 1) * _HIGH
        axes = figure.add_axes(
            (number % _ROW / _ROW, bottom / height, 1 / _ROW, _HIGH / height), frame_on=False
        )
        new = (step.match < 0) & (number > 0)
        axes.inset_axes((0.12, 0.16, 0.76, 0.76)).imshow(portrait(animals[number], reach, new))
        if (other := others[number]) is not None:
            old = np.zeros(len(other.bodies), bool)
            axes.inset_axes((0.7, 0.6, 0.3, 0.3)).imshow(portrait(other, reach, old))
        for each in (axes, *axes.child_axes):
            each.set_axis_off()
        _write(axes, number, step, steps[max(number - 1, 0)].ancestor.record["fitness"])
    return figure


def _write(axes: Axes, number: int, step: Milestone, before: float) -> None:
    """Write a step's origin above its drawing, and its changes and gain of fitness below."""
    ancestor, fitness = step.ancestor, step.ancestor.record["fitness"]
    origin = _KINDS[ancestor.kind]
    if ancestor.other is not None:
        origin += f" no. {ancestor.second} (fitness {ancestor.other['fitness']:.3g})"
    if step.births > 1:
        origin += f"\n{step.births - 1} birth{'s' * (step.births > 2)} in between"
    gain = f" ({fitness - before:+.2g})" if number else ""
    words = textwrap.fill("; ".join(step.words[:2]), _LETTERS)
    head = f"{number + 1}   generation {ancestor.generation}"
    axes.text(0.05, 0.98, head, color=RED, fontweight="bold", va="top")
    axes.text(0.05, 0.91, origin, color=GREY, fontsize=8, va="top")
    axes.text(0.5, 0.2, f"fitness {fitness:.3g}{gain}", color=BLUE, fontsize=8, ha="center")
    axes.text(0.5, 0.17, words, fontsize=8, ha="center", va="top")


def _extent(creature: Creature) -> Float[np.ndarray, "2 2"]:
    """Return the lowest and highest places of a resting animal in a drawing, m."""
    half = np.array([body.shape.half_extents for body in creature.bodies])
    centres, rotations = (x[None] for x in neutral_pose(creature))
    places = BodyBoxes(centres, rotations, half).corners()[0] @ _PLANE.T
    return np.stack([places.min(0), places.max(0)])


def portrait(creature: Creature, reach: float, new: np.ndarray) -> UInt8[np.ndarray, "n n 4"]:
    """Return a drawing of a resting animal on a transparent ground.

    Args:
        creature: the animal.
        reach: half of the extent that the drawing shows, m.
        new: whether each body has the colour of new parts.
    """
    pairs = zip(creature.bodies, new, strict=True)
    bodies = [dataclasses.replace(body, color=_NEW if fresh else _OLD) for body, fresh in pairs]
    creature = dataclasses.replace(creature, bodies=tuple(bodies))
    centres, rotations = neutral_pose(creature)
    with canvas((_PIXELS, _PIXELS)) as plotter:
        plotter.enable_lightkit()
        drawn = add_bodies(plotter, creature, 0.35)
        for actors, place, turn in zip(drawn, centres, rotations, strict=True):
            for actor in actors:
                actor.user_matrix = placed(turn, place - _extent(creature).mean(0) @ _PLANE)
        plotter.camera.position = -10 * reach * _AHEAD
        plotter.camera.focal_point, plotter.camera.up = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)
        plotter.camera.parallel_projection = True
        plotter.camera.parallel_scale = _MARGIN * reach
        plotter.show(auto_close=False, interactive=False)
        return np.asarray(plotter.screenshot(transparent_background=True, return_img=True))


@framed
def diversity_figure(found: Diversity, title: str) -> Figure:
    """Draw the diversity of body plans over the generations."""
    figure = new_figure(8, 6.4, title)
    panels, x = figure.subplots(3, 1, sharex=True), found.generations
    panels[0].plot(x, found.topologies, color=BLUE, label="in the population")
    panels[0].plot(x, found.best, color=RED, label=f"among the best {BEST}")
    panels[0].legend()
    panels[1].plot(x, found.distance, color=BLUE)
    panels[2].plot(x, found.founders, color=BLUE)
    panels[2].set(xlabel="generation", yscale="log")
    panels[2].yaxis.set_major_formatter("{x:.0f}")
    names = "different\ntopologies", "mean edit distance\n(bodies)", "founders with\ndescendants"
    for axes, name in zip(panels, names, strict=True):
        axes.set_ylabel(name)
        axes.grid()
    return figure
