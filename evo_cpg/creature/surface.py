"""Surface points on the outside of a creature, at which water acts on it.

Faces of neighbouring bodies that face each other across a joint are sheltered from the flow.
Counting them made a 10-body chain swim at 0.05 m/s instead of 0.50 m/s.

Round ends at joints are straightened (`evo_cpg.creature.outline`), because facing half-balls would
count as exposed. A round body covers other points by a fraction, continuous in the geometry. Boxes
and meshes omit the points whose normal meets another body.
"""

import dataclasses
import functools
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from evo_cpg.creature.algebra.decisions import Condition, all_hold, chosen
from evo_cpg.creature.algebra.numerics import Number, Numbers, smooth_step, xp
from evo_cpg.creature.creature import Body, Creature, neutral_pose
from evo_cpg.creature.outline import outline_surface, outlines
from evo_cpg.creature.shapes import Surface

# Layout of the surface points of a model. "merged" leaves sheltered points out, and merges points
# that move alike in the water. Bodies of a batch need one layout: "separate" merges nothing, and
# "complete" also keeps the sheltered points, with no area.
PointLayout = Literal["merged", "separate", "complete"]

# A point is sheltered when a step of this many joint gaps along its normal ends in another body.
_SHELTER_GAPS = 1.5

# Probes along the normal, as fractions of the sheltering distance.
_PROBES = (0.0, 0.25, 0.5, 0.75, 1.0)

# Pairs of bodies are checked for cover up to this multiple of the distance at which they can cover
# each other, because other bodies of a plan are larger: evolved bodies may have half the length and
# twice the width. The second value is for "complete".
_NEAR, _NEAR_IN_COMPLETE = 2.0, 3.0

# Depth of a point in another body at which it is covered, as a fraction of the size of its area and
# of the other body's least half extent.
_SUNK = 0.25

# Least size of a point's area, so that bodies without size cover nothing, m.
_LEAST = 1e-12

# Largest distance (m) of surfaces that two bodies share, and distance (m) outside a shared surface
# at which no body may be.
_SAME_SKIN, _OUTWARDS = 1e-9, 1e-6


def outer_surfaces(
    creature: Creature, resolution: int, sheltered: bool = True, layout: PointLayout = "merged"
) -> tuple[Surface, ...]:
    """Return quadrature points on the outer surface of each body, in its geometric frame.

    Args:
        creature: the creature.
        resolution: resolution of `Shape.surface`, or of the outline of a round body.
        sheltered: whether to drop points that another body covers in the neutral pose. False counts
            every face, as a literal reading of Iwadate 2010 would.
        layout: layout of the points. With "complete", sheltered points remain and their area is 0.

    Returns:
        One surface per body, in the order of ``creature.bodies``.
    """
    # Bodies with corners, such as boxes and meshes, are flat.
    if all(body.shape.corners is not None for body in creature.bodies):
        return _of_flat_bodies(creature, resolution, sheltered, layout)
    surfaces = _outline(creature, resolution, sheltered, layout)
    if layout == "complete":
        return surfaces
    with_area = chosen(lambda: [surface.areas > 0 for surface in surfaces])
    return tuple(
        Surface(*(column[kept] for column in surface))
        for surface, kept in zip(surfaces, with_area, strict=True)
    )


def _outline(
    creature: Creature, resolution: int, sheltered: bool, layout: PointLayout
) -> tuple[Surface, ...]:
    """Return the surfaces of a creature with round bodies, with all points.

    Round bodies have the points of `outline_surface` whether or not they are sheltered.
    """
    pose = neutral_pose(creature)
    shapes = [body.shape for body in creature.bodies]
    found, in_line = outlines(creature, pose)
    if not sheltered:
        found = [
            dataclasses.replace(each, covered=np.zeros(2), extension=np.zeros(2)) for each in found
        ]
    surfaces, on_body = zip(
        *(
            outline_surface(shape, each, resolution)
            for shape, each in zip(shapes, found, strict=True)
        ),
        strict=True,
    )
    if not sheltered or len(surfaces) == 1:
        return surfaces
    reach = _SHELTER_GAPS * _largest_gap(creature, pose)
    largest = _NEAR_IN_COMPLETE if layout == "complete" else _NEAR
    near = chosen(
        lambda: _nearness(creature, pose, reach) <= largest,
        lambda near: (near | (_nearness(creature, pose, reach) > 1)).all(),
    )
    flat = np.array([shape.corners is not None for shape in shapes])
    both_flat = flat[:, None] & flat
    exposed = _exposed(creature, pose, reach, surfaces, near & both_flat)
    dry = _covered(creature, pose, reach, surfaces, near & ~both_flat)
    made = []
    for i, surface in enumerate(surfaces):
        areas = xp.where(exposed[i], surface.areas, 0.0)
        for j, covered in dry[i].items():
            areas = areas * (1 - covered * xp.where(on_body[i], 1.0, 1 - in_line[i, j]))
        made.append(surface._replace(areas=areas))
    return tuple(made)


