"""Surfaces of an animal for `animal.js`, as JSON.

A function ``add`` stores an array of a kind, such as ``<f4``, and returns its name in the data.
"""

from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pyvista as pv

from evo_cpg.creature.creature import Creature, neutral_pose
from evo_cpg.view.clip import quaternions
from evo_cpg.view.meshes import Piece
from evo_cpg.view.skin import skins

Add = Callable[[Any, str], Any]

# Number of points up to which triangles have numbers of 16 bits.
_SHORT = 65536


def piece_data(piece: Piece, add: Add) -> dict[str, Any]:
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
