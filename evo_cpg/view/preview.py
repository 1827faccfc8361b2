"""A picture of a body plan: the neutral pose with names, joint axes, sensors and a scale."""

import dataclasses
import os
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyvista as pv

from evo_cpg.creature.creature import Creature, neutral_pose
from evo_cpg.physics.footing import Ground
from evo_cpg.view.ground import grid_spacing
from evo_cpg.view.legible import font, legible, lettering, write
from evo_cpg.view.meshes import add_bodies, shape_mesh
from evo_cpg.view.offscreen import canvas, pixels, placed
from evo_cpg.view.output import check_size, frame_writer, output_path, oversampling
from evo_cpg.view.preview_ground import (
    SEA,
    add_preview_ground,
    add_preview_water,
    obstacles_near,
    tint_under_water,
    water_note,
)

_BACKGROUND = "#f4f6f8"
_TEXT = "#1d2530"
# Okabe and Ito's palette: told apart with every common kind of colour blindness.
_AXES = {"x": "#D55E00", "y": "#009E73", "z": "#0072B2"}
_OTHER_AXIS = "#6b7280"
_SIGHT = "#E69F00"
_PRESSURE = "#CC79A7"
_DEPTH = "#56B4E9"
# The camera looks along this direction, onto the animal's left front.
_VIEW = np.array([-0.55, -0.95, -0.62])
# Share of the picture that the animal fills.
_FILL = 0.72
_AMBIENT = 0.35
_OPACITY = 0.72
# Names of more bodies than this would cover the picture.
_MOST_NAMES = 24
# Sizes of a name and of other words, and height of a name's line relative to its size.
_NAME, _SMALL, _LINE = 13.5, 16, 1.35
_OVERSAMPLING = 2
# The smallest picture with room for words, and the one for which their sizes are meant.
_ROOM, _SCREEN = (320, 180), (1280, 720)


def preview_path(path: str | os.PathLike[str], size: tuple[int, int]) -> Path:
    """Check that a preview of this size (pixels) can be drawn and written here.

    Raises:
        OutputError: nothing can be written there, or not this kind of file.
        SettingError: the size is too small, or too large.
    """
    path = output_path(path, (".png",))
    check_size(size)
    return path


def preview(
    creature: Creature,
    path: str | os.PathLike[str],
    size: tuple[int, int] = (1280, 720),
    *,
    ground: Ground | bool = False,
    pose: tuple[np.ndarray, np.ndarray] | None = None,
    surface: float | None = None,
) -> Path:
    """Draw a creature in its neutral pose, or another.

    Args:
        creature: what to draw.
        path: ``.png``.
        size: width and height, pixels.
        ground: that it stands on, with its obstacles, as it is in the world; True for level ground
            under its lowest point.
        pose: centres ``(bodies, 3)`` in m and rotations ``(bodies, 3, 3)``, in the world where the
            ground is; None for the neutral pose.
        surface: height of the water in the same world, m; infinite for water everywhere, None for
            none.

    Returns:
        The path.

    Raises:
        OutputError: nothing can be written there, or not this kind of file.
        CreatureError: the bodies do not form one tree.
        SettingError: the size is too small, or too large.
    """
    path = preview_path(path, size)
    centres, rotations = neutral_pose(creature) if pose is None else pose
    half_extents = np.array([body.shape.half_extents for body in creature.bodies])
    meshes = [
        shape_mesh(body.shape).transform(placed(turn, centre), inplace=False)
        for body, centre, turn in zip(creature.bodies, centres, rotations, strict=True)
    ]
    hull = np.concatenate([np.asarray(mesh.points) for mesh in meshes])
    sunk = surface is not None and surface >= hull[:, 2].max()
    world = ground if isinstance(ground, Ground) else None
    stones, far = obstacles_near(world, hull)
    shown = np.concatenate([hull, stones])
    scale = np.median(half_extents.min(1))
    scale_up = oversampling(size, _OVERSAMPLING)
    unit = scale_up * max(min(size[0] / _SCREEN[0], size[1] / _SCREEN[1]), 0.5)
    rendered = (round(size[0] * scale_up), round(size[1] * scale_up))
    with canvas(rendered) as plotter:
        plotter.background_color = pv.Color(SEA if sunk else _BACKGROUND)
        for place, intensity in (((0.3, 0.6, 1.6), 0.75), ((1.2, 0.9, 0.2), 0.4)):
            light = pv.Light(position=place, intensity=intensity, light_type="scene light")
            light.positional = False
            plotter.add_light(light)
        if ground:
            add_preview_ground(plotter, creature, centres, rotations, shown, world, sunk)
        bodies = add_bodies(plotter, creature, _AMBIENT)
        for actors, centre, turn in zip(bodies, centres, rotations, strict=True):
            for actor in actors:
                actor.user_matrix = placed(turn, centre)
            # The joints lie inside: let them show.
            actors[0].prop.SetOpacity(_OPACITY)
            actors[0].prop.SetBackfaceCulling(True)
        hidden = sunk or (surface is not None and world is not None and _below(surface, world))
        sheet = None if hidden else surface
        if sheet is not None:
            add_preview_water(plotter, sheet, shown)
        # What is translucent is drawn in the order of adding: the farthest first.
        for i in np.argsort(-centres @ _VIEW):
            plotter.renderer.RemoveViewProp(bodies[i][0])
            plotter.renderer.AddViewProp(bodies[i][0])
        if sheet is not None:
            tint_under_water(plotter, sheet, meshes)
        legend = _add_joints(plotter, creature, centres, rotations, scale)
        legend |= _add_sensors(plotter, creature, centres, rotations, scale, bool(ground))
        view = _frame(plotter, shown, size)
        notes = [f"{far} obstacle{'s' if far > 1 else ''} farther away"] if far else []
        if surface is not None:
            notes.append(water_note(surface, hull))
        plotter.show(auto_close=False, interactive=False)
        picture = pixels(plotter)
        if size[0] >= _ROOM[0] and size[1] >= _ROOM[1]:
            _write(picture, creature, centres, view, legend, notes, unit)
        with frame_writer(path, size, rendered, 1) as send:
            send(picture)
    return path