def _of_flat_bodies(
    creature: Creature, resolution: int, sheltered: bool, layout: PointLayout
) -> tuple[Surface, ...]:
    """Return the surfaces of boxes and meshes."""
    surfaces = tuple(body.shape.surface(resolution) for body in creature.bodies)
    if not sheltered or len(surfaces) == 1:
        return surfaces
    pose = neutral_pose(creature)
    reach = _SHELTER_GAPS * _largest_gap(creature, pose)

    def still_near(near: np.ndarray) -> Condition:
        return (near | (_nearness(creature, pose, reach) > 1)).all()

    if layout == "complete":
        near = chosen(lambda: _nearness(creature, pose, reach) <= _NEAR_IN_COMPLETE, still_near)
        exposed = _exposed(creature, pose, reach, surfaces, near)
        return tuple(
            surface._replace(areas=xp.where(outside, surface.areas, 0.0))
            for surface, outside in zip(surfaces, exposed, strict=True)
        )

    def choose() -> tuple[list[Numbers], np.ndarray]:
        near = _nearness(creature, pose, reach) <= _NEAR
        return _exposed(creature, pose, reach, surfaces, near), near

    def still(made: tuple[list[Numbers], np.ndarray]) -> Condition:
        exposed, near = made
        again = _exposed(creature, pose, reach, surfaces, near)
        same = [(one == other).all() for one, other in zip(exposed, again, strict=True)]
        return all_hold([still_near(near), *same])

    exposed, _ = chosen(choose, still)
    return tuple(
        Surface(*(column[outside] for column in surface))
        for surface, outside in zip(surfaces, exposed, strict=True)
    )


def random_surfaces(
    surfaces: tuple[Surface, ...], count: int, rng: np.random.Generator
) -> tuple[Surface, ...]:
    """Draw random points on surfaces, with probability by area (Iwadate 2010, section 4).

    Returns:
        ``count`` points for each body, with equal areas.
    """
    drawn = []
    for surface in surfaces:
        if not len(surface.areas):
            drawn.append(surface)
            continue
        total = surface.areas.sum()
        points = chosen(functools.partial(_draw, surface.areas, count, rng))
        drawn.append(
            Surface(
                surface.points[points],
                surface.normals[points],
                xp.broadcast_to(total / count, count),
            )
        )
    return tuple(drawn)


def _draw(areas: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    total = areas.sum()
    return rng.choice(len(areas), size=count, p=areas / total if total else None)


def _nearness(
    creature: Creature, pose: tuple[Numbers, Numbers], reach: Number
) -> Float[Numbers, "b b"]:
    """Return distances of bodies, relative to the largest at which one covers the other."""
    centres, _ = pose
    radius = xp.array([body.shape.reach for body in creature.bodies])
    distance = xp.sqrt(xp.square(centres[:, None] - centres).sum(-1))
    return distance / xp.maximum(radius[:, None] + radius + reach, _LEAST)


def _exposed(
    creature: Creature,
    pose: tuple[Numbers, Numbers],
    reach: Number,
    surfaces: tuple[Surface, ...],
    near: Bool[np.ndarray, "b b"],
) -> list[Numbers]:
    """Return which points of each body no other body covers.

    A piece of surface that two bodies share belongs to the first body.

    ``near`` is a table of the bodies that can cover each other, ``reach`` the distance (m) at which
    a body shelters.
    """
    centres, rotations = pose
    found = []
    for i, surface in enumerate(surfaces):
        probes = reach * np.array(_PROBES)[:, None, None]
        world = (surface.points + probes * surface.normals) @ rotations[i].T + centres[i]
        outwards = world[0] + _OUTWARDS * surface.normals @ rotations[i].T
        exposed = np.ones(world.shape[:-1], bool)
        for j, other in enumerate(creature.bodies):
            if j == i or not near[i, j]:
                continue

            def distance(place: Numbers, j: int = j, other: Body = other) -> Numbers:
                local = (place - centres[j]) @ rotations[j]
                return other.shape.distance(local.reshape(-1, 3)).reshape(place.shape[:-1])

            gap = distance(world)
            apart = gap > 0
            if i < j:
                apart = apart | (xp.abs(gap) < _SAME_SKIN) & (distance(outwards) > 0)
            exposed = exposed & apart
        found.append(exposed.all(0))
    return found


def _covered(
    creature: Creature,
    pose: tuple[Numbers, Numbers],
    reach: Number,
    surfaces: tuple[Surface, ...],
    near: Bool[np.ndarray, "b b"],
) -> list[dict[int, Numbers]]:
    """Return the fractions of the points of each body that other bodies cover, by these bodies.

    See `_exposed` for the arguments.
    """
    centres, rotations = pose
    found: list[dict[int, Numbers]] = []
    for i, surface in enumerate(surfaces):
        probes = reach * np.array(_PROBES)[:, None, None]
        world = (surface.points + probes * surface.normals) @ rotations[i].T + centres[i]
        areas = xp.where(surface.areas > 0, surface.areas, 1.0)
        found.append({})
        for j in np.flatnonzero(near[i] & (np.arange(len(surfaces)) != i)):
            shape = creature.bodies[j].shape
            local = (world - centres[j]) @ rotations[j]
            gap = shape.distance(local.reshape(-1, 3)).reshape(local.shape[:-1]).min(0)
            size = _SUNK * xp.minimum(xp.sqrt(areas), xp.min(shape.half_extents))
            size = xp.maximum(size, _LEAST)
            found[i][int(j)] = smooth_step(-gap / size)
    return found


def _largest_gap(creature: Creature, pose: tuple[Numbers, Numbers]) -> Number:
    """Return the widest gap (m) between a body and its parent in the neutral pose."""
    centres, rotations = pose
    gaps = [0.0]
    for i, body in enumerate(creature.bodies):
        if body.joint is None or body.whole is not None:
            continue
        parent = creature.body_index(body.joint.parent)
        if not (body.shape.exists and creature.bodies[parent].shape.exists):
            continue
        world = body.shape.surface(8).points @ rotations[i].T + centres[i]
        local = (world - centres[parent]) @ rotations[parent]
        gaps.append(creature.bodies[parent].shape.distance(local).min())
    return xp.max(xp.array(gaps))
