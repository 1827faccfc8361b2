"""Points on the surface of bodies, for drag: velocity rows, merged points, and their depth."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.decisions import Condition, all_hold, chosen
from evo_cpg.creature.algebra.numerics import Numbers, smooth_step, xp
from evo_cpg.creature.shapes import Surface

# Decimals to which equal numbers are rounded, and tolerance for numbers to stay equal (m, m^2).
_DECIMALS, _SAME = 9, 1e-9

# Largest component of a normal along the axis from which tangents are made. A normal's least
# component is at most 0.58.
_ACROSS = 0.9

# Height over which a level patch gets wet, as a fraction of its size, so that forces do not jump.
_LEAST_SLOPE = 0.1


class Places(NamedTuple):
    """Places of the points of a patch, for their depth.

    Attributes:
        points: positions in the body's working frame, m.
        normals: outward unit normals.
        extents: half the edge of a square of a point's area, m.
    """

    points: np.ndarray
    normals: np.ndarray
    extents: np.ndarray


def wet_fraction(places: Places | None, pose: Float[Array, "4 k *n"]) -> Float[Array, "p kn"]:
    """Return the fraction under water of the patch around each point, a cubic in its depth.

    Raises:
        ValueError: if the patches were made for water without a surface.
    """
    if places is None:
        raise ValueError("patches know no depth; make them with make_patches(..., surfacing=True)")
    flat = pose.reshape(4, -1)
    up, height = flat[:3], flat[3:]
    points, normals, extents = (jnp.asarray(column, flat.dtype) for column in places)
    steepness = normals @ up
    spread = extents[:, None] * jnp.sqrt(1.0 - (1.0 - _LEAST_SLOPE**2) * steepness * steepness)
    # Points with the same normal and area share the quotient.
    return smooth_step(0.5 - (height + points @ up) * (0.5 / spread))


def alike(surfaces: Sequence[tuple[tuple[Numbers, ...], ...]]) -> list[tuple[int, ...]]:
    """Return the bodies grouped by their arrays: points of surfaces, or other constants."""
    groups: dict[bytes, list[int]] = {}
    for i, own in enumerate(surfaces):
        key = b"|".join(
            np.round(column, _DECIMALS).tobytes() for surface in own for column in surface
        )
        groups.setdefault(key, []).append(i)
    return [tuple(bodies) for bodies in groups.values()]


def still_alike(
    surfaces: Sequence[tuple[tuple[Numbers, ...], ...]], groups: list[tuple[int, ...]]
) -> Condition:
    """Return whether all bodies of each group still have equal arrays."""
    return all_hold(
        (xp.abs(one - same) <= _SAME).all()
        for first, *others in groups
        for other in others
        for own, theirs in zip(surfaces[first], surfaces[other], strict=True)
        for one, same in zip(own, theirs, strict=True)
    )


def places_of(surface: Surface) -> Places:
    """Return the places of surface points."""
    # Points without area have no force, so any extent serves.
    areas = xp.where(surface.areas > 0, surface.areas, 1.0)
    return Places(surface.points, surface.normals, xp.sqrt(areas) / 2)


def velocity_rows(surface: Surface) -> list[Numbers]:
    """Return rows ``(points, 6)`` for the normal and two tangential velocities of a twist."""
    points, normals, _ = surface
    helper = np.eye(3)[
        chosen(lambda: np.abs(normals).argmin(-1), lambda axes: _are_across(normals, axes))
    ]
    across = xp.cross(normals, helper)
    first = across / xp.linalg.norm(across, axis=-1, keepdims=True)
    second = xp.cross(normals, first)
    return [
        xp.concatenate([xp.cross(points, direction), direction], -1)
        for direction in (normals, first, second)
    ]


def _are_across(normals: Numbers, axes: np.ndarray) -> Condition:
    """Return whether no axis is nearly along its normal, so that the axes give tangents."""
    return (xp.abs(normals[np.arange(len(axes)), axes]) < _ACROSS).all()


def merge_alike(rows: Numbers, areas: Numbers) -> tuple[Numbers, Numbers]:
    """Return one row for all rows that are equal up to their sign, with summed areas."""
    signs, kept, members = chosen(
        lambda: _equal_up_to_sign(rows), lambda merged: _may_merge(rows, *merged)
    )
    return (rows * signs)[kept], members @ areas


def _equal_up_to_sign(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a sign for each row, the first row of each kind, and the members of each kind."""
    rounded = np.round(rows, _DECIMALS) + 0.0
    leading = np.take_along_axis(rounded, (rounded != 0).argmax(1)[:, None], 1)
    signs = np.where(leading < 0, -1.0, 1.0)
    _, first, inverse = np.unique(
        rounded * signs + 0.0, axis=0, return_index=True, return_inverse=True
    )
    # Keep the order of the points: the order of the rows would change with a body's size.
    order = np.argsort(first)
    return signs, first[order], (inverse.ravel() == order[:, None]).astype(float)


def _may_merge(
    rows: Numbers, signs: np.ndarray, kept: np.ndarray, members: np.ndarray
) -> Condition:
    """Return whether the merged rows are equal up to their sign."""
    signed = rows * signs
    return (xp.abs(signed - signed[kept[members.argmax(0)]]) <= _SAME).all()


def outer_products(rows: Numbers) -> Numbers:
    """Return the (angular, mixed, linear) blocks of ``w w^T`` of each row, ``(27, points)``."""
    outer = xp.einsum("pi,pj->ijp", rows, rows)
    return xp.stack([outer[:3, :3], outer[:3, 3:], outer[3:, 3:]]).reshape(27, -1)


def runs(indices: tuple[int, ...]) -> list[slice]:
    """Return slices of the runs of consecutive numbers in increasing indices."""
    splits = np.split(np.array(indices), np.flatnonzero(np.diff(indices) != 1) + 1)
    return [slice(int(run[0]), int(run[-1]) + 1) for run in splits]
