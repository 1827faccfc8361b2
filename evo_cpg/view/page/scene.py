"""What the viewer of a page shows: meshes, places and colours, as JSON.

Arrays are base64 of little-endian numbers; equal ones, such as the triangles of all boxes, are
written once.
"""

import base64
from typing import Any, cast

import numpy as np
import pyvista as pv
from jaxtyping import Float

from evo_cpg.creature.creature import Creature
from evo_cpg.physics.footing import Ground
from evo_cpg.physics.terrain import Plane
from evo_cpg.simulation.recording import Recording
from evo_cpg.view.camera import course, smooth
from evo_cpg.view.clip import sample
from evo_cpg.view.ground import grid_spacing, mark_spacing
from evo_cpg.view.meshes import body_colors, eye_meshes, head_index, shape_mesh
from evo_cpg.view.obstacles import obstacle_mesh
from evo_cpg.view.stage import animal_radius, seen_world
from evo_cpg.view.terrain import make_terrain
from evo_cpg.view.textures import CELLS

# Places a second: between them the viewer interpolates.
RATE = 30.0
# Window over which the way of the camera's focus is smoothed, s.
_CALM = 1.0
# The floor lies this many radii of the animal below the lowest point of its way through water, as
# in films; the mesh of uneven ground ends so many radii from the way.
_DEPTH, _FAR = 0.55, 14.0
# Range of a signed number of 16 bits.
_SHORT = 32767
# Corners of a stone that are enough for a page.
_FINE = 1500
_STONE = "#999188"
# What the viewer needs to know of a look.
_LOOK = (
    "distance", "floor", "grid", "sun", "fill", "trail", "light", "halo", "zenith", "checkered",
    "text", "particles",
)  # fmt: skip
_WHITE, _PUPIL = "#fdfdf8", "#10151c"


class _Arrays:
    """Arrays by number, each written once."""

    def __init__(self) -> None:
        self.written: list[str] = []
        self._numbers: dict[bytes, int] = {}

    def add(self, values: Any, kind: str) -> int:
        data = np.ascontiguousarray(values, kind).tobytes()
        if data not in self._numbers:
            self._numbers[data] = len(self.written)
            self.written.append(base64.b64encode(data).decode())
        return self._numbers[data]


def scene(
    creature: Creature,
    recording: Recording,
    ground: Ground | None,
    surface: float | None,
    in_water: bool,
) -> dict[str, Any]:
    """All that moves and stands.

    Args:
        creature: the animal.
        recording: its motion.
        ground: that carries it; None where a floor is only drawn.
        surface: height of the water's surface, m; None where there is none.
        in_water: whether there is water.
    """
    clip = sample(recording, RATE)
    arrays = _Arrays()
    radius = animal_radius(creature, clip)
    look, surface = seen_world(creature, clip, "water" if in_water else "land", ground, surface)
    lit = bool(np.isfinite(recording.goal).all())
    level = ground.level if ground is not None else None
    lowest = clip.position[..., 2].min() - max(body.shape.reach for body in creature.bodies)
    if lit:
        lowest = min(lowest, recording.goal[2])
    floor = float(level) if level is not None else float(lowest - _DEPTH * radius)
    terrain, shape = None, Plane(height=floor) if ground is None else ground.floor
    uneven = surface is not None if ground is None else level is None
    if uneven:
        way = clip.position.reshape(-1, 3)[:, :2]
        terrain = make_terrain(shape, way, radius, _FAR * radius)
    focus = smooth(clip.position.mean(1), _CALM * RATE)
    bearing = course(clip.position[:, head_index(creature)], recording.goal, radius / 10)
    spacing = grid_spacing(2 * radius) if ground is None else mark_spacing(2 * radius) / CELLS
    made = {
        "rate": RATE,
        "start": float(clip.time[0]),
        "count": len(clip.time),
        "bodies": _bodies(creature, arrays),
        "position": arrays.add(clip.position, "<f4"),
        "rotation": arrays.add(_quaternions(clip.rotation) * _SHORT, "<i2"),
        "focus": arrays.add(focus, "<f4"),
        "head": head_index(creature),
        "speed": arrays.add(clip.speed, "<f4"),
        "distance": arrays.add(clip.distance, "<f4"),
        "measured": "to the light" if lit else "way made",
        "radius": radius,
        "bearing": float(bearing),
        "floor": floor,
        "spacing": float(spacing),
        "terrain": None,
        "obstacles": [],
        "goal": [float(x) for x in recording.goal] if lit else None,
        "surface": None if surface is None else float(surface),
        "water": in_water and surface is None,
        "look": {name: getattr(look, name) for name in _LOOK},
    }
    if terrain is not None:
        made["terrain"] = {
            name: arrays.add(values, "<f4") for name, values in terrain._asdict().items()
        } | {"normals": arrays.add(terrain.normals() * 127, "i1")}
    for obstacle in ground.obstacles if ground is not None else ():
        mesh, place, turn = obstacle_mesh(obstacle)
        coarse = mesh.triangulate()
        if coarse.n_points > _FINE:
            coarse = coarse.decimate(1 - _FINE / coarse.n_points)
        made["obstacles"].append(
            _mesh(cast(pv.PolyData, coarse), _STONE, arrays)
            | {"place": place.tolist(), "turn": _quaternions(turn[None])[0].tolist()}
        )
    made["arrays"] = arrays.written
    return made


def _bodies(creature: Creature, arrays: _Arrays) -> list[dict[str, Any]]:
    colors = [pv.Color(color).hex_rgb for color in body_colors(creature)]
    found = [
        {"name": body.name, "parts": [_mesh(shape_mesh(body.shape), color, arrays)]}
        for body, color in zip(creature.bodies, colors, strict=True)
    ]
    for sensor in creature.light_sensors:
        parts = found[creature.body_index(sensor.body)]["parts"]
        for mesh, color in zip(eye_meshes(creature, sensor), (_WHITE, _PUPIL), strict=True):
            parts.append(_mesh(cast(pv.PolyData, mesh.decimate(0.7)), color, arrays))
    return found


def _mesh(mesh: pv.PolyData, color: str, arrays: _Arrays) -> dict[str, Any]:
    normals = mesh.point_data.active_normals
    if normals is None:
        mesh = cast(pv.PolyData, mesh.compute_normals(split_vertices=False))
        normals = mesh.point_data.active_normals
    return {
        "points": arrays.add(mesh.points, "<f4"),
        "normals": arrays.add(np.asarray(normals) * 127, "i1"),
        "triangles": arrays.add(mesh.regular_faces, "<u4"),
        "color": color,
    }


def _quaternions(rotation: Float[np.ndarray, "*n 3 3"]) -> Float[np.ndarray, "*n 4"]:
    """``x, y, z, w`` of rotation matrices."""
    # SciPy takes long to import.
    from scipy.spatial.transform import Rotation

    flat = np.asarray(rotation, float).reshape(-1, 3, 3)
    return Rotation.from_matrix(flat).as_quat().reshape(*rotation.shape[:-2], 4)
