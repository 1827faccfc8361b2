"""Data of a page's viewer: meshes, places and colours, as JSON.

Arrays are base64 of little-endian numbers. A function ``add`` stores an array of a kind, such as
``<f4``, and returns its name in the data, so that equal arrays are written once.

The viewer interpolates between instants.
"""

import base64
from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pyvista as pv

from evo_cpg.creature.creature import Creature, neutral_pose
from evo_cpg.simulation.recording import Recording
from evo_cpg.view.camera import smooth
from evo_cpg.view.meshes import BodySurface, head_index, pieces
from evo_cpg.view.offscreen import CELLS
from evo_cpg.view.scene import Clip, Exhibit, Panel, quaternions, sample, scene_of
from evo_cpg.view.skin import skins
from evo_cpg.view.terrain import obstacle_mesh
from evo_cpg.view.wall import ELEVATION, TILE, hung

# Frames per second. The viewer interpolates between them.
RATE = 30.0
# Window over which the path of the camera's focus is smoothed, s.
_CALM = 1.0
# The mesh of uneven ground ends this many radii of the animal beyond its path and the light.
_FAR = 14.0
# Range of a signed number of 16 bits.
_SHORT = 32767
# Number of corners to which finer meshes of stones are reduced.
_FINE = 1500
_STONE = "#999188"
# Fields of a look that the viewer uses.
_LOOK = (
    "distance", "floor", "grid", "sun", "fill", "trail", "light", "halo", "zenith", "checkered",
    "text", "particles",
)  # fmt: skip


# Number of points up to which triangles have numbers of 16 bits.
_MANY = 65536
# Instants per second on a wall. Radius for the viewer's camera, relative to the visible height of
# the wall, bearing at which the camera is in front of it, and its elevation, rad.
WALL_RATE, _WHOLE, _FRONT, _LEVEL = 15.0, 0.43, -0.35, 0.1
# Factor of its size by which a wall on the ground is farther away.
_NEARER = 1.2

Add = Callable[[Any, str], Any]


def packed(values: Any, kind: str) -> str:
    """Return an array of a kind, such as ``<f4``, as base64."""
    return base64.b64encode(np.ascontiguousarray(values, kind).tobytes()).decode()


class Arrays:
    """Base64 texts of arrays. Equal arrays share a text and its number.

    Attributes:
        written: the texts.
    """

    def __init__(self) -> None:
        self.written: list[str] = []
        self._numbers: dict[str, int] = {}

    def add(self, values: Any, kind: str) -> int:
        """Add an array of a kind, such as ``<f4``, and return its number."""
        text = packed(values, kind)
        if text not in self._numbers:
            self._numbers[text] = len(self.written)
            self.written.append(text)
        return self._numbers[text]


def viewer_data(panel: Panel) -> dict[str, Any]:
    """Return all moving and fixed things in the scene of an animal."""
    clip = sample(panel.recording, RATE)
    scene, arrays = scene_of(panel, clip), Arrays()
    level, head = scene.level, head_index(scene.creature)
    terrain = None
    if level is None:
        land = scene.terrain(_FAR * scene.radius)
        terrain = {name: arrays.add(values, "<f4") for name, values in land._asdict().items()}
        terrain["normals"] = arrays.add(land.normals() * 127, "i1")
    # Equal arrays are written once, and have the number of the first one.
    animal, motion = animal_data(scene.creature, arrays), _motion(clip, arrays)
    speed, distance = arrays.add(clip.speed, "<f4"), arrays.add(clip.distance, "<f4")
    obstacles = []
    for obstacle in scene.ground.obstacles:
        mesh, place, turn = obstacle_mesh(obstacle)
        mesh = mesh.triangulate()
        if mesh.n_points > _FINE:
            mesh = mesh.decimate(1 - _FINE / mesh.n_points)
        made = piece_data(BodySurface(cast(pv.PolyData, mesh), _STONE), arrays.add)
        turned = quaternions(turn[None])[0].tolist()
        obstacles.append(made | {"place": place.tolist(), "turn": turned})
    return {
        "start": float(clip.time[0]),
        **animal,
        **motion,
        "head": head,
        "speed": speed,
        "distance": distance,
        "measured": scene.measured,
        "radius": scene.radius,
        "bearing": scene.bearing,
        "floor": float(clip.position[..., 2].min()) if level is None else level,
        "spacing": scene.marks.spacing / CELLS,
        "terrain": terrain,
        "obstacles": obstacles,
        "surface": None if scene.surface is None else float(scene.surface),
        "water": panel.world == "water" and scene.surface is None,
        "look": {name: getattr(scene.look, name) for name in _LOOK},
        # Last, because the entries above add arrays.
        "arrays": arrays.written,
    }


