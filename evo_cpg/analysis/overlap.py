"""Overlap depth of two arbitrary convex shapes."""

import numpy as np
from jaxtyping import Float

from evo_cpg.creature.shapes import Shape

# Directions that are tried first, and how often the best of them is looked around for a better one,
# each time closer to it.
_DIRECTIONS, _ROUNDS = 400, 48
# Of those around it: how far off the first ones are, rad, and how many.
_FIRST, _AROUND = 0.2, 8


def gaps(
    shapes: tuple[Shape, Shape],
    places: tuple[Float[np.ndarray, "t 3"], Float[np.ndarray, "t 3"]],
    turns: tuple[Float[np.ndarray, "t 3 3"], Float[np.ndarray, "t 3 3"]],
) -> Float[np.ndarray, " t"]:
    """Distance of two shapes, m; negative where they overlap, by the least way that parts them.

    It is the largest distance of two parallel planes that touch the shapes from between them. What
    is found is at most that: an overlap is not understated.

    Args:
        shapes: both.
        places: of their centres, m.
        turns: from their frames to the world.
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
    """Two unit vectors at right angles to each and to each other."""
    least = np.eye(3)[np.abs(normals).argmin(1)]
    first = np.cross(normals, least)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(normals, first)


def _on_sphere(count: int) -> Float[np.ndarray, "n 3"]:
    """Unit vectors that are spread evenly, along a spiral."""
    height = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    turn = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(count)
    radius = np.sqrt(1.0 - height**2)
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), height])
