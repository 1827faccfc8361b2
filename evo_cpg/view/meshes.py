"""How an animal looks: surfaces and eyes of its bodies in their own frames, and their colours.

Films, pages, glTF files, previews and the drawing page show the same surfaces. A skin over chains
is in `evo_cpg.view.skin`. The shell of a turtle has scutes above and a flat, pale belly.

Colours run from a warm head over cream to a cool tail. Orange and blue, with the lightest tone
between them, are clear with every common kind of colour blindness, and on sea and sand.
"""

import dataclasses
import functools
from typing import Any, NamedTuple, cast

import numpy as np
import pyvista as pv

from evo_cpg.creature.creature import Body, Creature, LightSensor, length_of, neutral_pose
from evo_cpg.creature.shapes import Box, Ellipsoid, Shape, SkinMesh
from evo_cpg.view.fins import fins
from evo_cpg.view.offscreen import grid_triangles, smooth_surface

_HEAD_TO_TAIL = ("#f4601f", "#f99b4f", "#f7e3b5", "#8fc7ee", "#4a78e0")
# Radius of an eye, relative to the body's smallest half size.
_EYE = 0.44
# Radius of an eye on a body without a shape, relative to the animal's length.
_EYE_ALONE = 0.02
# Points along a quarter of a box's edge that is not fine.
_FEW = 3
# Points of an eye around and from pole to pole.
_BALL = (20, 14)
# Eyes of an animal without light sensors: direction of its front, distance behind the foremost
# point, relative to the body's smallest half size, and direction of the left eye.
_FRONT, _SET_BACK = np.array([1.0, 0.0, 0.35]), 0.55
_FORWARD, _SIDE, _UP = 0.55, 0.8, 0.3
# The head of a blind animal has at least this fraction of the thickness of its thickest part.
_HEAD = 0.5
# Colours of an eye.
_WHITE, _PUPIL = "#fdfdf8", "#10151c"
# Brightness of bodies on the left (y > 0), which the camera sees on the far side if there is no
# light. Distance off the middle from which bodies count as left, relative to the outermost body.
_LEFT, _ASIDE = 0.72, 0.1


def head_index(creature: Creature) -> int:
    """Return the number of the body that carries the eyes, or of a blind animal's root."""
    if creature.light_sensors:
        return creature.body_index(creature.light_sensors[0].body)
    return creature.root_index


def body_colors(creature: Creature) -> np.ndarray:
    """Return colours ``(bodies, 3)``: red, green and blue from 0 to 1.

    A body without a colour of its own takes a palette colour by its number of joints from the head.
    Bodies on the animal's left are darker, so that left and right legs differ.
    """
    distance = _joints_from_head(creature)
    anchors = np.array([pv.Color(color).float_rgb for color in _HEAD_TO_TAIL])
    along = distance / max(distance.max(), 1) * (len(anchors) - 1)
    colors = np.column_stack([np.interp(along, range(len(anchors)), c) for c in anchors.T])
    across = neutral_pose(creature)[0][:, 1]
    colors[across > _ASIDE * np.abs(across).max(initial=1e-9)] *= _LEFT
    for i, body in enumerate(creature.bodies):
        if body.color is not None:
            colors[i] = pv.Color(body.color).float_rgb
    return colors


def painted(creature: Creature, color: str) -> Creature:
    """Return a creature in tones of one colour, from a pale head to a dark tail."""
    distance, own = _joints_from_head(creature), np.array(pv.Color(color).float_rgb)
    tones = np.interp(distance / max(distance.max(), 1), (0.0, 0.5, 1.0), (0.35, 0.0, -0.3))
    mixed = np.where(tones > 0, 1.0, 0.0)[:, None]
    colors = own + np.abs(tones)[:, None] * (mixed - own)
    bodies = (
        dataclasses.replace(body, color=pv.Color(each).hex_rgb)
        for body, each in zip(creature.bodies, colors, strict=True)
    )
    return dataclasses.replace(creature, bodies=tuple(bodies))


def _joints_from_head(creature: Creature) -> np.ndarray:
    """Return the number of joints between the head and each body, as floats."""
    links = [
        (i, creature.body_index(body.joint.parent), int(body.whole is None))
        for i, body in enumerate(creature.bodies)
        if body.joint
    ]
    joints_away = {head_index(creature): 0}
    while len(joints_away) < len(creature.bodies):
        for body, parent, joints in links:
            for here, there in ((body, parent), (parent, body)):
                if here in joints_away and there not in joints_away:
                    joints_away[there] = joints_away[here] + joints
    return np.array([joints_away[i] for i in range(len(creature.bodies))], float)


def shape_mesh(shape: Shape) -> pv.PolyData:
    """Return the surface of a shape in its own frame, m, with normals for smooth shading.

    A mesh's edges stay sharp, because every triangle has corners of its own. A triangle without
    area has no normal and is left out.
    """
    return _surface(shape.skin())


def _surface(skin: SkinMesh) -> pv.PolyData:
    points, normals, faces = skin
    mesh = pv.PolyData.from_regular_faces(points, faces)
    mesh.point_data.active_normals = normals
    return mesh