def _below(surface: float, ground: Ground) -> bool:
    """Return whether water lies under the ground everywhere, as far as that is known."""
    level = dataclasses.replace(ground, obstacles=()).level
    return level is not None and surface <= level


class _View(NamedTuple):
    """The picture's centre in the world, its right and up, and pixels rendered per metre."""

    focus: np.ndarray
    right: np.ndarray
    up: np.ndarray
    pixels_per_metre: float


def _add_joints(
    plotter: pv.Plotter,
    creature: Creature,
    centres: np.ndarray,
    rotations: np.ndarray,
    scale: float,
) -> dict[str, str]:
    """Arrows along the joint axes; returns what the colours mean."""
    meaning = {}
    for body, centre, turn in zip(creature.bodies, centres, rotations, strict=True):
        if body.joint is None:
            continue
        anchor = centre + turn @ np.array(body.joint.child_anchor)
        for axis in body.joint.axes:
            names = [n for n, unit in zip("xyz", np.eye(3), strict=True) if np.allclose(axis, unit)]
            name = names[0] if names else "other"
            meaning[f"{name} axis"] = color = _AXES.get(name, _OTHER_AXIS)
            # Long enough to come out of the bodies on either side.
            _add_arrow(plotter, anchor, turn @ np.array(axis), 2.1 * scale, color)
    return dict(sorted(meaning.items()))


def _add_sensors(
    plotter: pv.Plotter,
    creature: Creature,
    centres: np.ndarray,
    rotations: np.ndarray,
    scale: float,
    on_ground: bool,
) -> dict[str, str]:
    """Lines of sight, gauges, and dots on the bodies that feel; returns what the colours mean."""
    meaning = {}
    for sensor in creature.light_sensors:
        i = creature.body_index(sensor.body)
        eye = centres[i] + rotations[i] @ np.array(sensor.position)
        _add_arrow(plotter, eye, rotations[i] @ np.array(sensor.axis), 3.2 * scale, _SIGHT)
        meaning["line of sight"] = _SIGHT
    for gauge in creature.depth_sensors:
        i = creature.body_index(gauge.body)
        place = centres[i] + rotations[i] @ np.array(gauge.position)
        ball = pv.Sphere(radius=0.3 * scale, center=place)
        plotter.add_mesh(ball, color=_DEPTH, lighting=False)
        meaning["depth gauge"] = _DEPTH
    for name in creature.pressure_sensors if on_ground else ():
        i = creature.body_index(name)
        shape = creature.bodies[i].shape
        for axis in (1, 2):
            for side in (1, -1):
                place = centres[i] + rotations[i] @ shape.support(side * np.eye(3)[axis])
                dot = pv.Sphere(radius=0.22 * scale, center=place)
                plotter.add_mesh(dot, color=_PRESSURE, lighting=False)
        meaning["feels contact"] = _PRESSURE
    return meaning