def wall_data(panel: Panel, aspect: float) -> dict[str, Any]:
    """Return all things on a wall, for a picture of about an aspect (width over height)."""
    clip = sample(panel.recording, WALL_RATE)
    scene, arrays = hung(panel, clip, aspect), Arrays()
    wall, position, rotation = scene.wall, scene.clip.position, scene.clip.rotation
    assert wall is not None
    herd, first = [], 0
    for one, drift in zip(panel.exhibits, np.moveaxis(wall.drift, 1, 0), strict=True):
        own = slice(first, first := first + len(one.creature.bodies))
        motion = {
            "position": arrays.add(position[:, own], "<f4"),
            "rotation": arrays.add(quaternions(rotation[:, own]) * _SHORT, "<i2"),
            "drift": arrays.add(drift, "<f4") if scene.stands else None,
            "words": exhibit_words(one),
        }
        herd.append(animal_data(one.creature, arrays, fine=False) | motion)
    across, upright = np.ptp(wall.middles, axis=0)[[0, 1 if scene.stands else 2]] + wall.cell
    # On the ground, the first row is nearer than the others.
    high, near = (upright * np.sin(ELEVATION), _NEARER) if scene.stands else (upright, 1.0)
    return {
        "start": float(clip.time[0]),
        "rate": clip.rate,
        "count": len(clip.time),
        "focus": arrays.add(np.zeros((len(clip.time), 3)), "<f4"),
        "herd": herd,
        "tiles": {"middles": wall.middles.tolist(), "size": (TILE * wall.cell).tolist()},
        # The camera of the viewer is this many radii away, so that the wall fills its picture.
        "radius": _WHOLE * near * float(max(high, across / aspect)),
        "bearing": _FRONT,
        "elevation": float(ELEVATION) if scene.stands else _LEVEL,
        "floor": float(scene.ground.level or 0.0),
        "spacing": scene.marks.spacing / CELLS,
        "obstacles": [],
        **dict.fromkeys(("terrain", "light", "surface")),
        "water": panel.world == "water",
        "look": {name: getattr(scene.look, name) for name in _LOOK},
        "arrays": arrays.written,
    }


def exhibit_words(one: Exhibit) -> str:
    """Return number, fitness, ancestor and number of bodies of an animal on a wall."""
    line = "" if one.founder is None else f", line {one.founder}"
    bodies = f"{len(one.creature.bodies)} bodies"
    return f"animal {one.number}: fitness {one.fitness:.3g}, {bodies}{line}"


def animal_data(creature: Creature, arrays: Arrays, fine: bool = True) -> dict[str, Any]:
    """Return the surfaces of an animal. See `evo_cpg.view.meshes.surfaces` for ``fine``."""
    bodies = [
        {"name": body.name, "parts": [piece_data(piece, arrays.add) for piece in own]}
        for body, own in zip(creature.bodies, pieces(creature, fine), strict=True)
    ]
    return {"bodies": bodies, **skin_data(creature, arrays.add)}


def motion_data(recording: Recording, rate: float, seconds: float) -> dict[str, Any]:
    """Return the motion of an animal without its scene."""
    arrays = Arrays()
    made = _motion(sample(recording, rate, seconds=seconds), arrays)
    return made | {"arrays": arrays.written}


def _motion(clip: Clip, arrays: Arrays) -> dict[str, Any]:
    # A light that rests has one place.
    light = clip.light if np.ptp(clip.light, axis=0).any() else clip.light[:1]
    return {
        "rate": clip.rate,
        "count": len(clip.time),
        "position": arrays.add(clip.position, "<f4"),
        "rotation": arrays.add(quaternions(clip.rotation) * _SHORT, "<i2"),
        "focus": arrays.add(smooth(clip.position.mean(1), _CALM * clip.rate), "<f4"),
        "light": arrays.add(light, "<f4") if np.isfinite(light).all() else None,
    }


def piece_data(piece: BodySurface, add: Add) -> dict[str, Any]:
    """Return a surface."""
    made = surface_data(*piece.arrays(), add)
    if "rgb" in piece.mesh.point_data:
        return made | {"colors": add(piece.colors, "u1")}
    return made | {"color": piece.color}


def skin_data(creature: Creature, add: Add) -> dict[str, Any]:
    """Return the skins of an animal, and the pose in which they are given."""
    centres, rotations = map(np.asarray, neutral_pose(creature))
    made = []
    for skin in skins(creature):
        weights = np.zeros((len(skin.points), 4), np.uint8)
        weights[:, 0] = np.round(255 * skin.weights[:, 0])
        # Bytes that add up to 255 add up to 1.
        weights[:, 1] = 255 - weights[:, 0]
        bodies = np.zeros_like(weights, np.uint16)
        bodies[:, :2] = skin.bodies
        surface = surface_data(skin.points, skin.normals, skin.faces, add)
        made.append(
            surface
            | {
                "colors": add(skin.colors, "u1"),
                "bodies": add(bodies, "<u2"),
                "weights": add(weights, "u1"),
            }
        )
    turns = quaternions(rotations[None])[0]
    rest = {"place": add(centres, "<f4"), "turn": add(turns, "<f4")} if made else None
    return {"skins": made, "rest": rest}


def surface_data(
    points: np.ndarray, normals: np.ndarray, faces: np.ndarray, add: Add
) -> dict[str, Any]:
    """Return a surface without colour: points and normals ``(n, 3)``, triangles ``(f, 3)``."""
    return {
        "points": add(points, "<f4"),
        "normals": add(np.asarray(normals) * 127, "i1"),
        "triangles": add(faces, "<u4" if len(points) > _MANY else "<u2"),
    }
