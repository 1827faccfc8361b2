"""Pictures of body plans that evolve: the champion's line of descent, and diversity over time."""

import dataclasses
import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from evo_cpg.analysis.descent import Step, told
from evo_cpg.analysis.diversity import BEST, Diversity
from evo_cpg.creature.creature import Creature, neutral_pose
from evo_cpg.view.camera import BodyBoxes, level_axes
from evo_cpg.view.figure import BLUE, GREY, INK, LIGHT_GREY, RED, framed, new_figure
from evo_cpg.view.legible import legible
from evo_cpg.view.meshes import pieces
from evo_cpg.view.offscreen import canvas, placed

# Width of a step, heights of a step and of the curve below, inches. Steps in a row.
_WIDE, _HIGH, _CURVE, _ROW = 3.0, 3.0, 2.3, 4
# Part of a step for its drawing, from the bottom, and letters in a line of its text.
_FROM, _DRAWN, _LETTERS = 0.2, 0.7, 44
# Pixels along a side of a drawing, and margin around the largest animal.
_PIXELS, _MARGIN = 520, 1.08
# Direction of view, onto the left front.
_AHEAD = np.array([-0.62, -0.78, -0.72]) / np.linalg.norm([-0.62, -0.78, -0.72])
# Directions to the right and up in a drawing.
_PLANE = np.stack([level_axes(_AHEAD)[0], np.cross(level_axes(_AHEAD)[0], _AHEAD)])
# Colours of old and new parts.
_OLD, _NEW = "#9db8cc", "#f08a24"
KINDS = ("at random", "altered copy", "crossed", "grafted")
"""Kinds of birth in words, see `evo_cpg.training.family.Ancestor`."""