def _add_arrow(
    plotter: pv.Plotter, start: np.ndarray, direction: np.ndarray, length: float, color: str
) -> None:
    arrow = pv.Arrow(
        start=start,
        direction=direction,
        scale=length,
        shaft_radius=0.022,
        tip_radius=0.065,
        tip_length=0.2,
    )
    plotter.add_mesh(arrow, color=color, ambient=0.6, diffuse=0.5)


def _frame(plotter: pv.Plotter, hull: np.ndarray, size: tuple[int, int]) -> _View:
    """Point the camera so that the animal fills the picture, in parallel projection."""
    ahead = _VIEW / np.linalg.norm(_VIEW)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, ahead)
    place = hull @ np.column_stack([right, up])
    low, high = place.min(0), place.max(0)
    middle = (low + high) / 2
    depth = hull.mean(0) @ ahead
    focus = middle[0] * right + middle[1] * up + depth * ahead
    aspect = size[0] / size[1]
    half_height = max((high[0] - low[0]) / aspect / _FILL, (high[1] - low[1]) / _FILL) / 2
    span = np.ptp(hull, axis=0).max()
    plotter.camera.parallel_projection = True
    plotter.camera.focal_point = focus
    plotter.camera.position = focus - 5 * span * ahead
    plotter.camera.up = up
    plotter.camera.parallel_scale = half_height
    plotter.camera.clipping_range = (0.5 * span, 10 * span)
    return _View(focus, right, up, plotter.window_size[1] / 2 / half_height)


def _write(
    picture: np.ndarray,
    creature: Creature,
    centres: np.ndarray,
    view: _View,
    legend: dict[str, str],
    notes: list[str],
    unit: float,
) -> None:
    """Write names, title, legend and notes, and draw a scale bar.

    Args:
        picture: bytes ``(height, width, 3)``, bottom row first.
        creature: that is drawn.
        centres: of its bodies, m.
        view: where the camera is.
        legend: what the colours mean.
        notes: about what is not in the picture.
        unit: pixels drawn for each of a letter's size.
    """
    height, width = picture.shape[:2]
    margin, small = 34 * unit, _SMALL * unit
    right = width - margin
    with lettering(picture) as draw:
        if len(creature.bodies) <= _MOST_NAMES:
            names, size = [body.name for body in creature.bodies], _NAME * unit
            middle = (centres - view.focus) @ np.column_stack([view.right, -view.up])
            places = [width / 2, height / 2] + view.pixels_per_metre * middle
            boxes = [(font(size).getlength(legible(name)), _LINE * size) for name in names]
            for name, place in zip(names, _apart(places, np.array(boxes)), strict=True):
                write(draw, name, tuple(place), size, _TEXT, anchor="mm", plate=_BACKGROUND)
        write(draw, creature.name, (margin, margin), 23 * unit, _TEXT, anchor="la")
        axes = sum(len(body.joint.axes) for body in creature.bodies if body.joint)
        words = [f"{len(creature.bodies)} bodies", f"{axes} degrees of freedom"]
        facts = ", ".join([*words, f"{creature.mass:.3g} kg", *notes])
        below = margin, margin + 36 * unit
        write(draw, facts, below, small, _TEXT, bold=False, anchor="la")
        for i, (meaning, color) in enumerate(legend.items()):
            write(draw, meaning, (right, margin + 24 * unit * i), small, color, anchor="ra")
        length = grid_spacing(width / view.pixels_per_metre / 3)
        left, foot, tick = right - length * view.pixels_per_metre, height - margin, 5 * unit
        for line in (
            (left, foot, right, foot),
            (left, foot - tick, left, foot + tick),
            (right, foot - tick, right, foot + tick),
        ):
            draw.line(line, _TEXT, round(2.5 * unit))
        middle_of_bar = (left + right) / 2, foot - 9 * unit
        write(draw, f"{length:g} m", middle_of_bar, small, _TEXT, bold=False, anchor="md")


def _apart(places: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Move labels up or down as little as needed that none covers another.

    Args:
        places: where their middles should be ``(n, 2)``, pixels.
        sizes: widths and heights ``(n, 2)``, pixels.
    """
    placed = np.array(places, float)
    # Half a line up, half a line down, a line up, and so on.
    steps = [sign * count / 2 for count in range(2 * len(placed)) for sign in (1, -1)]
    for i in range(1, len(placed)):
        for step in steps:
            placed[i, 1] = places[i, 1] + step * sizes[i, 1]
            gap = np.abs(placed[:i] - placed[i]) - (sizes[:i] + sizes[i]) / 2
            if (gap > 0).any(1).all():
                break
    return placed
