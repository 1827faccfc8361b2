"""Torques on the joint axes: motors, passive spring and damper, soft limits.

Each law gives its torque at the present rates and its derivative. The implicit step uses
``tau_end = tau - T qdd`` with the diagonal T below.

- Passive: ``-k (q + h qd) - c qd``, T = h (c + h k).
- Limit: a one-sided spring and damper, ``-K max(0, qd_end - v*)`` with ``K = c + h k``. The rate v*
  brings the joint just to its limit at the end of the step. If the joint is past its limit, v* is
  the return rate of the spring. The limit never slows a returning joint. A step of one solve (no
  ground, no motor limits) uses a spring and damper if the joint would pass its limit at the present
  rate.
- Motor: ``g (rate* - qd) + k_m (angle* - q - h qd)``, T = h (g + h k_m), with a limit on the torque
  at the *end* of the step. A limit on the torque before the step makes the motor chatter and exceed
  its limit threefold. If k_m = 0, the motor is a velocity servo (Iwadate 2010:
  "angular-velocity control"). If rate* = 0, the motor is a dashpot (Fukui 2003, 2.6).
- Muscles: `evo_cpg.physics.muscle`, without a limit.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from evo_cpg.creature.tree import Tree
from evo_cpg.physics.muscle import pull_of
from evo_cpg.physics.state import State
from evo_cpg.spatial.linear import expand_dims_like


class MotorCommand(NamedTuple):
    """Command to the motors and muscles, constant over a step.

    Attributes:
        target_rate: reference rates of the motors, rad/s.
        target_angle: reference angles of the motors' springs, rad, or None for the neutral pose.
        activation: activation of the muscles, 0 to 1: of those that pull to positive angles, then
            of the others. None relaxes them all.
    """

    target_rate: Float[Array, "d *n"]
    target_angle: Float[Array, "d *n"] | None = None
    activation: Float[Array, "2 d *n"] | None = None


class MotorTorque(NamedTuple):
    """Commanded torque of motors and muscles in a step, without limit.

    Attributes:
        start: torque at the present rates, N m.
        of_muscles: decrease of the muscles' torque per final rate, N m s/rad, or None without
            muscles.
    """

    start: Float[Array, "d *n"]
    of_muscles: Float[Array, "d *n"] | None = None

    def derivative(self, tree: Tree, h: float) -> Float[Array, "d *n"]:
        """Return the torque decrease per final rate (N m s/rad), always positive.

        A servo's decrease is ``g + h k_m``.
        """
        servo = expand_dims_like(tree.servo_gain + h * tree.servo_stiffness, self.start)
        every = servo if self.of_muscles is None else servo + self.of_muscles
        return jnp.maximum(every, jnp.finfo(self.start.dtype).tiny)

    def at(self, tree: Tree, qdd: Float[Array, "d *n"], h: float) -> Float[Array, "d *n"]:
        """Return the torque at the end of a step of h (s) with joint accelerations qdd, N m."""
        return self.start - h * self.derivative(tree, h) * qdd


def passive_torque(
    tree: Tree, state: State, h: float
) -> tuple[Float[Array, "d *n"], Float[Array, "d *#n"]]:
    """Return the torque (N m) and T (kg m^2) of springs and dampers over a step of h (s)."""
    stiffness, damping = (expand_dims_like(x, state.q) for x in (tree.stiffness, tree.damping))
    torque = -stiffness * (state.q + h * state.qd) - damping * state.qd
    return torque, h * (damping + h * stiffness)


def limit_torque(
    tree: Tree, q: Float[Array, "d *n"], rate: Float[Array, "d *n"], h: float
) -> tuple[Float[Array, "d *n"], Float[Array, "d *n"]]:
    """Return the torque of the soft limits (N m), and its decrease per rate (N m s/rad).

    Args:
        tree: the creature.
        q: joint angles at the start of the step, rad.
        rate: joint rates at the end of the step, rad/s.
        h: step, s, or 0 for the law itself, without a step.
    """
    stiffness, damping, lower, upper = (
        expand_dims_like(x, q)
        for x in (tree.limit_stiffness, tree.limit_damping, tree.lower, tree.upper)
    )
    derivative = damping + h * stiffness

    def miss(beyond: Array, outwards: Array) -> Array:
        """Return the excess of a rate towards a limit over v*, times K."""
        back = derivative * outwards + stiffness * beyond
        ahead = derivative * (outwards + (1.0 / h) * beyond) if h else jnp.zeros_like(back)
        return jnp.maximum(jnp.where(beyond > 0, back, ahead), 0.0)

    above, below = miss(q - upper, rate), miss(lower - q, -rate)
    return below - above, jnp.where((above > 0) | (below > 0), derivative, 0.0)


def expected_limit_torque(
    tree: Tree, state: State, h: float
) -> tuple[Float[Array, "d *n"], Float[Array, "d *n"]]:
    """Return the torque of the limits and its decrease per rate, for a step of one solve."""
    q, rate = state.q, state.qd
    ahead = q + h * rate
    over = ahead - jnp.clip(ahead, expand_dims_like(tree.lower, q), expand_dims_like(tree.upper, q))
    stiffness, damping = (
        expand_dims_like(x, q) for x in (tree.limit_stiffness, tree.limit_damping)
    )
    beyond = over != 0
    torque = jnp.where(beyond, -stiffness * over - damping * rate, 0.0)
    return torque, jnp.where(beyond, damping + h * stiffness, 0.0)


def motor_torque(tree: Tree, state: State, command: MotorCommand, h: float) -> MotorTorque:
    """Return the commanded torque of motors and muscles.

    Args:
        tree: the creature.
        state: joint angles and rates of the creature.
        command: command to motors and muscles.
        h: step, s.
    """
    rates = state.qd
    torque = expand_dims_like(tree.servo_gain, rates) * (command.target_rate - rates)
    if has_springs(tree):
        ahead = state.q + h * rates
        angle = command.target_angle
        error = -ahead if angle is None else angle - ahead
        torque = torque + expand_dims_like(tree.servo_stiffness, rates) * error
    if tree.muscles is None:
        return MotorTorque(torque)
    pull = pull_of(tree.muscles, command.activation, state.q, rates)
    return MotorTorque(torque + pull.torque(state.q, rates), pull.derivative(h))


def has_springs(tree: Tree) -> bool:
    """Return whether any motor pulls towards an angle."""
    stiffness = tree.servo_stiffness
    return not isinstance(stiffness, np.ndarray) or bool(stiffness.any())


def overloaded(tree: Tree, torque: Float[Array, "d *n"]) -> Bool[Array, "d *n"]:
    """Return which axes have a commanded torque above its limit."""
    return jnp.abs(torque) > expand_dims_like(tree.torque_limit, torque)


def clamp_torque(tree: Tree, torque: Float[Array, "d *n"]) -> Float[Array, "d *n"]:
    """Return the servo torque clamped to its limit, N m."""
    limit = expand_dims_like(tree.torque_limit, torque)
    return jnp.clip(torque, -limit, limit)
