"""Soft limits of ball joints, on the angle of the rotation across the joint.

The coordinates q of a ball are its rotation vector. Its angle |q| changes at the rate ``n . qd``
with the direction n = q / |q|, because a rotation about n leaves n as it is. The limit is the law
of a joint axis (`evo_cpg.physics.tree.joint_torque`) with |q| in place of the angle. Its torque is
along n, and ``tau_end = n (f - K n . (qd_end - qd))`` adds ``h K n n^T`` to the mass matrix. A tree
with such limits is therefore solved by elimination in generalized coordinates.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import dot, expand_dims_like
from evo_cpg.creature.axis_kinds import SPANNING
from evo_cpg.creature.laws import BallLimits
from evo_cpg.creature.per_body import take
from evo_cpg.physics.tree.joint_torque import Coordinates, expected_limit_torque, limit_torque
from evo_cpg.physics.tree.root import JOINTS, ROOT_DOFS
from evo_cpg.physics.tree.state import State

# Square of the angle (rad) below which its direction does not matter.
_NO_ANGLE = 1e-12


class BallLaws(NamedTuple):
    """Limits of balls in a step.

    Attributes:
        limits: the limits.
        direction: n of each ball, in its axes, at the start of the step.
        angles: angles at the start of the step.
    """

    limits: BallLimits
    direction: Float[Array, "3 b *n"]
    angles: Coordinates

    def linearized(self, qdd: Float[Array, "d *n"], h: float) -> "BallForce":
        """Return the limits, linearized at joint accelerations."""
        change = h * self.rate(qdd)
        torque, slope = limit_torque(self.limits, self.angles.q, self.angles.qd + change, h)
        return BallForce(self, torque + slope * change, h * slope)

    def expected(self, h: float) -> "BallForce":
        """Return the limits for a step without iteration."""
        torque, slope = expected_limit_torque(self.limits, self.angles, h)
        return BallForce(self, torque, h * slope)

    def rate(self, qd: Float[Array, "d *n"]) -> Float[Array, "b *n"]:
        """Return the rates of the angles at joint rates."""
        return dot(self.direction, _of_balls(self.limits, qd))

    def torque_of(self, torque: Float[Array, "b *n"], dofs: int) -> Float[Array, "d *n"]:
        """Return the torques about all degrees of freedom, from torques along n, N m."""
        none = jnp.zeros((dofs, *torque.shape[1:]), torque.dtype)
        return none.at[_rows(self.limits)].set(self.direction * torque[None])


class BallForce(NamedTuple):
    """Torque of limits along n, as ``torque - resistance n . qdd``.

    Attributes:
        laws: the limits in the step.
        torque: torque at zero joint acceleration, N m.
        resistance: decrease of the torque per acceleration of the angle, kg m^2.
    """

    laws: BallLaws
    torque: Float[Array, "b *n"]
    resistance: Float[Array, "b *n"]

    def at(self, qdd: Float[Array, "d *n"]) -> Float[Array, "d *n"]:
        """Return the torques about all degrees of freedom at joint accelerations, N m."""
        along = self.torque - self.resistance * self.laws.rate(qdd)
        return self.laws.torque_of(along, len(qdd))

    def added_to(
        self, matrix: Float[Array, "v v *n"], force: Float[Array, "v *n"]
    ) -> tuple[Float[Array, "v v *n"], Float[Array, "v *n"]]:
        """Return the matrix plus ``n T n^T``, and the generalized force plus the torque."""
        n, rows = self.laws.direction, ROOT_DOFS + _rows(self.laws.limits)
        block = n[:, None] * n[None] * self.resistance[None, None]
        one, other = np.broadcast_arrays(rows[:, None], rows[None])
        matrix = matrix.at[one, other].add(block)
        return matrix, force.at[JOINTS].add(self.laws.torque_of(self.torque, len(force[JOINTS])))


def ball_laws(limits: BallLimits | None, state: State) -> BallLaws | None:
    """Return the limits of balls in a state, or None without limits."""
    if limits is None:
        return None
    q = _of_balls(limits, state.q)
    squared = dot(q, q)
    some = squared > _NO_ANGLE
    angle = jnp.where(some, jnp.sqrt(jnp.where(some, squared, 1.0)), 0.0)
    direction = jnp.where(some[None], q / jnp.where(some, angle, 1.0)[None], 0.0)
    rate = dot(direction, _of_balls(limits, state.qd))
    return BallLaws(limits, direction, Coordinates(angle, rate))


def within(limits: BallLimits | None, q: Float[Array, "d *n"]) -> Float[Array, "d *n"]:
    """Return the coordinates with the rotations of balls shortened to their limits."""
    if limits is None:
        return q
    turn = _of_balls(limits, q)
    squared, upper = dot(turn, turn), expand_dims_like(limits.upper, turn[0])
    beyond = squared > upper**2
    scale = jnp.where(beyond, upper / jnp.sqrt(jnp.where(beyond, squared, 1.0)), 1.0)
    return q.at[_rows(limits)].set(turn * scale[None])


def _rows(limits: BallLimits) -> np.ndarray:
    """Return the degrees of freedom of the balls, one row for each axis."""
    return np.arange(SPANNING)[:, None] + np.array(limits.first)[None]


def _of_balls(limits: BallLimits, q: Float[Array, "d *n"]) -> Float[Array, "3 b *n"]:
    return jnp.stack([take(q, row, 0) for row in _rows(limits)])
