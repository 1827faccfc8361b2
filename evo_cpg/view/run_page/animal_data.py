"""Surfaces of an animal for `animal.js`, as JSON, and a crowd of ghosts in few bytes.

A function ``add`` stores an array of a kind, such as ``<f4``, and returns its name in the data.

Places in a crowd have 16 bits and rotations have 8 bits. If the numbers take too much room, there
are fewer instants per second, and then fewer animals. The viewer interpolates between instants.
"""

import math
from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pyvista as pv

from evo_cpg.creature.creature import Creature, neutral_pose
from evo_cpg.training.crowd_motion import CrowdMotion
from evo_cpg.view.ghosts import coarse
from evo_cpg.view.look import Look
from evo_cpg.view.meshes import BodySurface
from evo_cpg.view.scene import quaternions
from evo_cpg.view.skin import skins

Add = Callable[[Any, str], Any]

# Number of points up to which triangles have numbers of 16 bits.
_SHORT = 65536


def piece_data(piece: BodySurface, add: Add) -> dict[str, Any]:
    """Return a surface."""
    mesh = piece.mesh
    if mesh.point_data.active_normals is None:
        mesh = cast(pv.PolyData, mesh.compute_normals(split_vertices=False))
    normals = np.asarray(mesh.point_data.active_normals)
    made = surface_data(np.asarray(mesh.points), normals, mesh.regular_faces, add)
    if "rgb" in mesh.point_data:
        return made | {"colors": add(mesh["rgb"], "u1")}
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
        "triangles": add(faces, "<u4" if len(points) > _SHORT else "<u2"),
    }


# Most and least instants per second, and most bytes of numbers.
_RATE, _LEAST, _BYTES = 15.0, 8.0, 3e6
# Bytes of a body at an instant, and largest numbers of 16 and 8 bits.
_SIZE, _HALF, _BYTE = 10, 65535, 127


def crowd_data(creature: Creature, crowd: CrowdMotion, look: Look, add: Add) -> dict[str, Any]:
    """Return a crowd.

    Args:
        creature: the animal.
        crowd: motion of the others.
        look: look of the world.
        add: function that stores an array (see `evo_cpg.view.run_page.animal_data`).
    """
    crowd = thinned(crowd)
    low, high = (end(crowd.position, axis=(0, 1, 2)) for end in (np.min, np.max))
    size = np.maximum(high - low, 1e-9)
    place = np.round((crowd.position - low) / size * _HALF)
    return {
        "bodies": [_hull(body.shape, add) for body in creature.bodies],
        "count": crowd.count,
        "frames": len(crowd.time),
        "rate": 1 / float(np.diff(crowd.time[:2], append=1e9)[0]),
        "low": low.tolist(),
        "step": (size / _HALF).tolist(),
        "position": add(place, "<u2"),
        "rotation": add(np.round(quaternions(crowd.rotation) * _BYTE), "i1"),
        "color": look.ghost,
    }


def thinned(crowd: CrowdMotion) -> CrowdMotion:
    """Return a crowd of about 15 instants per second, or of as much as there is room for.

    Fewer than 8 instants per second look jerky. So the rest are left out evenly among the animals.
    """
    instants, animals, bodies = crowd.position.shape[:3]
    if instants < 2:
        return crowd
    step = float(crowd.time[1] - crowd.time[0])
    room = _BYTES / (_SIZE * bodies * animals)
    every = max(round(1 / (_RATE * step)), math.ceil(instants / max(room, 1)), 1)
    every = min(every, max(math.floor(1 / (_LEAST * step)), 1))
    shown = slice(None, None, every)
    crowd = crowd._replace(
        time=crowd.time[shown], position=crowd.position[shown], rotation=crowd.rotation[shown]
    )
    most = max(int(_BYTES / (_SIZE * bodies * len(crowd.time))), 1)
    if most >= animals:
        return crowd
    return crowd.of(np.linspace(0, animals - 1, most).round().astype(int))


def _hull(shape: Any, add: Add) -> dict[str, Any] | None:
    if not shape.exists:
        return None
    points, faces = coarse(shape)
    outwards = points / np.linalg.norm(points, axis=1, keepdims=True)
    return surface_data(points, outwards, faces, add)