def eye_meshes(creature: Creature, sensor: LightSensor) -> tuple[pv.PolyData, pv.PolyData]:
    """Return white and pupil of an eye, in the frame of the body that carries it.

    A sensor inside the body is drawn where its line of sight leaves the body.
    """
    shape = creature.bodies[creature.body_index(sensor.body)].shape
    radius = _EYE * shape.half_extents.min() or _EYE_ALONE * length_of(creature)
    axis = np.array(sensor.axis) / np.linalg.norm(sensor.axis)
    reach = np.linspace(0, 2 * shape.half_extents.max(), 200)
    sight = np.array(sensor.position) + reach[:, None] * axis
    outside = shape.distance(sight) >= 0
    centre = sight[outside.argmax()] if outside.any() else sight[0]
    ball = functools.partial(pv.Sphere, theta_resolution=_BALL[0], phi_resolution=_BALL[1])
    centre = centre - 0.35 * radius * axis
    pupil = ball(radius=0.72 * radius, center=centre + 0.42 * radius * axis)
    return ball(radius=radius, center=centre), pupil


def drawn_eyes(creature: Creature) -> list[LightSensor]:
    """Return two eyes at the front of a blind animal's root body. They are only drawn."""
    own = {creature.bodies[creature.root_index].name}
    own |= {body.name for body in creature.bodies if body.whole in own}
    centres, rotations = neutral_pose(creature)
    solid = [i for i, body in enumerate(creature.bodies) if body.name in own and body.shape.exists]
    if not solid:
        return []

    thick = {i: float(creature.bodies[i].shape.half_extents.min()) for i in solid}
    solid = [i for i in solid if thick[i] >= _HEAD * max(thick.values())]
    front = {
        i: np.asarray(creature.bodies[i].shape.support(rotations[i].T @ _FRONT), float)
        for i in solid
    }
    head = max(solid, key=lambda i: (centres[i] + rotations[i] @ front[i]) @ _FRONT)
    body, foremost = creature.bodies[head].name, front[head]
    place = foremost * (1 - _SET_BACK * thick[head] / np.linalg.norm(foremost))
    axes = (rotations[head].T @ [_FORWARD, side, _UP] for side in (_SIDE, -_SIDE))
    return [LightSensor(body, tuple(place), tuple(axis), np.pi) for axis in axes]


