"""Limbs of a creature, in contrast to its trunk and tail.

The **trunk** contains the root, and all bodies along the median plane y = 0 of the neutral pose:
head, spine, tail, and fins on the back. A **limb** is a branch that leaves the trunk sideways: its
centre of mass is off the median plane by more than 1 % of the creature's length. A branch in the
median plane is also a limb if it has an equal sideways branch on the same body, such as the front
arm of a starfish. All bodies of a branch belong to one limb. Further parts of a body go with it.
"""

import math
from typing import NamedTuple

import numpy as np

from evo_cpg.creature.creature import Creature, length_of, neutral_pose

# Distance from the median plane over body length, and relative difference of equal masses.
_SIDEWAYS, _EQUAL = 0.01, 0.01


class Limb(NamedTuple):
    """A limb.

    Attributes:
        bodies: indices of its bodies in ``creature.bodies``, the hip's body first.
        side: 1 on the left, -1 on the right, 0 in the median plane.
        ahead: x of the hip joint in the neutral pose, m.
    """

    bodies: tuple[int, ...]
    side: int
    ahead: float


def limbs(creature: Creature) -> tuple[Limb, ...]:
    """Return the limbs from front to back, and of equal places the left one first."""
    centres, turns = (np.asarray(each, float) for each in neutral_pose(creature))
    masses = np.array([float(body.mass) for body in creature.bodies])
    parts: dict[int, list[int]] = {i: [] for i in range(len(creature.bodies))}
    width = _SIDEWAYS * float(length_of(creature))
    children: dict[int, list[int]] = {i: [] for i in range(len(creature.bodies))}
    root = 0
    for i, body in enumerate(creature.bodies):
        if body.joint is None:
            root = i
        elif body.whole is not None:
            parts[creature.body_index(body.whole)].append(i)
        else:
            children[creature.body_index(body.joint.parent)].append(i)

    def branch(body: int) -> tuple[int, ...]:
        further = (each for child in children[body] for each in branch(child))
        return (body, *parts[body], *further)

    found, trunk = [], [root]
    for body in trunk:
        branches = [branch(child) for child in children[body]]
        weights = [masses[[*each]].sum() for each in branches]
        offsets = [np.average(centres[[*each], 1], weights=masses[[*each]]) for each in branches]
        aside = [abs(offset) > width for offset in offsets]
        for k, own in enumerate(branches):
            equal = any(
                aside[j]
                and len(own) == len(other)
                and math.isclose(weights[k], weights[j], rel_tol=_EQUAL)
                for j, other in enumerate(branches)
                if j != k
            )
            if aside[k] or equal:
                joint = creature.bodies[own[0]].joint
                assert joint is not None
                hip = centres[own[0]] + turns[own[0]] @ np.array(joint.child_anchor, float)
                side = int(np.sign(offsets[k])) if aside[k] else 0
                found.append(Limb(own, side, float(hip[0])))
            else:
                trunk.append(own[0])
    order = sorted(found, key=lambda limb: (round(-limb.ahead / max(width, 1e-12)), -limb.side))
    return tuple(order)
