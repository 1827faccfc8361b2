"""Contacts of a few pairs of bodies, written out one by one.

The contact of a pair couples two branches of the tree of bodies. In generalized coordinates the
contact changes a few elements of the mass matrix (`evo_cpg.physics.step.step_problem`).
`evo_cpg.physics.contact.pairs` has the contact law.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from evo_cpg.creature.algebra.linear import cross, dot, expand_dims_like, matvec, t_matmul
from evo_cpg.creature.reach import chain_to_root
from evo_cpg.creature.tree import Tree
from evo_cpg.physics.contact.contact import rest_velocity
from evo_cpg.physics.contact.pairs import (
    LARGEST_DRIFT,
    Pairs,
    PointMotion,
    acceleration_field,
    parting_acceleration,
    separations,
)
from evo_cpg.physics.contact.separation import Separation
from evo_cpg.physics.tree import joints, root
from evo_cpg.physics.tree.kinematics import Kinematics, motion_of_bodies
from evo_cpg.physics.tree.per_body import take
from evo_cpg.physics.tree.spatial_algebra import BodyMotion


class FewPairContacts(NamedTuple):
    """Contacts of pairs and their constants throughout one step.

    Two bodies of one tree separate only by turns of the joints between them. The separation speed
    along the normal is ``J qd``. A force f of the pair gives these joints the torques ``J^T f``.

    Attributes:
        tree: the creature.
        pairs: pairs of bodies of the creature.
        kin: kinematics at the start of the step.
        qd: joint rates at the start of the step, rad/s.
        h: step, s.
        gap: gap of each contact, m.
        jacobian: J, m, with zeros for joints that are not between the bodies.
        unconstrained_velocity: mean over the step with zero joint accelerations, m/s.
        target_velocity: v*, m/s.
        bias: velocity-product bias, m/s^2: the acceleration along the normal at constant joint
            rates. `unconstrained_velocity` includes it.
        where: the nearest points.
    """

    tree: Tree
    pairs: Pairs
    kin: Kinematics
    qd: Float[Array, "d *n"]
    h: float
    gap: Float[Array, "p *n"]
    jacobian: Float[Array, "p d *n"]
    unconstrained_velocity: Float[Array, "p *n"]
    target_velocity: Float[Array, "p *n"]
    bias: Float[Array, "p *n"]
    where: Separation

    @classmethod
    def find(
        cls, tree: Tree, pairs: Pairs, kin: Kinematics, qd: Float[Array, "d *n"], h: float
    ) -> "FewPairContacts":
        """Find the contacts of a step (see `pair_contacts.find_pair_contacts`)."""
        where = separations(pairs, kin)
        target_velocity = rest_velocity(where.gap, h)
        bias = _bias(pairs, kin.origin, kin, where)
        jacobian = _jacobian(tree, pairs, kin, where)
        unconstrained_velocity = (jacobian * qd[None]).sum(1) + 0.5 * h * bias
        return cls(
            tree,
            pairs,
            kin,
            qd,
            h,
            where.gap,
            jacobian,
            unconstrained_velocity,
            target_velocity,
            bias,
            where,
        )

    def with_bias(self, bias: Float[Array, "p *n"]) -> "FewPairContacts":
        """Return the contacts with another velocity-product bias, m/s^2."""
        unconstrained_velocity = self.unconstrained_velocity + 0.5 * self.h * (bias - self.bias)
        return self._replace(unconstrained_velocity=unconstrained_velocity, bias=bias)

    def bias_at(self, qdd: Float[Array, "d *n"]) -> Float[Array, "p *n"]:
        """Return the velocity-product bias at the joint rates after the step, m/s^2."""
        rates = self.qd + self.h * qdd
        # The motion of the root does not change the separation, so hold the root at rest.
        motion = motion_of_bodies(self.tree, self.kin, root.at_rest(rates), rates)
        return _bias(self.pairs, self.kin.origin, motion, self.where)

    def change(self, turn: Float[Array, "d *n"]) -> Float[Array, "p *n"]:
        """Return the changes of separation velocities by joint accelerations in a step, m/s."""
        return self.h * self.parting(turn)

    def velocity(self, qdd: Float[Array, "d *n"]) -> Float[Array, "p *n"]:
        """Return the separation velocities at the end of the step, m/s."""
        return self.unconstrained_velocity + self.change(qdd)

    def parting(self, rates: Float[Array, "d *n"]) -> Float[Array, "p *n"]:
        """Return ``J rates``, m/s."""
        return (self.jacobian * rates[None]).sum(1)

    def at(self, qdd: Float[Array, "d *n"], sums: None = None) -> "FewPairForces":
        """Return the forces at joint accelerations, and their derivatives."""
        del sums
        velocity = self.velocity(qdd)
        stiffness = expand_dims_like(self.pairs.stiffness / self.h, velocity)
        short = self.target_velocity - velocity
        touches = short > 0
        force = stiffness * jnp.maximum(short, 0.0)
        return FewPairForces(self, velocity, force, jnp.where(touches, stiffness, 0.0))

    def touches(self, qdd: Float[Array, "d *n"]) -> Bool[Array, "*n"]:
        """Return whether any pair of each individual pushes at joint accelerations."""
        return (self.target_velocity > self.velocity(qdd)).any(0)

    def drifts(self, qdd: Float[Array, "d *n"], bias: Float[Array, "p *n"]) -> Bool[Array, "*n"]:
        """Return whether another bias would move a touching pair by more than `LARGEST_DRIFT`."""
        velocity, other = self.velocity(qdd), self.with_bias(bias).velocity(qdd)
        touches = (self.target_velocity > velocity) | (self.target_velocity > other)
        return (touches & (self.h * jnp.abs(other - velocity) > LARGEST_DRIFT)).any(0)


class FewPairForces(NamedTuple):
    """Contact laws linearized at a velocity: ``f = force - derivative (v - velocity)``.

    Attributes:
        contacts: contacts of the step.
        velocity: separation velocity of the linearization, m/s.
        force: force at this velocity, N.
        derivative: decrease of the force per velocity, N s/m.
    """

    contacts: FewPairContacts
    velocity: Float[Array, "p *n"]
    force: Float[Array, "p *n"]
    derivative: Float[Array, "p *n"]

    @property
    def sums(self) -> None:
        """None: code that is written out has nothing to save."""
        return None

    @property
    def load(self) -> Float[Array, "*n"]:
        """Sum of all forces, N."""
        return self.force.sum(0)

    @property
    def torque(self) -> Float[Array, "d *n"]:
        """Joint torques of the forces, N m."""
        return self._pushing(self.force)

    def power(self, change: Float[Array, "p *n"]) -> Float[Array, "*n"]:
        """Return the power of the forces at velocity changes of `FewPairContacts.change`, W."""
        return dot(change, self.force)

    def newton(self) -> tuple[Float[Array, "d *n"], Float[Array, "d d *n"]]:
        """Return the torques of the linearized forces at zero acceleration, and ``h J^T K J``."""
        J, derivative = self.contacts.jacobian, self.derivative
        force = self.force + derivative * (self.velocity - self.contacts.unconstrained_velocity)
        return self._pushing(force), t_matmul(self.contacts.h * derivative[:, None] * J, J)

    def _pushing(self, force: Float[Array, "p *n"]) -> Float[Array, "d *n"]:
        return (self.contacts.jacobian * force[:, None]).sum(0)


def _bias(pairs: Pairs, origin: Array, motion: Kinematics | BodyMotion, where: Separation) -> Array:
    """Return the acceleration along the normals at constant joint rates.

    Args:
        pairs: pairs of bodies of a creature.
        origin: origins of the bodies, m.
        motion: motion of the bodies.
        where: the nearest points.
    """
    _, normal, *points, carried = where
    a, A = acceleration_field(motion)

    def moving(bodies: tuple[int, ...], point: Array) -> PointMotion:
        own = np.array(bodies)
        offset, angular = point - take(origin, own), take(motion.angular, own)
        velocity = take(motion.linear, own) + cross(angular, offset)
        return PointMotion(angular, velocity, take(a, own) + matvec(take(A, own, 2), offset))

    return parting_acceleration(normal, carried, map(moving, pairs.owners, points))


def _jacobian(
    tree: Tree, pairs: Pairs, kin: Kinematics, where: Separation
) -> Float[Array, "p d *n"]:
    """Return J of `FewPairContacts`."""
    _, normal, *points, _ = where
    origins = take(kin.origin, np.array(tree.dof_bodies, int))
    speeds = []
    for point in points:
        speeds.append(joints.speed_along(kin.axes, point[:, :, None] - origins[:, None], normal))
    between = [_between(tree, *pair) for pair in zip(*pairs.owners, strict=True)]
    of_first, of_second = (
        expand_dims_like(np.array([sides[k] for sides in between], float), speeds[0])
        for k in range(2)
    )
    return of_second * speeds[1] - of_first * speeds[0]


def _between(tree: Tree, first: int, second: int) -> tuple[list[bool], list[bool]]:
    """Return the degrees of freedom that move only the first body, and only the second."""
    one, two = (set(chain_to_root(tree, body)) for body in (first, second))
    return [body in one - two for body in tree.dof_bodies], [
        body in two - one for body in tree.dof_bodies
    ]
