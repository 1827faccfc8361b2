"""Bodies of one creature that must not pass through each other.

The law of a pair is that of a point on the ground (`evo_cpg.physics.contact`) without friction and
restitution: with the velocity v_n at which the nearest points part after the forces have acted,

    f_n = max(0, c (v* - v_n)),      v* = -gap / h, or a slow way out of an overlap.

A pair couples branches of the tree; in generalized coordinates it is a few elements of the matrix
(`evo_cpg.physics.step_problem`).
"""

import itertools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.creature import Creature, neutral_pose
from evo_cpg.creature.reach import chain_to_root
from evo_cpg.creature.self_collision import SelfCollision, colliding_pairs
from evo_cpg.creature.shapes import RoundedBox
from evo_cpg.creature.tree import Tree
from evo_cpg.physics.box_separation import separation_of_boxes
from evo_cpg.physics.contact import BAUMGARTE_SHARE, BAUMGARTE_SPEED
from evo_cpg.physics.flat_separation import separation_of_flat
from evo_cpg.physics.kinematics import Kinematics, Motion, motion_of_bodies
from evo_cpg.physics.per_body import take
from evo_cpg.physics.separation import (
    RoundedBoxes,
    Separation,
    separation_of_line_and_box,
    separation_of_lines,
    separation_of_rounded,
)
from evo_cpg.spatial.choices import chosen
from evo_cpg.spatial.linear import cross, dot, expand_dims_like, matvec, skew
from evo_cpg.spatial.numerics import Numbers, xp

# c h of a pair: so many times the geometric mean of the two masses.
_STIFFNESS = 60.0

# How pairs are treated, and how many points each of them has then.
_KINDS = {
    "lines": (separation_of_lines, 2),
    "flat": (separation_of_flat, 2),
    "boxes": (separation_of_boxes, 3),
    "line and box": (separation_of_line_and_box, 2),
    "rounded": (separation_of_rounded, 2),
}

# Sine of the angle between axes that are parallel.
_PARALLEL = 1e-9


class Alike(NamedTuple):
    """Pairs that are treated in the same way.

    Attributes:
        kind: how (see `_KINDS`).
        turned: which axes of the first and the second body count as x, y and z.
        count: how many pairs.
    """

    kind: str
    turned: tuple[tuple[int, int, int], tuple[int, int, int]]
    count: int


