"""Still of a body plan at rest, with names, joint axes, sensors and scale.

The scene is the one of a film, in pale colours and parallel projection.
"""

import dataclasses
import math
import os
from pathlib import Path

import numpy as np
import pyvista as pv

from evo_cpg.creature.creature import Creature, lowest_height, neutral_pose
from evo_cpg.files import in_one_piece
from evo_cpg.physics.contact.contact_model import Ground
from evo_cpg.physics.contact.terrain import Plane
from evo_cpg.simulation.recording import Recording
from evo_cpg.view.camera import VIEW_ANGLE, CameraPath, level_axes
from evo_cpg.view.drawing import set_scene
from evo_cpg.view.legible import font, legible, lettering, write
from evo_cpg.view.look import STYLES
from evo_cpg.view.meshes import add_bodies, shape_mesh
from evo_cpg.view.offscreen import canvas
from evo_cpg.view.output import check_size, output_path, oversampling, picture_of
from evo_cpg.view.scene import Panel, Scene, grid_spacing, sample, scene_of
from evo_cpg.view.skin import drape
from evo_cpg.view.stage import Stage
from evo_cpg.view.terrain import obstacle_mesh

# Pale looks of dry land, a shore and the bottom of the sea, so that names and axes stand out.
_BACKGROUND = "#f4f6f8"
_DRY = dataclasses.replace(
    STYLES["land"],
    distance=_BACKGROUND,
    floor=("#d3cab8", "#ece5d8"),
    grid="#a89c84",
    cast_strength=0.0,
    visibility=1.7,
)
_SHORE = dataclasses.replace(_DRY, distance="#dcedf3")
_SUNK = dataclasses.replace(_DRY, distance="#cde5ec", floor=("#86b5bd", "#a9d0d4"), grid="#4f8b95")
_TEXT = "#1d2530"
# Okabe and Ito's palette, which is clear with every common kind of colour blindness.
_AXES = {"x": "#D55E00", "y": "#009E73", "z": "#0072B2"}
_OTHER_AXIS = "#6b7280"
_SIGHT = "#E69F00"
_PRESSURE = "#CC79A7"
_DEPTH = "#56B4E9"
# The camera looks along this direction, onto the animal's left front.
_AHEAD = np.array([-0.55, -0.95, -0.62]) / np.linalg.norm([-0.55, -0.95, -0.62])
_RIGHT = level_axes(_AHEAD)[0]
_UP = np.cross(_RIGHT, _AHEAD)
# Fraction of the picture that the animal fills.
_FILL = 0.72
# Opacity of the bodies, which lets the joints inside show.
_OPACITY = 0.72
# Obstacles nearer than this many lengths of the creature are in the picture.
_NEAR = 5.5
# Names of more bodies than this would cover the picture.
_MOST_NAMES = 24
# Sizes of a name and of other text, and height of a name's line relative to its size.
_NAME, _SMALL, _LINE = 13.5, 16, 1.35
_OVERSAMPLING = 2
# Smallest picture with room for text, and the picture for which the text sizes are meant.
_ROOM, _SCREEN = (320, 180), (1280, 720)