class BodySurface(NamedTuple):
    """A surface that moves with a body, in the body's frame.

    Attributes:
        mesh: the surface. An array ``rgb`` holds the colours of its points, if they differ.
        color: colour of the surface, as six hexadecimal digits after ``#``.
        name: name of a part of an eye, such as ``pupil1``, or empty for the body's own surface.
    """

    mesh: pv.PolyData
    color: str
    name: str = ""

    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return points ``(n, 3)``, their normals ``(n, 3)`` and triangles ``(f, 3)``."""
        mesh = self.mesh
        if mesh.point_data.active_normals is None:
            mesh = cast(pv.PolyData, mesh.compute_normals(split_vertices=False))
        normals = np.asarray(mesh.point_data.active_normals)
        return np.asarray(mesh.points), normals, mesh.regular_faces

    @property
    def colors(self) -> np.ndarray:
        """Red, green and blue of every point ``(n, 3)``, 0 to 255."""
        if "rgb" in self.mesh.point_data:
            return np.asarray(self.mesh["rgb"])
        return np.tile(pv.Color(self.color).int_rgb, (self.mesh.n_points, 1)).astype(np.uint8)


def surfaces(creature: Creature, fine: bool = True) -> list[pv.PolyData]:
    """Return the drawn surface of every body in its own frame, m: its shape, a fin or a shell.

    Boxes have a quarter of the points if they need not be ``fine``.
    """
    finned, colors, found = fins(creature), body_colors(creature), []
    for i, body in enumerate(creature.bodies):
        if i in finned:
            found.append(finned[i].mesh())
        elif body.name in _SHELLS and isinstance(body.shape, Ellipsoid):
            found.append(_shell_mesh(body, colors[i]))
        elif isinstance(body.shape, Box) and not fine:
            found.append(_surface(body.shape.skin(_FEW)))
        else:
            found.append(shape_mesh(body.shape))
    return found


def pieces(creature: Creature, fine: bool = True) -> list[list[BodySurface]]:
    """Return the pieces of every body: its own surface, then white and pupil of its eyes.

    See `surfaces` for ``fine``.
    """
    colors = [pv.Color(color).hex_rgb for color in body_colors(creature)]
    found = [
        [BodySurface(mesh, color)]
        for mesh, color in zip(surfaces(creature, fine), colors, strict=True)
    ]
    for number, sensor in enumerate(creature.light_sensors or drawn_eyes(creature), 1):
        white, pupil = eye_meshes(creature, sensor)
        found[creature.body_index(sensor.body)] += [
            BodySurface(white, _WHITE, f"eye{number}"),
            BodySurface(pupil, _PUPIL, f"pupil{number}"),
        ]
    return found


def add_bodies(plotter: pv.Plotter, creature: Creature, ambient: float) -> list[list[pv.Actor]]:
    """Draw the bodies and eyes, each in its own frame at the origin.

    Return the actors of each body, to be moved together.
    """
    skin = {"ambient": ambient, "diffuse": 0.8, "specular": 0.25, "specular_power": 18}
    finish = {False: skin, True: {"ambient": 0.4, "specular": 0.8}}
    actors: list[list[pv.Actor]] = []
    for own in pieces(creature):
        actors.append([])
        for piece in own:
            paint: dict[str, Any] = {"color": piece.color}
            if "rgb" in piece.mesh.point_data:
                paint = {"scalars": "rgb", "rgb": True, "show_scalar_bar": False}
            paint |= finish[bool(piece.name)] | {"smooth_shading": True, "culling": "back"}
            actors[-1].append(plotter.add_mesh(piece.mesh, **paint))
    return actors


# Bodies with these names that are ellipsoids are drawn as shells.
_SHELLS = ("shell", "carapace")
# Middles of scutes from above, relative to the half length and half width: in a row along the
# middle, in a row on each side, and around the rim.
_MIDDLE = [(x, 0.0) for x in (0.72, 0.36, 0.0, -0.36, -0.72)]
_BESIDE = [(x, side) for x in (0.52, 0.18, -0.18, -0.52) for side in (0.48, -0.48)]
_RIM, _AT_RIM = 22, 0.97
# Width of a seam between scutes, its depth, and its brightness. Brightness of a scute's middle.
# Size of that middle.
_SEAM, _DEPTH, _DARK, _PALE, _MIDDLE_SIZE = 0.075, 0.03, 0.5, 1.3, 0.12
# Depth of the belly relative to the ellipsoid, and its colour, red, green and blue.
_BELLY, _BELLY_COLOR = 0.6, np.array([0.86, 0.78, 0.55])
# Rings from the middle to the rim, and points around.
_OUT, _AROUND = 25, 64
# The belly has a ring of points for this many rings above.
_COARSER = 4


def _shell_mesh(body: Body, color: np.ndarray) -> pv.PolyData:
    """Return the surface of a shell in its own frame, m, with colours ``rgb`` of its points.

    Args:
        body: the body, an ellipsoid.
        color: colour of the scutes: red, green and blue from 0 to 1.
    """
    out, half = np.linspace(0, np.pi / 2, _OUT), np.asarray(body.shape.half_extents, float)
    flat, height, faces = _dome(out)
    # Scutes are the Voronoi cells of their middles. Those of the rim are narrow.
    around = 2 * np.pi * (np.arange(_RIM) + 0.5) / _RIM
    rim = _AT_RIM * np.column_stack([np.cos(around), np.sin(around)])
    middles = np.array([*_MIDDLE, *_BESIDE, *rim])
    narrow = np.concatenate([np.zeros(len(_MIDDLE) + len(_BESIDE)), np.full(_RIM, 0.12)])
    away = np.linalg.norm(flat[:, None] - middles, axis=-1) + narrow
    far, next_ = np.sort(away, axis=1)[:, :2].T
    # 0 in a seam to 1 on a scute.
    part = np.clip((next_ - far) / _SEAM, 0, 1)
    scute = part * part * (3 - 2 * part)
    # Seams end at the rim, where the belly begins.
    seam = _DEPTH * (1 - scute) * np.sqrt(height)
    above = np.column_stack([flat, height]) * (1 - seam)[:, None]
    tone = _DARK + (1 + (_PALE - 1) * np.exp(-((far / _MIDDLE_SIZE) ** 2)) - _DARK) * scute
    top = smooth_surface(above * half, faces)
    top["rgb"] = np.round(255 * np.minimum(color * tone[:, None], 1)).astype(np.uint8)
    flat, height, faces = _dome(out[::_COARSER])
    belly = smooth_surface(np.column_stack([flat, -_BELLY * height]) * half, faces[:, ::-1])
    belly["rgb"] = np.tile(np.round(255 * _BELLY_COLOR).astype(np.uint8), (len(flat), 1))
    return cast(pv.PolyData, pv.merge([top, belly], merge_points=False))


def _dome(out: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return places ``(n, 2)``, heights ``(n,)`` and triangles ``(m, 3)`` of a half sphere.

    The rings have angles ``out`` from the middle, rad.
    """
    around = 2 * np.pi * np.arange(_AROUND) / _AROUND
    ring = np.stack([np.cos(around), np.sin(around)], -1)
    flat = (np.sin(out)[:, None, None] * ring).reshape(-1, 2)
    grid = np.arange(len(flat)).reshape(-1, _AROUND)
    faces = grid_triangles(np.column_stack([grid, grid[:, 0]]))
    # The first ring is one point, so half of its triangles have no area. The rim is level.
    faces = faces[(faces < _AROUND).sum(1) < 2]
    return flat, np.repeat(np.maximum(np.cos(out), 0).round(9), _AROUND), faces
