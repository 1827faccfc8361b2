"""Forces of fixed tendons, whose length is a weighted sum of joint angles, ``L = C q``.

A tendon's force f is the torque ``C^T f`` on the joints. Its motor, limits and dry friction obey
the laws of joint axes (`evo_cpg.physics.tree.joint_torque`) with L in place of the angle. Its
spring and damper are implicit, too:

    f = -k (L_end - clip(L_end, a, b)) - c L'_end,    L_end = L + h L'_end,

with the shortest and the longest length a and b at which the spring is slack. A step keeps the side
of this dead band on which ``L + h L'`` lies.

Every law has the form ``f_end = f - T C qdd``. It adds ``C^T T C`` to the mass matrix, which
couples joints that are no ancestors of each other. A tree with tendons is therefore solved by
elimination in generalized coordinates (`evo_cpg.physics.step.step_problem`).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from evo_cpg.creature.algebra.linear import expand_dims_like
from evo_cpg.creature.laws import Tendons
from evo_cpg.creature.per_body import spread, take
from evo_cpg.physics.tree.joint_torque import (
    Coordinates,
    MotorCommand,
    MotorTorque,
    expected_limit_torque,
    linearized_torque,
    motor_torque,
)
from evo_cpg.physics.tree.root import JOINTS, ROOT_DOFS
from evo_cpg.physics.tree.state import State


class TendonLaws(NamedTuple):
    """Laws of the tendons in a step.

    Attributes:
        passive: force of springs and dampers at the present rates.
        derivative: T of springs and dampers, with the armature.
    """

    tendons: Tendons
    lengths: Coordinates
    passive: Float[Array, "t *n"]
    derivative: Float[Array, "t *#n"]
    motor: MotorTorque

    def linearized(self, qdd: Float[Array, "d *n"], h: float) -> "TendonForce":
        """Return motors, limits and dry friction, linearized at joint accelerations."""
        change = length_of(self.tendons, qdd)
        force, slope = linearized_torque(self.tendons, self.motor, self.lengths, change, h)
        return TendonForce(self.tendons, force, h * slope)

    def expected(self, h: float) -> "TendonForce":
        """Return all laws for a step without iteration."""
        stop, slope = expected_limit_torque(self.tendons, self.lengths, h)
        resistance = self.derivative + h * (self.motor.derivative(self.tendons, h) + slope)
        return TendonForce(self.tendons, self.passive + self.motor.start + stop, resistance)


class TendonForce(NamedTuple):
    """Force of the tendons as ``force - resistance C qdd``.

    Attributes:
        force: force at zero joint acceleration.
        resistance: decrease of the force per acceleration of the length.
    """

    tendons: Tendons
    force: Float[Array, "t *n"]
    resistance: Float[Array, "t *#n"]

    def torque(self, qdd: Float[Array, "d *n"]) -> Float[Array, "d *n"]:
        """Return the torques on the joints, N m."""
        force = self.force - self.resistance * length_of(self.tendons, qdd)
        return torque_of(self.tendons, force, len(qdd))

    def added_to(
        self, matrix: Float[Array, "v v *n"], force: Float[Array, "v *n"]
    ) -> tuple[Float[Array, "v v *n"], Float[Array, "v *n"]]:
        """Return the matrix plus ``C^T T C``, and the generalized force plus ``C^T f``."""
        tendons = self.tendons
        pairs = [
            (i, j)
            for i, one in enumerate(tendons.owners)
            for j, other in enumerate(tendons.owners)
            if one == other
        ]
        one, other = np.array(pairs, int).T
        dofs, owners = np.array(tendons.dofs), np.array(tendons.owners)
        coefficients = expand_dims_like(tendons.coefficients, self.force)
        product = take(coefficients, one, 0) * take(coefficients, other, 0)
        values = product * take(self.resistance, owners[one], 0)
        matrix = matrix.at[ROOT_DOFS + dofs[one], ROOT_DOFS + dofs[other]].add(values)
        torque = torque_of(tendons, self.force, len(force[JOINTS]))
        return matrix, force.at[JOINTS].add(torque)


def tendon_laws(
    tendons: Tendons | None, state: State, command: MotorCommand, h: float
) -> TendonLaws | None:
    """Return the laws of the tendons in a step of h (s), or None without tendons."""
    if tendons is None:
        return None
    lengths = lengths_of(tendons, state)
    passive, derivative = passive_force(tendons, lengths, h)
    derivative = derivative + expand_dims_like(tendons.armature, derivative)
    channels = np.maximum(tendons.channels, 0)
    own = jax.tree.map(lambda x: take(x, channels, 0), command._replace(activation=None))
    motor = motor_torque(tendons, lengths, own, h)
    return TendonLaws(tendons, lengths, passive, derivative, motor)


def passive_force(
    tendons: Tendons, lengths: Coordinates, h: float
) -> tuple[Float[Array, "t *n"], Float[Array, "t *n"]]:
    """Return the force and T of springs and dampers over a step of h (s)."""
    stiffness, damping = (
        expand_dims_like(x, lengths.q) for x in (tendons.stiffness, tendons.damping)
    )
    ahead = lengths.q + h * lengths.qd
    stretch, slack = stretch_of(tendons, ahead)
    stiffness = jnp.where(slack, 0.0, stiffness)
    return -stiffness * stretch - damping * lengths.qd, h * (damping + h * stiffness)


def lengths_of(tendons: Tendons, state: State) -> Coordinates:
    """Return the lengths of the tendons and their rates in a state."""
    return Coordinates(length_of(tendons, state.q), length_of(tendons, state.qd))


def length_of(tendons: Tendons, q: Float[Array, "d *n"]) -> Float[Array, "t *n"]:
    """Return the lengths at joint angles, or the rates of the lengths at joint rates."""
    parts = expand_dims_like(tendons.coefficients, q) * take(q, np.array(tendons.dofs), 0)
    return spread(parts, tendons.owners, len(tendons.names), 0)


def torque_of(tendons: Tendons, force: Float[Array, "t *n"], dofs: int) -> Float[Array, "d *n"]:
    """Return the torques of the tendons' forces on all degrees of freedom, N m."""
    parts = expand_dims_like(tendons.coefficients, force) * take(force, np.array(tendons.owners), 0)
    return spread(parts, tendons.dofs, dofs, 0)


def stretch_of(
    tendons: Tendons, length: Float[Array, "t *n"]
) -> tuple[Float[Array, "t *n"], Bool[Array, "t *n"]]:
    """Return how far the springs are stretched at some lengths, and whether they are slack."""
    rest = tendons.shortest_rest, tendons.longest_rest
    shortest, longest = (expand_dims_like(x, length) for x in rest)
    slack = (length > shortest) & (length < longest)
    return length - jnp.clip(length, shortest, longest), slack
