"""Contacts between bodies of one creature in a step: a few pairs, unrolled, or many, in loops.

The contact of a pair couples two branches of the tree of bodies. In generalized coordinates the
contact changes a few elements of the mass matrix (`evo_cpg.physics.step.step_problem`).
`evo_cpg.physics.contact.pairs` has the contact law. Few pairs are unrolled here, because a loop
over ten pairs makes a whole trial take 1.6 times as long. `evo_cpg.physics.contact.many_pairs`
loops over many pairs. Both have the members

| `PairContacts` | |
|---|---|
| ``bias`` | determines the velocity-product acceleration of the points along their normals |
| ``with_bias(bias)`` | the contacts with another bias |
| ``bias_at(qdd)`` | ``bias`` for the joint rates after a step with joint accelerations ``qdd`` |
| ``at(qdd, sums)`` | the `PairForces` at joint accelerations, ``sums`` included if known |
| ``change(qdd)`` | the change of velocities that ``PairForces.power`` takes |
| ``touches(qdd)`` | where any pair pushes |
| ``drifts(qdd, bias, among)`` | where another bias would move a touching pair too far |
| ``parting(rates)`` | the separation velocities of points at joint rates, ``J rates``, m/s |

| `PairForces` | |
|---|---|
| ``sums`` | what an evaluation found, so that it need not be repeated |
| ``force``, ``load`` | force of every point, and their sum, N |
| ``torque`` | joint torques of the forces, ``J^T f``, N m |
| ``power(change)`` | power of the forces, W |
| ``newton()`` | linearized torques at zero joint acceleration, and ``h J^T K J`` |

The bias has two forms. Few pairs store the acceleration itself, ``(p, *n)``, m/s^2. Many pairs
store the joint accelerations that lead from the rates at the start of the step to the rates of the
bias, ``(d, *n)``, rad/s^2. `find_pair_contacts` takes the rates at the start.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from evo_cpg.creature.algebra.linear import cross, dot, expand_dims_like, matvec, t_matmul
from evo_cpg.creature.per_body import take
from evo_cpg.creature.reach import chain_to_root
from evo_cpg.creature.tree import Tree
from evo_cpg.physics.contact.contact import rest_velocity
from evo_cpg.physics.contact.many_pairs import ManyPairContacts, ManyPairForces
from evo_cpg.physics.contact.pairs import (
    LARGEST_DRIFT,
    Pairs,
    PointMotion,
    acceleration_field,
    parting_acceleration,
    separations,
)
from evo_cpg.physics.contact.separation import Separation
from evo_cpg.physics.tree.kinematics import Kinematics, motion_of_bodies
from evo_cpg.physics.tree.root import ROOT_DOFS
from evo_cpg.physics.tree.spatial_algebra import BodyMotion


class FewPairContacts(NamedTuple):
    """Contacts of pairs and their constants throughout one step.

    Two bodies of one tree separate only by turns of the joints between them. The separation speed
    along the normal is ``J qd``. A force f of the pair gives these joints the torques ``J^T f``.

    Attributes:
        gap: gap of each contact, m.
        jacobian: J, m, with zeros for joints that are not between the bodies.
        unconstrained_velocity: mean over the step with zero joint accelerations, m/s.
        target_velocity: v*, m/s.
        bias: velocity-product bias, m/s^2: the acceleration along the normal at constant joint
            rates. `unconstrained_velocity` includes it.
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

    def with_bias(self, bias: Float[Array, "p *n"]) -> "FewPairContacts":
        """Return the contacts with another velocity-product bias, m/s^2."""
        unconstrained_velocity = self.unconstrained_velocity + 0.5 * self.h * (bias - self.bias)
        return self._replace(unconstrained_velocity=unconstrained_velocity, bias=bias)

    def bias_at(self, qdd: Float[Array, "d *n"]) -> Float[Array, "p *n"]:
        """Return the velocity-product bias at the joint rates after the step, m/s^2."""
        rates = self.qd + self.h * qdd
        # The motion of the root does not change the separation, so hold the root at rest.
        still = jnp.zeros((ROOT_DOFS, *rates.shape[1:]), rates.dtype)
        motion = motion_of_bodies(self.tree, self.kin, still, rates)
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

    def drifts(
        self, qdd: Float[Array, "d *n"], bias: Float[Array, "p *n"], among: Bool[Array, "*n"]
    ) -> Bool[Array, "*n"]:
        """Return which of some individuals need an update of their velocity-product bias.

        Another bias would move a touching pair by more than `LARGEST_DRIFT`.
        """
        velocity, other = self.velocity(qdd), self.with_bias(bias).velocity(qdd)
        touches = (self.target_velocity > velocity) | (self.target_velocity > other)
        return among & (touches & (self.h * jnp.abs(other - velocity) > LARGEST_DRIFT)).any(0)