@framed
def family_figure(
    steps: Sequence[Step],
    creatures: Sequence[Creature],
    others: Sequence[Creature | None],
    best: np.ndarray,
    title: str,
) -> Figure:
    """Draw the line of descent of a champion: its most telling ancestors, and their fitness.

    New parts are orange. All animals have one scale, but second parents are half as large.

    Args:
        steps: the ancestors, see `evo_cpg.analysis.descent.descent`.
        creatures: their bodies.
        others: bodies of their second parents, or None.
        best: best fitness of each generation.
        title: text above the figure.
    """
    rows = -(-len(steps) // _ROW)
    height = rows * _HIGH + _CURVE + 0.5
    figure = Figure(figsize=(_ROW * _WIDE, height))
    figure.suptitle(legible(title), x=0.02, y=1 - 0.12 / height, ha="left", va="top")
    note = "Orange parts are new. Second parents are small, on the right. "
    figure.text(0.98, 1 - 0.16 / height, note, color=GREY, fontsize=8, ha="right", va="top")
    every = [*creatures, *filter(None, others)]
    reach = max(np.ptp(_seen(one), axis=0).max() / 2 for one in every)
    for number, (step, creature, other) in enumerate(zip(steps, creatures, others, strict=True)):
        left, top = number % _ROW / _ROW, height - 0.5 - number // _ROW * _HIGH
        axes = figure.add_axes((left, (top - _HIGH) / height, 1 / _ROW, _HIGH / height))
        axes.set(xlim=(0, 1), ylim=(0, 1))
        axes.set_axis_off()
        _draw_step(axes, steps, number)
        new = step.match < 0 if number else np.zeros(len(step.match), bool)
        _inset(axes, (0.5 - _DRAWN / 2 * _HIGH / _WIDE, _FROM), _DRAWN, portrait(creature, reach, new))
        if other is not None:
            none = np.zeros(len(other.bodies), bool)
            _inset(axes, (0.72, 0.6), _DRAWN / 2.4, portrait(other, reach, none))
    _draw_curve(figure.add_axes((0.06, 0.5 / height, 0.9, (_CURVE - 0.8) / height)), steps, best)
    return figure


def _draw_step(axes: Axes, steps: Sequence[Step], number: int) -> None:
    """Write what is known of a step around its drawing."""
    step, ancestor = steps[number], steps[number].ancestor
    small: dict[str, Any] = {"fontsize": 8, "va": "top"}
    axes.text(0.05, 0.97, f"{number + 1}", color=RED, fontweight="bold", fontsize=11, va="top")
    axes.text(0.15, 0.97, f"generation {ancestor.generation}", fontweight="bold", va="top")
    kind = KINDS[ancestor.kind]
    if ancestor.other is not None:
        verb = "with a part of" if ancestor.kind == 3 else "with"
        kind += f" {verb} no. {ancestor.second} (fitness {ancestor.other['fitness']:.3g})"
    if step.births > 1:
        kind += f"\nafter {step.births - 1} other birth{'s' * (step.births > 2)}"
    axes.text(0.15, 0.9, kind, color=GREY, **small)
    fitness = ancestor.record["fitness"]
    words = f"fitness {fitness:.3g}"
    if number:
        words += f" ({fitness - steps[number - 1].ancestor.record['fitness']:+.2g})"
    if number % _ROW:
        axes.annotate(
            "", (0.02, 0.5), (-0.05, 0.5), arrowprops={"arrowstyle": "-|>", "color": LIGHT_GREY},
            annotation_clip=False,
        )  # fmt: skip
    axes.text(0.5, 0.22, words, ha="center", color=BLUE, fontweight="bold", **small)
    lines = textwrap.wrap(told(step, 2), _LETTERS)
    axes.text(0.5, 0.155, "\n".join(lines[:3]), ha="center", **small)


def _inset(axes: Axes, place: tuple[float, float], side: float, picture: np.ndarray) -> None:
    """Draw a square picture into a step."""
    inset = axes.inset_axes((*place, side * _HIGH / _WIDE, side), zorder=-1)
    inset.imshow(picture, interpolation="lanczos")
    inset.set_axis_off()


def _draw_curve(axes: Axes, steps: Sequence[Step], best: np.ndarray) -> None:
    """Draw the fitness of the shown ancestors below the best of each generation."""
    born = [step.ancestor.generation for step in steps]
    fitness = [float(step.ancestor.record["fitness"]) for step in steps]
    axes.plot(best, color=LIGHT_GREY, lw=1.5, label="best of the generation")
    axes.plot(born, fitness, "o-", color=BLUE, ms=4, lw=1.2, label="the line of the champion")
    for number, place in enumerate(zip(born, fitness, strict=True), 1):
        axes.annotate(str(number), place, (0, -11), textcoords="offset points", ha="center",
                      color=RED, fontsize=8, fontweight="bold")  # fmt: skip
    axes.set(xlabel="generation", ylabel="fitness")
    axes.margins(y=0.18)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
    axes.grid()
    axes.legend(loc="lower right")


def _seen(creature: Creature) -> Float[np.ndarray, "2 2"]:
    """Return the lowest and highest places of an animal in a drawing, m."""
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
    bodies = tuple(
        dataclasses.replace(body, color=_NEW if fresh else _OLD)
        for body, fresh in zip(creature.bodies, new, strict=True)
    )
    creature = dataclasses.replace(creature, bodies=bodies)
    centres, rotations = neutral_pose(creature)
    middle = _seen(creature).mean(0) @ _PLANE
    with canvas((_PIXELS, _PIXELS)) as plotter:
        plotter.enable_lightkit()
        for own, place, turn in zip(pieces(creature), centres, rotations, strict=True):
            for piece in own:
                actor = plotter.add_mesh(piece.mesh, color=piece.color, ambient=0.25, specular=0.1)
                actor.user_matrix = placed(turn, place - middle)
        plotter.camera_position = [-10 * reach * _AHEAD, (0, 0, 0), (0, 0, 1)]
        plotter.enable_parallel_projection()
        plotter.parallel_scale = _MARGIN * reach
        plotter.show(auto_close=False, interactive=False)
        return np.asarray(plotter.screenshot(None, transparent_background=True, return_img=True))


@framed
def diversity_figure(found: Diversity, title: str) -> Figure:
    """Draw the diversity of body plans over the generations."""
    figure = new_figure(8, 6.4, title)
    panels = figure.subplots(3, 1, sharex=True)
    x = found.generations
    panels[0].plot(x, found.topologies, color=BLUE, label="in the population")
    panels[0].plot(x, found.best, color=RED, label=f"among the best {BEST}")
    panels[0].set_ylabel("different topologies")
    panels[0].legend()
    panels[1].plot(x, found.distance, color=BLUE)
    panels[1].set_ylabel("mean edit distance\n(bodies)")
    panels[2].plot(x, found.founders, color=INK)
    panels[2].set(ylabel="founders with\ndescendants", xlabel="generation", yscale="log")
    panels[2].yaxis.set_major_formatter("{x:.0f}")
    for axes in panels:
        axes.grid()
    for axes in panels[:2]:
        axes.set_ylim(bottom=0)
    panels[2].xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
    return figure
