"""Overlap depth of two arbitrary convex shapes."""

import numpy as np
from jaxtyping import Float

from evo_cpg.creature.shapes import Shape

# Number of initial directions, and number of rounds that try directions near the best one.
_DIRECTIONS, _ROUNDS = 400, 48
# Initial angle between the best direction and the directions near it, rad, and their number.
_FIRST, _AROUND = 0.2, 8


def gaps(
    shapes: tuple[Shape, Shape],
    places: tuple[Float[np.ndarray, "t 3"], Float[np.ndarray, "t 3"]],
    turns: tuple[Float[np.ndarray, "t 3 3"], Float[np.ndarray, "t 3 3"]],
) -> Float[np.ndarray, " t"]:
    """Return the distance of two shapes, m. An overlap is the negative depth.

    The depth is the shortest displacement that separates the shapes. The distance is the largest
    distance of two parallel planes between the shapes that touch them. The search finds at most
    this distance, so it never underestimates an overlap.

    Args:
        shapes: the two shapes.
        places: positions of their centres, m.
        turns: rotations from their frames to the world.
    """
    offset = places[1] - places[0]

    def apart(normals: Float[np.ndarray, "t n 3"]) -> Float[np.ndarray, "t n"]:
        reach = (normals @ offset[..., None])[..., 0]
        for shape, turn, sign in zip(shapes, turns, (1.0, -1.0), strict=True):
            reach = reach - shape.height(sign * normals @ turn)
        return reach

    count = len(offset)
    spread = np.broadcast_to(_on_sphere(_DIRECTIONS), (count, _DIRECTIONS, 3))
    best, most = _best(spread, apart(spread))
    angle = np.full(count, _FIRST)
    around = 2 * np.pi * np.arange(_AROUND) / _AROUND
    for _ in range(_ROUNDS):
        across = _across(best)
        circle = (
            np.cos(around)[:, None, None] * across[0] + np.sin(around)[:, None, None] * across[1]
        )
        tried = np.cos(angle)[:, None] * best + np.sin(angle)[:, None] * circle
        tried = np.moveaxis(tried, 0, 1)
        other, more = _best(tried, apart(tried))
        better = more > most
        best, most = np.where(better[:, None], other, best), np.maximum(more, most)
        angle = np.where(better, angle, angle / 2)
    return most


def _best(
    normals: Float[np.ndarray, "t n 3"], values: Float[np.ndarray, "t n"]
) -> tuple[Float[np.ndarray, "t 3"], Float[np.ndarray, " t"]]:
    place = values.argmax(1)[:, None]
    return (
        np.take_along_axis(normals, place[..., None], 1)[:, 0],
        np.take_along_axis(values, place, 1)[:, 0],
    )


def _across(normals: Float[np.ndarray, "t 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Return two unit vectors perpendicular to each normal and to each other."""
    least = np.eye(3)[np.abs(normals).argmin(1)]
    first = np.cross(normals, least)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(normals, first)


def _on_sphere(count: int) -> Float[np.ndarray, "n 3"]:
    """Return unit vectors spread evenly along a spiral."""
    height = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    turn = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(count)
    radius = np.sqrt(1.0 - height**2)
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), height])
