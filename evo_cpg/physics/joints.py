"""Torques on the joint axes: motors, passive spring and damper, soft limits.

Each law is stated as its torque at the present rates and its derivative: the implicit step then
uses ``tau_end = tau - T qdd`` with the diagonal T below.

- Passive: ``-k (q + h qd) - c qd``, T = h (c + h k).
- Limit: the same spring and damper about the limit, only beyond it.
- Motor: ``g (rate* - qd) + k_m (angle* - q - h qd)``, T = h (g + h k_m), up to a limit that holds
  for the torque at the *end* of the step. Deciding it on the torque before the step makes the motor
  chatter and exceed its limit threefold. With k_m = 0 it is a velocity servo (Iwadate 2010:
  "angular-velocity control"), with rate* = 0 a dashpot (Fukui 2003, 2.6).
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from evo_cpg.creature.tree import Tree
from evo_cpg.physics.state import State
from evo_cpg.spatial.linear import expand_dims_like


def passive_torque(
    tree: Tree, state: State, h: float
) -> tuple[Float[Array, "d *n"], Float[Array, "d *n"]]:
    """Torque (N m) and T (kg m^2) of springs, dampers and soft limits over a step of h (s)."""
    q, qd = state.q, state.qd
    ahead = q + h * qd
    torque = -expand_dims_like(tree.stiffness, q) * ahead - expand_dims_like(tree.damping, q) * qd
    derivative = expand_dims_like(h * (tree.damping + h * tree.stiffness), q)
    over = ahead - jnp.clip(ahead, expand_dims_like(tree.lower, q), expand_dims_like(tree.upper, q))
    beyond = over != 0
    torque = torque - jnp.where(
        beyond,
        expand_dims_like(tree.limit_stiffness, q) * over
        + expand_dims_like(tree.limit_damping, q) * qd,
        0.0,
    )
    limit = expand_dims_like(h * (tree.limit_damping + h * tree.limit_stiffness), q)
    return torque, derivative + jnp.where(beyond, limit, 0.0)


def servo_torque(
    tree: Tree,
    state: State,
    target_rate: Float[Array, "d *n"],
    target_angle: Float[Array, "d *n"] | None,
    h: float,
) -> Float[Array, "d *n"]:
    """Torque (N m) that the motors ask for at the present rates, without limit.

    Args:
        tree: the creature.
        state: its joint angles and rates.
        target_rate: rad/s.
        target_angle: rad; None for the neutral pose.
        h: step, s.
    """
    rates = state.qd
    torque = expand_dims_like(tree.servo_gain, rates) * (target_rate - rates)
    if not has_springs(tree):
        return torque
    ahead = state.q + h * rates
    error = -ahead if target_angle is None else target_angle - ahead
    return torque + expand_dims_like(tree.servo_stiffness, rates) * error


def servo_slope(tree: Tree, like: Array, h: float) -> Float[Array, "d *n"]:
    """Torque per end-of-step rate, ``g + h k_m`` (N m s/rad); never quite zero."""
    slope = expand_dims_like(tree.servo_gain + h * tree.servo_stiffness, like)
    return jnp.maximum(slope, jnp.finfo(like.dtype).tiny)


def has_springs(tree: Tree) -> bool:
    """Whether any motor pulls towards an angle."""
    stiffness = tree.servo_stiffness
    return not isinstance(stiffness, np.ndarray) or bool(stiffness.any())


def overloaded(tree: Tree, torque: Float[Array, "d *n"]) -> Bool[Array, "d *n"]:
    """Axes whose servo asks for more than its limit."""
    return jnp.abs(torque) > expand_dims_like(tree.torque_limit, torque)


def clamp_torque(tree: Tree, torque: Float[Array, "d *n"]) -> Float[Array, "d *n"]:
    """The servo torque cut off at its limit, N m."""
    limit = expand_dims_like(tree.torque_limit, torque)
    return jnp.clip(torque, -limit, limit)