class FewPairForces(NamedTuple):
    """Contact laws linearized at a velocity: ``f = force - derivative (v - velocity)``.

    Attributes:
        velocity: separation velocity of the linearization, m/s.
        force: force at this velocity, N.
        derivative: decrease of the force per velocity, N s/m.
    """

    contacts: FewPairContacts
    velocity: Float[Array, "p *n"]
    force: Float[Array, "p *n"]
    derivative: Float[Array, "p *n"]

    # Code that is written out has nothing to save.
    sums = None

    @property
    def load(self) -> Float[Array, "*n"]:
        """Sum of all forces, N."""
        return self.force.sum(0)

    @property
    def torque(self) -> Float[Array, "d *n"]:
        """Joint torques of the forces, N m."""
        return (self.contacts.jacobian * self.force[:, None]).sum(0)

    def power(self, change: Float[Array, "p *n"]) -> Float[Array, "*n"]:
        """Return the power of the forces at velocity changes of `FewPairContacts.change`, W."""
        return dot(change, self.force)

    def newton(self) -> tuple[Float[Array, "d *n"], Float[Array, "d d *n"]]:
        """Return the torques of the linearized forces at zero acceleration, and ``h J^T K J``."""
        J, derivative = self.contacts.jacobian, self.derivative
        force = self.force + derivative * (self.velocity - self.contacts.unconstrained_velocity)
        torque = (J * force[:, None]).sum(0)
        return torque, t_matmul(self.contacts.h * derivative[:, None] * J, J)


PairContacts = FewPairContacts | ManyPairContacts
PairForces = FewPairForces | ManyPairForces


def find_pair_contacts(
    tree: Tree, pairs: Pairs, kin: Kinematics, qd: Float[Array, "d *n"], h: float
) -> PairContacts:
    """Find the nearest points of all pairs, and their separation velocities."""
    if pairs.looped or tree.walk is not None:
        return ManyPairContacts(tree, pairs, kin, qd, h)
    where = separations(pairs, kin)
    rest, bias = rest_velocity(where.gap, h), _bias(pairs, kin.origin, kin, where)
    _, normal, *points, _ = where
    origins = take(kin.origin, np.array(tree.dof_bodies, int))
    chains = [[set(chain_to_root(tree, body)) for body in bodies] for bodies in pairs.owners]
    speeds = []
    for point, own, others in zip(points, chains, reversed(chains), strict=True):
        # A joint that moves both bodies does not part them.
        each = zip(own, others, strict=True)
        moves = [[body in one - other for body in tree.dof_bodies] for one, other in each]
        # Speed of the points along their normals, per rate of each degree of freedom.
        offset, S = point[:, :, None] - origins[:, None], kin.axes
        along = jnp.broadcast_to(normal[:, :, None], offset.shape)
        speed = dot(S.angular[:, None], cross(offset, along))
        if S.linear is not None:
            speed = speed + dot(S.linear[:, None], along)
        speeds.append(expand_dims_like(np.array(moves, float), speed) * speed)
    jacobian = speeds[1] - speeds[0]
    velocity = (jacobian * qd[None]).sum(1) + 0.5 * h * bias
    return FewPairContacts(
        tree, pairs, kin, qd, h, where.gap, jacobian, velocity, rest, bias, where
    )


def _bias(pairs: Pairs, origin: Array, motion: Kinematics | BodyMotion, where: Separation) -> Array:
    """Return the acceleration along the normals at constant joint rates, m/s^2."""
    _, normal, *points, carried = where
    a, A = acceleration_field(motion)
    moving = []
    for bodies, point in zip(pairs.owners, points, strict=True):
        own = np.array(bodies)
        offset, angular = point - take(origin, own), take(motion.angular, own)
        velocity = take(motion.linear, own) + cross(angular, offset)
        acceleration = take(a, own) + matvec(take(A, own, 2), offset)
        moving.append(PointMotion(angular, velocity, acceleration))
    return parting_acceleration(normal, carried, moving)