def preview_path(path: str | os.PathLike[str], size: tuple[int, int]) -> Path:
    """Return a path to which a preview of a size (pixels) can be drawn.

    Raises:
        OutputError: the path cannot be written, or is not a ``.png`` file.
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
    """Draw a creature in its neutral pose, or in another pose, and return the path.

    Args:
        creature: creature to draw.
        path: name of a ``.png`` file.
        size: width and height, pixels.
        ground: ground under the creature, with its obstacles, in the world's frame. True means
            level ground under its lowest point.
        pose: centres ``(bodies, 3)`` in m and rotations ``(bodies, 3, 3)``, in the world's frame,
            or None for the neutral pose.
        surface: height of the water in the world's frame, m. Infinity means water everywhere, None
            no water.

    Raises:
        OutputError: the path cannot be written, or is not a ``.png`` file.
        CreatureError: the bodies do not form one tree.
        SettingError: the size is too small, or too large.
    """
    path = preview_path(path, size)
    rest = neutral_pose(creature) if pose is None else pose
    if ground is True:
        ground = Ground(floor=Plane(height=float(lowest_height(creature, rest))))
    none, start, nowhere = np.zeros((1, 0)), np.zeros(1), np.full((1, 3), np.nan)
    instant = (start, rest[0][None], rest[1][None], none, none, none, none, start, nowhere, ())
    recording = Recording(*instant)
    world = "land" if surface is None else "water"
    seen = surface if surface is not None and math.isfinite(surface) else None
    panel = Panel(creature, recording, world=world, ground=ground or None, surface=seen)
    scene = scene_of(panel, sample(recording, 1.0))
    dry = _DRY if surface is None else _SUNK
    scene = scene._replace(look=dry if scene.surface is None else _SHORE)
    rest = scene.clip.position[0], scene.clip.rotation[0]
    hull = np.concatenate(
        [
            np.asarray(shape_mesh(body.shape).points) @ turn.T + centre
            for body, centre, turn in zip(creature.bodies, *rest, strict=True)
        ]
    )
    stones, far = obstacles_near(scene.ground, hull)
    shown = np.concatenate([hull, stones])
    middle = (shown.min(0) + shown.max(0)) / 2
    scene = scene._replace(radius=float(np.linalg.norm(shown - middle, axis=1).max()))
    # The shown points fill the picture.
    axes = np.stack([_RIGHT, _UP])
    across = shown @ axes.T
    low, high = across.min(0), across.max(0)
    focus = (low + high) / 2 @ axes + shown.mean(0) @ _AHEAD * _AHEAD
    width, height = (high - low) / _FILL
    eye = focus - 5 * np.ptp(shown, axis=0).max() * _AHEAD
    camera = CameraPath(eye[None], focus[None], VIEW_ANGLE)
    half_height = float(max(width * size[1] / size[0], height) / 2)
    finer = oversampling(size, _OVERSAMPLING)
    rendered = round(size[0] * finer), round(size[1] * finer)
    with canvas(rendered) as plotter:
        bodies = add_bodies(plotter, creature, scene.look.ambient)
        show = set_scene(Stage(plotter, scene, camera, finer), bodies, skins=False)
        plotter.camera.parallel_projection = True
        plotter.camera.parallel_scale = half_height
        draped = drape(plotter, creature, scene.look.ambient)
        for skin, _ in draped:
            skin.move(*rest)
        thin = scene.half_extents.min(1)
        # Half the thickness of a typical body, m.
        scale = float(np.median(thin[thin > 0]))
        legend = _add_signs(plotter, scene, scale)
        opaque = show(0)
        for actor in [body for body, *_ in bodies] + [actor for _, actor in draped]:
            actor.visibility = False
        picture = (_OPACITY * opaque + (1 - _OPACITY) * show(0)).astype(np.uint8)
    notes = [f"{far} obstacle{'s' if far > 1 else ''} farther away"] if far else []
    if surface is not None:
        notes.append(water_note(surface, hull))
    if size[0] >= _ROOM[0] and size[1] >= _ROOM[1]:
        unit = finer * max(min(size[0] / _SCREEN[0], size[1] / _SCREEN[1]), 0.5)
        pixels_per_metre = rendered[1] / 2 / half_height
        offset = (rest[0] - camera.focus[0]) @ np.column_stack([_RIGHT, -_UP])
        places = np.array(rendered) / 2 + pixels_per_metre * offset
        _write(picture, creature, places, pixels_per_metre, legend, notes, unit)
    with in_one_piece(path) as partial:
        picture_of(picture, size).save(partial)
    return path


def obstacles_near(ground: Ground, hull: np.ndarray) -> tuple[np.ndarray, int]:
    """Return points of near obstacles ``(n, 3)``, m, and the number of obstacles farther away.

    The hull holds points of the creature ``(n, 3)``, m.
    """
    middle = (hull.min(0) + hull.max(0)) / 2
    length = float(np.ptp(hull, axis=0).max())
    near, far = [np.zeros((0, 3))], 0
    for obstacle in ground.obstacles:
        mesh, place, turn = obstacle_mesh(obstacle)
        points = np.asarray(mesh.points) @ turn.T + place
        if np.linalg.norm(points - middle, axis=1).min() <= _NEAR * length:
            near.append(points)
        else:
            far += 1
    return np.concatenate(near), far


def water_note(surface: float, hull: np.ndarray) -> str:
    """Return a phrase about a hull of points ``(n, 3)``, m, and water up to a surface, m."""
    low, high = float(hull[:, 2].min()), float(hull[:, 2].max())
    if surface == math.inf:
        return "water everywhere"
    if surface >= high:
        return f"{surface - high:.2g} m under water"
    return "partly under water" if surface > low else f"{low - surface:.2g} m above the water"


def _add_signs(plotter: pv.Plotter, scene: Scene, scale: float) -> dict[str, str]:
    """Draw joint axes, lines of sight and sensors, and return their colours by meaning."""
    creature, arrows, balls, meaning = scene.creature, [], [], {}
    places = zip(creature.bodies, scene.clip.position[0], scene.clip.rotation[0], strict=True)
    posed = {body.name: (body, centre, turn) for body, centre, turn in places}
    for body, centre, turn in posed.values():
        joint = creature.joint_of(body)
        if joint is None:
            continue
        anchor = centre + turn @ np.array(joint.child_anchor)
        for axis, *_ in joint.dofs:
            names = [n for n, unit in zip("xyz", np.eye(3), strict=True) if np.allclose(axis, unit)]
            name = names[0] if names else "other"
            color = _AXES.get(name, _OTHER_AXIS)
            meaning[f"{name} axis" if names else "other axis, such as -z"] = color
            # Long enough to stick out of the bodies on either side.
            arrows.append((anchor, turn @ np.array(axis), 2.1, color))
    meaning = dict(sorted(meaning.items()))
    for sensor in creature.light_sensors:
        _, centre, turn = posed[sensor.body]
        eye = centre + turn @ np.array(sensor.position)
        arrows.append((eye, turn @ np.array(sensor.axis), 3.2, _SIGHT))
        meaning["line of sight"] = _SIGHT
    for gauge in creature.depth_sensors:
        _, centre, turn = posed[gauge.body]
        balls.append((centre + turn @ np.array(gauge.position), 0.3, _DEPTH))
        meaning["depth gauge"] = _DEPTH
    for name in creature.pressure_sensors if scene.stands else ():
        body, centre, turn = posed[name]
        for outward in (*np.eye(3)[1:], *-np.eye(3)[1:]):
            balls.append((centre + turn @ body.shape.support(outward), 0.22, _PRESSURE))
        meaning["pressure sensor"] = _PRESSURE
    for start, direction, length, color in arrows:
        arrow = pv.Arrow(
            start=start,
            direction=direction,
            scale=length * scale,
            shaft_radius=0.022,
            tip_radius=0.065,
            tip_length=0.2,
        )
        plotter.add_mesh(arrow, color=color, ambient=0.6, diffuse=0.5, render=False)
    for place, size, color in balls:
        ball = pv.Sphere(radius=size * scale, center=place)
        plotter.add_mesh(ball, color=color, lighting=False, render=False)
    return meaning


def _write(
    picture: np.ndarray,
    creature: Creature,
    places: np.ndarray,
    pixels_per_metre: float,
    legend: dict[str, str],
    notes: list[str],
    unit: float,
) -> None:
    """Write names, title, legend and notes, and draw a scale bar.

    Args:
        picture: bytes ``(height, width, 3)``, bottom row first.
        creature: creature in the picture.
        places: places of its bodies, pixels to the right and down.
        pixels_per_metre: scale of the picture.
        legend: colours by meaning.
        notes: remarks on things outside the picture.
        unit: pixels drawn per unit of a letter's size.
    """
    height, width = picture.shape[:2]
    margin, small = 34 * unit, _SMALL * unit
    right = width - margin
    with lettering(picture) as draw:
        if len(creature.bodies) <= _MOST_NAMES:
            names, size = [body.name for body in creature.bodies], _NAME * unit
            boxes = [(font(size).getlength(legible(name)), _LINE * size) for name in names]
            for name, place in zip(names, _apart(places, np.array(boxes)), strict=True):
                write(draw, name, tuple(place), size, _TEXT, anchor="mm", plate=_BACKGROUND)
        write(draw, creature.name, (margin, margin), 23 * unit, _TEXT, anchor="la")
        joints = filter(None, map(creature.joint_of, creature.bodies))
        axes = sum(len(joint.dofs) for joint in joints)
        words = [f"{len(creature.bodies)} bodies", f"{axes} degrees of freedom"]
        facts = ", ".join([*words, f"{creature.mass:.3g} kg", *notes])
        below = margin, margin + 36 * unit
        write(draw, facts, below, small, _TEXT, bold=False, anchor="la")
        for i, (meaning, color) in enumerate(legend.items()):
            write(draw, meaning, (right, margin + 24 * unit * i), small, color, anchor="ra")
        length = grid_spacing(width / pixels_per_metre / 3)
        left, foot, tick = right - length * pixels_per_metre, height - margin, 5 * unit
        for line in (
            (left, foot, right, foot),
            (left, foot - tick, left, foot + tick),
            (right, foot - tick, right, foot + tick),
        ):
            draw.line(line, _TEXT, round(2.5 * unit))
        middle_of_bar = (left + right) / 2, foot - 9 * unit
        write(draw, f"{length:g} m", middle_of_bar, small, _TEXT, bold=False, anchor="md")


def _apart(places: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Move middles ``(n, 2)`` of labels up or down as little as possible, so that none overlap."""
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
