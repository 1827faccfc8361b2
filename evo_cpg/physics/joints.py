"""Torques on the joint axes: velocity servo, passive spring and damper, soft limits.

Each law is stated as its torque at the present rates and its derivative: the implicit step then
uses ``tau_end = tau - T qdd`` with the diagonal T below.

- Passive: ``-k (q + h qd) - c qd``, T = h (c + h k).
- Limit: the same spring and damper about the limit, only beyond it.
- Servo (Iwadate 2010: "angular-velocity control"): ``g (target - qd)``, T = h g, up to a limit
  that holds for the torque at the *end* of the step. Deciding it on the torque before the step
  makes the motor chatter and exceed its limit threefold.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from evo_cpg.creature.tree import Tree
from evo_cpg.physics.state import State
from evo_cpg.spatial.linear import lift


def passive_torque(
    tree: Tree, state: State, h: float
) -> tuple[Float[Array, "d *n"], Float[Array, "d *n"]]:
    """Torque (N m) and T (kg m^2) of springs, dampers and soft limits over a step of h (s)."""
    q, qd = state.q, state.qd
    ahead = q + h * qd
    torque = -lift(tree.stiffness, q) * ahead - lift(tree.damping, q) * qd
    derivative = lift(h * (tree.damping + h * tree.stiffness), q)
    over = ahead - jnp.clip(ahead, lift(tree.lower, q), lift(tree.upper, q))
    beyond = over != 0
    torque = torque - jnp.where(
        beyond, lift(tree.limit_stiffness, q) * over + lift(tree.limit_damping, q) * qd, 0.0
    )
    limit = lift(h * (tree.limit_damping + h * tree.limit_stiffness), q)
    return torque, derivative + jnp.where(beyond, limit, 0.0)


def servo_torque(
    tree: Tree, rates: Float[Array, "d *n"], target: Float[Array, "d *n"]
) -> Float[Array, "d *n"]:
    """Torque (N m) that the servos ask for at the given rates (rad/s), without limit."""
    return lift(tree.servo_gain, rates) * (target - rates)


def overloaded(tree: Tree, torque: Float[Array, "d *n"]) -> Bool[Array, "d *n"]:
    """Axes whose servo asks for more than its limit."""
    return jnp.abs(torque) > lift(tree.torque_limit, torque)


def clamp_torque(tree: Tree, torque: Float[Array, "d *n"]) -> Float[Array, "d *n"]:
    """The servo torque cut off at its limit, N m."""
    limit = lift(tree.torque_limit, torque)
    return jnp.clip(torque, -limit, limit)