class Pairs(eqx.Module):
    """The pairs of bodies that may touch, and the rounded boxes that they count as.

    Attributes:
        first: index in the tree of one body of each pair.
        second: of the other.
        runs: of pairs in a row that are treated in the same way.
        centre: of every body's box in its working frame, m.
        half_extents: m.
        radius: m.
        stiffness: c h, kg.
    """

    first: tuple[int, ...] = eqx.field(static=True)
    second: tuple[int, ...] = eqx.field(static=True)
    runs: tuple[Alike, ...] = eqx.field(static=True)
    centre: Float[Numbers, "3 b"]
    half_extents: Float[Numbers, "3 b"]
    radius: Float[Numbers, " b"]
    stiffness: Float[Numbers, " p"]

    @property
    def owners(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """The bodies of every point: of a run the first points of all pairs, then the next."""
        return _owners(self.first, self.second, self.runs)


class PairContacts(NamedTuple):
    """Where pairs are nearest, and what holds throughout one step.

    Two bodies of one tree part only as the joints between them turn: along the normal of a point at
    ``J qd``, and a force f of the pair is felt by these joints as the torques ``J^T f``.

    Attributes:
        gap: m.
        jacobian: J; zeros of joints that are not between the bodies, m.
        coasting: velocity if all joint accelerations were zero, mean over the step, m/s.
        wanted: v*.
        sweep: acceleration along the normal at constant joint rates, which is in `coasting`, m/s^2.
        where: the nearest points.
    """

    gap: Float[Array, "p *n"]
    jacobian: Float[Array, "p d *n"]
    coasting: Float[Array, "p *n"]
    wanted: Float[Array, "p *n"]
    sweep: Float[Array, "p *n"]
    where: Separation


class PairLinearization(NamedTuple):
    """The laws linearized at a velocity: ``f = force - slope (v - velocity)``.

    Attributes:
        velocity: m/s.
        force: there, N.
        slope: N s/m.
    """

    velocity: Float[Array, "p *n"]
    force: Float[Array, "p *n"]
    slope: Float[Array, "p *n"]


def make_pairs(creature: Creature, tree: Tree, wanted: SelfCollision) -> Pairs | None:
    """The pairs of a creature that may touch; None where there are none."""
    boxes = [creature.bodies[creature.body_index(name)].shape.rounded_box for name in tree.names]

    def in_order(pair: tuple[int, int]) -> tuple[int, int]:
        """Lines first."""
        first, second = pair
        return (second, first) if _is_line(boxes[second]) else pair

    def choose() -> tuple[tuple[int, ...], tuple[int, ...], tuple[Alike, ...]]:
        found = colliding_pairs(creature, tree, wanted)
        order = [creature.body_index(name) for name in tree.names]
        places, turned = (np.array(each)[order] for each in neutral_pose(creature))
        centres = [
            place + turn @ box.centre
            for place, turn, box in zip(places, turned, boxes, strict=True)
        ]
        ways = sorted((*_way(tree, turned, boxes, *pair), pair) for pair in map(in_order, found))
        ways = [way for way in ways if not _passes(way, turned, centres, boxes)]
        first, second = zip(*(pair for *_, pair in ways), strict=True) if ways else ((), ())
        groups = itertools.groupby(ways, lambda way: way[:2])
        return first, second, tuple(Alike(*way, len(list(same))) for way, same in groups)

    first, second, runs = chosen(choose)
    if not first:
        return None
    one, two = (tree.mass[np.array(bodies)] for bodies in _owners(first, second, runs))
    return Pairs(
        first,
        second,
        runs,
        tree.com + xp.array([box.centre for box in boxes]).T,
        xp.array([box.half_extents for box in boxes]).T,
        xp.array([box.radius for box in boxes]),
        _STIFFNESS * xp.sqrt(one * two),
    )


def _owners(
    first: tuple[int, ...], second: tuple[int, ...], runs: tuple[Alike, ...]
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """See `Pairs.owners`."""

    def repeated(bodies: tuple[int, ...]) -> tuple[int, ...]:
        found, start = (), 0
        for run in runs:
            found += bodies[start : start + run.count] * _KINDS[run.kind][1]
            start += run.count
        return found

    return repeated(first), repeated(second)


def _is_line(box: RoundedBox) -> bool:
    """Whether it extends along x alone, or not at all."""
    return not box.half_extents[1:].any()


def _way(
    tree: Tree, turned: np.ndarray, boxes: list[RoundedBox], first: int, second: int
) -> tuple[str, tuple[tuple[int, int, int], tuple[int, int, int]]]:
    """How a pair is treated.

    Args:
        tree: the creature, of known numbers.
        turned: rotations ``(b, 3, 3)`` of its bodies in the neutral pose.
        boxes: of its bodies.
        first: a body.
        second: another.
    """
    plain = (0, 1, 2)
    both = boxes[first], boxes[second]
    if any(box.radius > 0 for box in both):
        if _is_line(both[0]):
            return ("lines" if _is_line(both[1]) else "line and box"), (plain, plain)
        longest = (int(np.argmax(box.half_extents)) for box in both)
        one, two = ((x, (x + 1) % 3, (x + 2) % 3) for x in longest)
        return "rounded", (one, two)
    chains = [set(chain_to_root(tree, body)) for body in (first, second)]
    dofs = [i for i, body in enumerate(tree.dof_bodies) if body in chains[0] ^ chains[1]]
    axes = np.array([turned[tree.dof_bodies[i]] @ tree.joint_axes[:, i] for i in dofs])
    common = [
        np.flatnonzero(np.linalg.norm(np.cross(turned[body].T, axes[:1]), axis=1) < _PARALLEL)
        for body in (first, second)
    ]
    if np.linalg.norm(np.cross(axes, axes[0]), axis=1).max() > _PARALLEL or not all(
        map(len, common)
    ):
        return "boxes", (plain, plain)
    one, two = (((z + 1) % 3, (z + 2) % 3, z) for (z,) in map(np.ndarray.tolist, common))
    return "flat", (one, two)


def _passes(
    way: tuple[str, tuple[tuple[int, int, int], ...], tuple[int, int]],
    turned: np.ndarray,
    centres: list[np.ndarray],
    boxes: list[RoundedBox],
) -> bool:
    """Whether two boxes turn beside each other, apart along their common axis for ever.

    Args:
        way: how they are treated, and the pair.
        turned: rotations ``(b, 3, 3)`` of the bodies in the neutral pose.
        centres: of their boxes there, m.
        boxes: of the bodies.
    """
    kind, (order, other_order), (first, second) = way
    if kind != "flat":
        return False
    aside = turned[first][:, order[2]] @ (centres[second] - centres[first])
    sides = boxes[first].half_extents[order[2]] + boxes[second].half_extents[other_order[2]]
    return bool(abs(aside) > sides)


def separations(pairs: Pairs, kin: Kinematics) -> Separation:
    """Of all points of all pairs; places are from the world's origin."""
    centre = kin.origin + matvec(kin.rotation, expand_dims_like(pairs.centre, kin.origin))
    half = expand_dims_like(pairs.half_extents, kin.origin)
    radius = expand_dims_like(pairs.radius, kin.origin[0])
    found, start = [], 0
    for run in pairs.runs:
        sides = []
        for bodies, order in zip((pairs.first, pairs.second), run.turned, strict=True):
            own, axes = np.array(bodies[start : start + run.count]), np.array(order)
            sides.append(
                RoundedBoxes(
                    take(centre, own),
                    take(take(kin.rotation, own, 2), axes),
                    take(take(half, own), axes, 0),
                    take(radius, own, 0),
                )
            )
        find, _ = _KINDS[run.kind]
        found += find(*sides)
        start += run.count
    axis = 1 - kin.origin.ndim
    return jax.tree.map(lambda *parts: jnp.concatenate(parts, axis), *found)


def find_pair_contacts(
    tree: Tree, pairs: Pairs, kin: Kinematics, qd: Float[Array, "d *n"], h: float
) -> PairContacts:
    """Where pairs are nearest, and the velocity at which each is to part.

    Args:
        tree: the creature.
        pairs: those of it.
        kin: kinematics at the start of the step.
        qd: joint rates there, rad/s.
        h: s.
    """
    where = separations(pairs, kin)
    push = jnp.clip(-BAUMGARTE_SHARE / h * where.gap, 0.0, BAUMGARTE_SPEED)
    wanted = jnp.where(where.gap > 0, (-1.0 / h) * where.gap, push)
    sweep = _sweep(pairs, kin.origin, kin, where)
    jacobian = _jacobian(tree, pairs, kin, where)
    coasting = (jacobian * qd[None]).sum(1) + 0.5 * h * sweep
    return PairContacts(where.gap, jacobian, coasting, wanted, sweep, where)


def sweep_at(
    tree: Tree, pairs: Pairs, kin: Kinematics, contacts: PairContacts, qd: Float[Array, "d *n"]
) -> Float[Array, "p *n"]:
    """The sweep at other joint rates, m/s^2.

    Args:
        tree: the creature.
        pairs: those of it.
        kin: kinematics at the start of the step.
        contacts: of this step.
        qd: rad/s.
    """
    # As if the root lay still.
    still = jnp.zeros((6, *qd.shape[1:]), qd.dtype)
    motion = motion_of_bodies(tree, kin, still, qd)
    return _sweep(pairs, kin.origin, motion, contacts.where)


def swept(contacts: PairContacts, sweep: Float[Array, "p *n"], h: float) -> PairContacts:
    """The contacts with another sweep (m/s^2) throughout the step."""
    coasting = contacts.coasting + 0.5 * h * (sweep - contacts.sweep)
    return contacts._replace(coasting=coasting, sweep=sweep)


def _sweep(pairs: Pairs, origin: Array, motion: Kinematics | Motion, where: Separation) -> Array:
    """Acceleration along the normals at constant joint rates.

    Args:
        pairs: of a creature.
        origin: of its bodies, m.
        motion: of them.
        where: the nearest points.
    """
    _, normal, *points, carried = where
    # Of a body's point at the arm r: velocity v + w x r, drift a + A r.
    spin, square = motion.angular, dot(motion.angular, motion.angular)
    a = motion.bias_linear + cross(spin, motion.linear)
    A = skew(motion.bias_angular) + spin[:, None] * spin[None]
    A = A - square[None, None] * expand_dims_like(np.eye(3), A)
    velocity, drift, turning = [], [], jnp.zeros_like(normal)
    for bodies, point, share in zip(pairs.owners, points, carried, strict=True):
        own = np.array(bodies)
        arm, angular = point - take(origin, own), take(spin, own)
        velocity.append(take(motion.linear, own) + cross(angular, arm))
        drift.append(take(a, own) + matvec(take(A, own, 2), arm))
        turning = turning + share[None] * angular
    parting = velocity[1] - velocity[0]
    # A normal that turns meets another part of what slides past it.
    return dot(normal, drift[1] - drift[0]) - 2.0 * dot(cross(normal, turning), parting)


def _jacobian(
    tree: Tree, pairs: Pairs, kin: Kinematics, where: Separation
) -> Float[Array, "p d *n"]:
    """J of `PairContacts`."""
    _, normal, *points, _ = where
    joints = take(kin.origin, np.array(tree.dof_bodies, int))
    ways = []
    for point in points:
        arm = point[:, :, None] - joints[:, None]
        ways.append(
            dot(kin.axes[:, None], cross(arm, jnp.broadcast_to(normal[:, :, None], arm.shape)))
        )
    between = [_between(tree, *pair) for pair in zip(*pairs.owners, strict=True)]
    of_first, of_second = (
        expand_dims_like(np.array([sides[k] for sides in between], float), ways[0])
        for k in range(2)
    )
    return of_second * ways[1] - of_first * ways[0]


def _between(tree: Tree, first: int, second: int) -> tuple[list[bool], list[bool]]:
    """Of every degree of freedom, whether it moves only the first of two bodies, or the second."""
    one, two = (set(chain_to_root(tree, body)) for body in (first, second))
    return [body in one - two for body in tree.dof_bodies], [
        body in two - one for body in tree.dof_bodies
    ]


def linearize_pairs(
    pairs: Pairs, contacts: PairContacts, velocity: Array, h: float
) -> PairLinearization:
    """The laws linearized at some velocities, m/s."""
    stiffness = expand_dims_like(pairs.stiffness / h, velocity)
    short = contacts.wanted - velocity
    touches = short > 0
    force = stiffness * jnp.maximum(short, 0.0)
    return PairLinearization(velocity, force, jnp.where(touches, stiffness, 0.0))


def parting_change(
    contacts: PairContacts, qdd: Float[Array, "d *n"], h: float
) -> Float[Array, "p *n"]:
    """By how much joint accelerations change the velocities at which points part in a step, m/s."""
    return h * (contacts.jacobian * qdd[None]).sum(1)


def parting_velocity(
    contacts: PairContacts, qdd: Float[Array, "d *n"], h: float
) -> Float[Array, "p *n"]:
    """At the end of the step, m/s."""
    return contacts.coasting + parting_change(contacts, qdd, h)


def pushing_torque(contacts: PairContacts, force: Float[Array, "p *n"]) -> Float[Array, "d *n"]:
    """What forces of pairs (N) are to the joints, N m."""
    return (contacts.jacobian * force[:, None]).sum(0)
