"""Surface points on the outside of a creature: where water meets its skin.

Faces of neighbouring bodies that look at each other across a joint are sheltered: water does not
stream against them. Counting them made a 10-body chain swim at 0.05 m/s instead of 0.50 m/s.
"""

import numpy as np

from evo_cpg.creature.creature import Creature, neutral_pose
from evo_cpg.creature.shapes import Surface

# A point is sheltered when a step of this many joint gaps along its normal ends in another body.
_SHELTER_GAPS = 1.5

# Places along the normal (as fractions of the sheltering distance) that are probed.
_PROBES = (0.0, 0.25, 0.5, 0.75, 1.0)


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
    centres, rotations = neutral_pose(creature)
    reach = _SHELTER_GAPS * _largest_gap(creature, centres, rotations)
    outer = []
    for i, surface in enumerate(surfaces):
        exposed = np.ones(len(surface.areas), bool)
        for fraction in _PROBES:
            local = surface.points + fraction * reach * surface.normals
            world = local @ rotations[i].T + centres[i]
            for j, other in enumerate(creature.bodies):
                if j != i:
                    exposed &= other.shape.distance((world - centres[j]) @ rotations[j]) > 0
        outer.append(Surface(*(column[exposed] for column in surface)))
    return tuple(outer)


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
        total = surface.areas.sum()
        if total == 0:
            drawn.append(surface)
            continue
        chosen = rng.choice(len(surface.areas), size=count, p=surface.areas / total)
        drawn.append(
            Surface(surface.points[chosen], surface.normals[chosen], np.full(count, total / count))
        )
    return tuple(drawn)


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
