"""Torques on the joint axes: motors, passive spring and damper, soft limits.

Motors, limits and dry friction of tendons obey the same laws, with the tendon's length for the
angle and its force for the torque (`evo_cpg.physics.tree.tendon`).

Each law gives its torque at the present rates and its derivative. The implicit step uses
``tau_end = tau - T qdd`` with the diagonal T below.

- Passive: ``-k (q + h qd - rest) - c qd``, T = h (c + h k).
- Limit: a one-sided spring and damper, ``-K max(0, qd_end - v*)`` with ``K = c + h k``. The rate v*
  brings the joint just to its limit at the end of the step. If the joint is past its limit, v* is
  the return rate of the spring, so the limit does not slow a returning joint. A step without
  iteration uses a spring and damper if the joint would pass its limit at the present rate.
- Dry friction: ``-clip(K qd_end, F)`` with the friction loss F. ``K = 1000 I / h`` is so large that
  the joint sticks below F: it keeps a thousandth of its acceleration. I is its effective inertia.
- Motor: ``g (rate* - qd) + k_m (angle* - q - h qd)``, T = h (g + h k_m), with a limit on the torque
  at the *end* of the step. A limit on the torque before the step makes the motor chatter and exceed
  its limit threefold. If k_m = 0, the motor is a velocity servo (Iwadate 2010:
  "angular-velocity control"). If rate* = 0, the motor is a dashpot (Fukui 2003, 2.6).
- Torque motor: the commanded torque up to its limit, T = 0. It is constant over the step.
- Muscles: `evo_cpg.physics.tree.muscle`, without a limit.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from evo_cpg.creature.algebra.linear import expand_dims_like
from evo_cpg.creature.laws import BallLimits, CoordinateLaws
from evo_cpg.creature.tree import Tree
from evo_cpg.physics.tree.muscle import pull_of
from evo_cpg.physics.tree.state import State

# Resistance of a joint that sticks by dry friction, times the step, relative to its inertia.
_STICKING = 1000.0

# Torques count as equal if they differ by less than this fraction of the motor's limit.
_SAME_TORQUE = 1e-3

# Torque that counts as zero, N m.
_NONE = 1e-12


# Numbers of limits of joint axes, tendons or balls.
Limits = CoordinateLaws | BallLimits


class Coordinates(NamedTuple):
    """Lengths of tendons or angles of balls (rad), and their rates (rad/s)."""

    q: Float[Array, "d *n"]
    qd: Float[Array, "d *n"]


class MotorCommand(NamedTuple):
    """Command to the motors and muscles, constant over a step.

    Attributes:
        target_rate: reference rates of the motors, rad/s.
        target_angle: reference angles of the motors' springs, rad, or None for the neutral pose.
        activation: activation of the muscles, 0 to 1: of those that pull to positive angles, then
            of the others. None relaxes them all.
        torque: torque of the torque motors, N m, or None for no torque.
    """

    target_rate: Float[Array, "d *n"]
    target_angle: Float[Array, "d *n"] | None = None
    activation: Float[Array, "2 d *n"] | None = None
    torque: Float[Array, "d *n"] | None = None

    def filled(self) -> "MotorCommand":
        """Return the command with zeros in place of parts that are None."""
        none = jnp.zeros_like(self.target_rate)
        return MotorCommand(
            self.target_rate,
            none if self.target_angle is None else self.target_angle,
            jnp.zeros((2, *none.shape), none.dtype) if self.activation is None else self.activation,
            none if self.torque is None else self.torque,
        )


class MotorTorque(NamedTuple):
    """Commanded torque of motors and muscles in a step, without limit.

    Attributes:
        start: torque at the present rates, N m.
        of_muscles: decrease of the muscles' torque per final rate, N m s/rad, or None without
            muscles.
    """

    start: Float[Array, "d *n"]
    of_muscles: Float[Array, "d *n"] | None = None

    def derivative(self, tree: CoordinateLaws, h: float) -> Float[Array, "d *n"]:
        """Return the torque decrease per final rate (N m s/rad), always positive.

        A servo's decrease is ``g + h k_m``.
        """
        servo = expand_dims_like(tree.servo_gain + h * tree.servo_stiffness, self.start)
        every = servo if self.of_muscles is None else servo + self.of_muscles
        return jnp.maximum(every, jnp.finfo(self.start.dtype).tiny)

    def at(self, tree: CoordinateLaws, qdd: Float[Array, "d *n"], h: float) -> Float[Array, "d *n"]:
        """Return the torque at the end of a step of h (s) with joint accelerations qdd, N m."""
        return self.start - h * self.derivative(tree, h) * qdd


def passive_torque(
    tree: Tree, state: State | Coordinates, h: float
) -> tuple[Float[Array, "d *n"], Float[Array, "d *#n"]]:
    """Return the torque (N m) and T (kg m^2) of springs and dampers over a step of h (s)."""
    stiffness, damping = (expand_dims_like(x, state.q) for x in (tree.stiffness, tree.damping))
    torque = -stiffness * (state.q + h * state.qd) - damping * state.qd
    if tree.rest is not None:
        torque = torque + stiffness * expand_dims_like(tree.rest, state.q)
    return torque, h * (damping + h * stiffness)


def limit_torque(
    tree: Limits, q: Float[Array, "d *n"], rate: Float[Array, "d *n"], h: float
) -> tuple[Float[Array, "d *n"], Float[Array, "d *n"]]:
    """Return the torque of the soft limits (N m), and its decrease per rate (N m s/rad).

    The angles are those at the start of the step, the rates (rad/s) those at its end. A step of 0
    gives the law itself.
    """
    stiffness, damping, lower, upper = (
        expand_dims_like(x, q)
        for x in (tree.limit_stiffness, tree.limit_damping, tree.lower, tree.upper)
    )
    derivative = damping + h * stiffness

    # The excess of the rate towards each limit over v*, times K.
    missed = []
    for beyond, outwards in ((q - upper, rate), (lower - q, -rate)):
        back = derivative * outwards + stiffness * beyond
        ahead = derivative * (outwards + (1.0 / h) * beyond) if h else jnp.zeros_like(back)
        missed.append(jnp.maximum(jnp.where(beyond > 0, back, ahead), 0.0))
    above, below = missed
    return below - above, jnp.where((above > 0) | (below > 0), derivative, 0.0)


def friction_torque(
    tree: CoordinateLaws, rate: Float[Array, "d *n"], h: float
) -> tuple[Float[Array, "d *n"], Float[Array, "d *n"]]:
    """Return the torque of dry friction (N m), and its decrease per rate (N m s/rad)."""
    assert tree.dry_friction is not None
    loss = expand_dims_like(tree.dry_friction.loss, rate)
    resistance = expand_dims_like(tree.dry_friction.inertia * (_STICKING / h), rate)
    sticking = resistance * rate
    slides = jnp.abs(sticking) >= loss
    return -jnp.clip(sticking, -loss, loss), jnp.where(slides, 0.0, resistance)


def linearized_torque(
    tree: CoordinateLaws,
    motor: MotorTorque,
    state: State | Coordinates,
    qdd: Float[Array, "d *n"],
    h: float,
) -> tuple[Float[Array, "d *n"], Float[Array, "d *n"]]:
    """Return the torque of motors, limits and friction, linearized at accelerations.

    Returns:
        Torque at zero acceleration (N m), and its decrease per end-of-step rate (N m s/rad).
    """
    commanded = motor.at(tree, qdd, h)
    over = jnp.abs(commanded) > expand_dims_like(tree.torque_limit, commanded)
    torque = jnp.where(over, clamp_torque(tree, commanded), motor.start)
    derivative = jnp.where(over, 0.0, motor.derivative(tree, h))
    change = h * qdd
    stop, stop_derivative = limit_torque(tree, state.q, state.qd + change, h)
    torque, derivative = torque + stop + stop_derivative * change, derivative + stop_derivative
    if tree.dry_friction is not None:
        rub, rub_derivative = friction_torque(tree, state.qd + change, h)
        torque, derivative = torque + rub + rub_derivative * change, derivative + rub_derivative
    return torque, derivative


def changes_overload(
    tree: CoordinateLaws,
    motor: MotorTorque,
    state: State | Coordinates,
    qdd: Float[Array, "d *n"],
    h: float,
) -> Bool[Array, "*n"]:
    """Return for which individuals accelerations overload other motors than zero acceleration.

    It counts joints that begin to stick or slide, too. The arguments are those of
    `linearized_torque`.
    """
    commanded = motor.at(tree, qdd, h)
    given, limit = clamp_torque(tree, commanded), expand_dims_like(tree.torque_limit, commanded)
    over = jnp.abs(motor.start) > limit
    stays = jnp.where(over, clamp_torque(tree, motor.start), commanded)
    least = _SAME_TORQUE * limit + _NONE
    changes = (jnp.abs(given - stays) > least).any(0)
    if tree.dry_friction is None:
        return changes
    rate, change = state.qd, h * qdd
    before, slope = friction_torque(tree, rate, h)
    after, _ = friction_torque(tree, rate + change, h)
    least = _SAME_TORQUE * expand_dims_like(tree.dry_friction.loss, after) + _NONE
    return changes | (jnp.abs(after - before + slope * change) > least).any(0)


def expected_limit_torque(
    tree: Limits, state: State | Coordinates, h: float
) -> tuple[Float[Array, "d *n"], Float[Array, "d *n"]]:
    """Return the torque of the limits and its decrease per rate, for a step without iteration."""
    q, rate = state.q, state.qd
    ahead = q + h * rate
    over = ahead - jnp.clip(ahead, expand_dims_like(tree.lower, q), expand_dims_like(tree.upper, q))
    stiffness, damping = (
        expand_dims_like(x, q) for x in (tree.limit_stiffness, tree.limit_damping)
    )
    beyond = over != 0
    torque = jnp.where(beyond, -stiffness * over - damping * rate, 0.0)
    return torque, jnp.where(beyond, damping + h * stiffness, 0.0)


def motor_torque(
    tree: CoordinateLaws, state: State | Coordinates, command: MotorCommand, h: float
) -> MotorTorque:
    """Return the commanded torque of motors and muscles."""
    rates = state.qd
    torque = expand_dims_like(tree.servo_gain, rates) * (command.target_rate - rates)
    stiffness = tree.servo_stiffness
    if not isinstance(stiffness, np.ndarray) or stiffness.any():
        ahead = state.q + h * rates
        angle = command.target_angle
        error = -ahead if angle is None else angle - ahead
        torque = torque + expand_dims_like(stiffness, rates) * error
    if tree.torque_motors is not None and command.torque is not None:
        driven = expand_dims_like(np.array(tree.torque_motors.driven), rates).astype(bool)
        torque = torque + jnp.where(driven, clamp_torque(tree, command.torque), 0.0)
    if tree.muscles is None:
        return MotorTorque(torque)
    pull = pull_of(tree.muscles, command.activation, state.q, rates)
    # The springs act on the mean of three successive angles, with the weight 1/4 of the last one.
    of_muscles = pull.damping + 0.25 * h * pull.stiffness
    return MotorTorque(torque + pull.torque(state.q, rates), of_muscles)


def clamp_torque(tree: CoordinateLaws, torque: Float[Array, "d *n"]) -> Float[Array, "d *n"]:
    """Return the motors' torque clamped to its limit, N m."""
    limit = expand_dims_like(tree.torque_limit, torque)
    return jnp.clip(torque, -limit, limit)
