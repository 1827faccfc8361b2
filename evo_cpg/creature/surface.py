"""Surface points on the outside of a creature: where water meets its skin.

Faces of neighbouring bodies that look at each other across a joint are sheltered: water does not
stream against them. Counting them made a 10-body chain swim at 0.05 m/s instead of 0.50 m/s.
"""

import functools

import numpy as np

from evo_cpg.creature.creature import Body, Creature, neutral_pose
from evo_cpg.creature.shapes import Surface
from evo_cpg.spatial.choices import chosen
from evo_cpg.spatial.numerics import xp

# A point is sheltered when a step of this many joint gaps along its normal ends in another body.
_SHELTER_GAPS = 1.5

# Places along the normal (as fractions of the sheltering distance) that are probed.
_PROBES = (0.0, 0.25, 0.5, 0.75, 1.0)

# Two bodies have the same skin where it is no farther apart (m), and so far outside of it (m)
# neither is.
_SAME_SKIN, _OUTWARDS = 1e-9, 1e-6


def outer_surfaces(
    creature: Creature, resolution: int, sheltered: bool = True
) -> tuple[Surface, ...]:
    """Quadrature points on the outer surface of each body, in the body's geometric frame.

    Args:
        creature: the animal.
        resolution: see `Shape.surface`.
        sheltered: drop the points that another body covers in the neutral pose; False counts
            every face, as a literal reading of Iwadate 2010 would.

    Returns:
        One surface per body, in the order of ``creature.bodies``.
    """
    surfaces = tuple(body.shape.surface(resolution) for body in creature.bodies)
    if not sheltered or len(surfaces) == 1:
        return surfaces
    return tuple(
        Surface(*(column[outside] for column in surface))
        for surface, outside in zip(
            surfaces, chosen(lambda: _exposed(creature, surfaces)), strict=True
        )
    )


def random_surfaces(
    surfaces: tuple[Surface, ...], count: int, rng: np.random.Generator
) -> tuple[Surface, ...]:
    """Points drawn at random on given surfaces, area for area (Iwadate 2010, section 4).

    Args:
        surfaces: dense quadratures, one per body.
        count: points on each body.
        rng: the source of randomness.

    Returns:
        For each body ``count`` points that share its area equally.
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
    return rng.choice(len(areas), size=count, p=areas / areas.sum())


def _exposed(creature: Creature, surfaces: tuple[Surface, ...]) -> list[np.ndarray]:
    """Which points of each body no other body covers, by their numbers.

    Where two bodies share a piece of skin, it is the first one's.
    """
    centres, rotations = neutral_pose(creature)
    reach = _SHELTER_GAPS * _largest_gap(creature, centres, rotations)
    found = []
    for i, surface in enumerate(surfaces):
        probes = reach * np.array(_PROBES)[:, None, None]
        world = (surface.points + probes * surface.normals) @ rotations[i].T + centres[i]
        outwards = world[0] + _OUTWARDS * surface.normals @ rotations[i].T
        exposed = np.ones(world.shape[:-1], bool)
        for j, other in enumerate(creature.bodies):
            if j == i:
                continue

            def distance(place: np.ndarray, j: int = j, other: Body = other) -> np.ndarray:
                local = (place - centres[j]) @ rotations[j]
                return other.shape.distance(local.reshape(-1, 3)).reshape(place.shape[:-1])

            gap = distance(world)
            apart = gap > 0
            if i < j:
                apart |= (np.abs(gap) < _SAME_SKIN) & (distance(outwards) > 0)
            exposed &= apart
        found.append(np.flatnonzero(exposed.all(0)))
    return found


def _largest_gap(creature: Creature, centres: np.ndarray, rotations: np.ndarray) -> float:
    """Widest opening (m) between a body and its parent in the neutral pose."""
    gaps = [0.0]
    for i, body in enumerate(creature.bodies):
        if body.joint is None:
            continue
        parent = creature.body_index(body.joint.parent)
        world = body.shape.surface(8).points @ rotations[i].T + centres[i]
        local = (world - centres[parent]) @ rotations[parent]
        gaps.append(float(creature.bodies[parent].shape.distance(local).min()))
    return max(gaps)
