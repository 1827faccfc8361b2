"""One step of the world: a flat list of named stages.

Kinematics, forces on bodies, torques on joints, the implicit solve, the motors' limits,
integration. Semi-implicit Euler: the velocities at the end of the step move the positions.
"""

import functools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.tree import Tree
from evo_cpg.fusion.kernels import fuse, symmetric
from evo_cpg.physics.articulated import Accelerations, Inertia, Wrench, solve
from evo_cpg.physics.contact import Ground
from evo_cpg.physics.fluid import Patch, Water, drag
from evo_cpg.physics.joints import (
    clamp_torque,
    overloaded,
    passive_torque,
    servo_slope,
    servo_torque,
)
from evo_cpg.physics.kinematics import Kinematics, kinematics
from evo_cpg.physics.state import State
from evo_cpg.spatial.linear import (
    cross,
    lift,
    matmul,
    matmul_t,
    matvec,
    matvec_t,
)
from evo_cpg.spatial.rotation import integrate_quaternion

# Passes that look for the torques of overloaded motors, and the relative accuracy at which they
# stop. Of 200 random swimmers with limits of 20 N m and of 5 N m none diverged with 4 passes.
_LIMIT_PASSES = 4
_TORQUE_TOLERANCE = 1e-3

# Slope given to a saturated servo, as a share of its secant. With the tangent (0) the passes cycle
# between the two limits where inertias are small: 108 and 193 of those swimmers blew up. The
# secant (1) never overshoots but takes twice the passes; from 1/2 on convergence is assured,
# because the piecewise quadratic energy of the servos then lies below its model.
_SECANT_SHARE = 0.5


class World(eqx.Module):
    """A creature and its surroundings, ready to be stepped.

    Attributes:
        tree: the creature.
        gravity: m/s^2, pulling along -z.
        water: None on dry land.
        patches: the surface points that meet the water.
        ground: None where there is nothing to stand on.
    """

    tree: Tree
    gravity: float
    water: Water | None = None
    patches: tuple[Patch, ...] = ()
    ground: Ground | None = None


class Effort(NamedTuple):
    """What the motors did in one step.

    Attributes:
        torque: applied on each axis at the end of the step, N m.
        energy: spent by each motor, the sum of |torque x rate| over the step, J.
    """

    torque: Float[Array, "d *n"]
    energy: Float[Array, "d *n"]


class _MotorLimits(NamedTuple):
    """An iterate: accelerations, the torques the servos then ask for, whether it is done."""

    accelerations: Accelerations
    asked: Array
    settled: Array


class _Unlimited(NamedTuple):
    """A step up to its accelerations, with motors that have no limit.

    Attributes:
        kin, inertia, bias, passive, derivative: as `solve` takes them, without the motors' part.
        wanted: motor torques at the present rates, N m.
        accelerations: what comes of them.
        asked: motor torques at the end of the step, N m.
    """

    kin: Kinematics
    inertia: Inertia
    bias: Wrench
    passive: Array
    derivative: Array
    wanted: Array
    accelerations: Accelerations
    asked: Array


def step(
    world: World,
    state: State,
    target_rate: Float[Array, "d *n"],
    h: float,
    target_angle: Float[Array, "d *n"] | None = None,
) -> tuple[State, Effort]:
    """Advance the world by ``h`` seconds.

    Args:
        world: the creature and its surroundings.
        state: at the start.
        target_rate: for the motors to follow, rad/s, held over the step.
        h: s.
        target_angle: for the motors' springs to pull to, rad; None for the neutral pose.
    """
    targets = target_rate, target_angle
    batch_ndim = state.q.ndim - 1
    if not _can_overload(world.tree):
        free_step = functools.partial(_free_step, world, h)
        return fuse(free_step, state, *targets, batch_ndim=batch_ndim)
    unlimited = fuse(
        functools.partial(_unlimited, world, h), state, *targets, batch_ndim=batch_ndim
    )
    acceleration, torque = _limit_torques(world.tree, state, unlimited, h)
    return fuse(functools.partial(_finish, h), state, acceleration, torque, batch_ndim=batch_ndim)


def _free_step(
    world: World, h: float, state: State, target_rate: Array, target_angle: Array | None
) -> tuple[State, Effort]:
    """A step of an animal whose motors have no limit."""
    solution = _unlimited(world, h, state, target_rate, target_angle)
    return _finish(h, state, solution.accelerations, solution.asked)


def _unlimited(
    world: World, h: float, state: State, target_rate: Array, target_angle: Array | None
) -> _Unlimited:
    """Everything up to the accelerations that the motors would cause if they had no limit."""
    tree = world.tree
    with jax.named_scope("kinematics"):
        kin = kinematics(tree, state)
    with jax.named_scope("forces"):
        inertia, bias = body_equations(world, kin, h)
    with jax.named_scope("solve"):
        passive, derivative = passive_torque(tree, state, h)
        derivative = derivative + lift(tree.armature, derivative)
        wanted = servo_torque(tree, state, target_rate, target_angle, h)
        slope = h * servo_slope(tree, wanted, h)
        free = solve(tree, kin, inertia, bias, passive + wanted, derivative + slope)
    asked = wanted - slope * free.qdd
    return _Unlimited(kin, inertia, bias, passive, derivative, wanted, free, asked)


def _finish(
    h: float, state: State, acceleration: Accelerations, torque: Array
) -> tuple[State, Effort]:
    """Move, and note what the motors did."""
    with jax.named_scope("integrate"):
        new_state = integrate(state, acceleration, h)
    energy = h * jnp.abs(torque * 0.5 * (state.qd + new_state.qd))
    return new_state, Effort(torque, energy)


def _can_overload(tree: Tree) -> bool:
    """Whether any motor has a limit."""
    driven = (tree.servo_gain > 0) | (tree.servo_stiffness > 0)
    return bool(np.isfinite(tree.torque_limit[driven]).any())


def body_equations(world: World, kin: Kinematics, h: float) -> tuple[Inertia, Wrench]:
    """Inertia ``I + h D`` and bias wrench of every body, in world axes.

    Where further forces on bodies (contact) join: their wrench and derivative are added to the
    drag's before both are turned to world axes.
    """
    tree = world.tree
    rotation = kin.rotation
    velocity = jnp.concatenate([matvec_t(rotation, kin.angular), matvec_t(rotation, kin.linear)])
    wrench = weight(world, kin)
    constant = lift(tree.inertia, velocity, velocity.ndim + 1)
    momentum = matvec(constant, velocity)
    blocks = jnp.stack([constant[:3, :3], constant[:3, 3:], constant[3:, 3:]])
    if world.water is not None:
        current = jnp.asarray(world.water.current, velocity.dtype)
        stream = matvec_t(rotation, lift(current, kin.linear))
        relative = jnp.concatenate([velocity[:3], velocity[3:] - stream])
        resistance, derivative = drag(world.water, world.patches, relative)
        wrench = wrench + resistance
        blocks = blocks + h * derivative
    w, v = velocity[:3], velocity[3:]
    moment = cross(w, momentum[:3]) + cross(v, momentum[3:]) - wrench[:3]
    force = cross(w, momentum[3:]) - wrench[3:]

    angular, mixed, linear = (matmul_t(matmul(rotation, block), rotation) for block in blocks)
    inertia = Inertia(symmetric(angular), mixed, symmetric(linear))
    bias = Wrench(
        matvec(rotation, moment)
        + matvec(inertia.angular, kin.bias_angular)
        + matvec(inertia.mixed, kin.bias_linear),
        matvec(rotation, force)
        + matvec_t(inertia.mixed, kin.bias_angular)
        + matvec(inertia.linear, kin.bias_linear),
    )
    return inertia, bias


def weight(world: World, kin: Kinematics) -> Float[Array, "6 b *n"]:
    """Weight less buoyancy, both at the centre of mass, in body axes (Iwadate 2010, eq. 7)."""
    tree = world.tree
    displaced = world.water.density * tree.volume if world.water is not None else 0.0
    up = kin.rotation[2]
    force = lift((displaced - tree.mass) * world.gravity, up[0])[None] * up
    return jnp.concatenate([cross(lift(tree.com, up), force), force])


def _limit_torques(
    tree: Tree, state: State, unlimited: _Unlimited, h: float
) -> tuple[Accelerations, Float[Array, "d *n"]]:
    """Solve for the accelerations with motors that never exceed their limits.

    The end-of-step torques are the motors' laws at the end of the step, clipped: a piecewise
    linear equation. Where a
    motor is overloaded, its clipped law is replaced by a line through the present iterate with a
    share of the secant's slope, and the motion is solved again, a few times. Last, all motor
    torques are imposed as found and clipped: what is returned is what was applied, and it is
    within the limits. Individuals without an overloaded motor keep their first solution, and a
    step without any costs one solve.

    Returns:
        The accelerations and the motor torques (N m) at the end of the step.
    """
    wanted = unlimited.wanted
    gain = servo_slope(tree, wanted, h)

    def solve_with(torque: Array, torque_derivative: Array) -> Accelerations:
        return fuse(
            functools.partial(solve, tree),
            unlimited.kin,
            unlimited.inertia,
            unlimited.bias,
            unlimited.passive + torque,
            unlimited.derivative + torque_derivative,
            batch_ndim=wanted.ndim - 1,
        )

    def refine(carry: _MotorLimits) -> _MotorLimits:
        over = overloaded(tree, carry.asked)
        limit = clamp_torque(tree, carry.asked)
        # Slope of the servo's saturated branch: between the tangent, 0, and the secant.
        slope = jnp.where(over, _SECANT_SHARE * gain * limit / carry.asked, gain)
        error = carry.asked / gain
        start = jnp.where(over, limit + slope * (wanted / gain - error), wanted)
        found = solve_with(start, h * slope)
        asked = wanted - h * gain * found.qdd
        change = jnp.abs(clamp_torque(tree, asked) - (start - h * slope * found.qdd))
        settled = (change <= _TORQUE_TOLERANCE * lift(tree.torque_limit, change)).all(0)
        new = _MotorLimits(found, asked, settled)
        return jax.tree.map(lambda x, y: jnp.where(carry.settled, x, y), carry, new)

    def limited(start: _MotorLimits) -> tuple[Accelerations, Array]:
        end, _ = jax.lax.scan(
            lambda carry, _: (
                jax.lax.cond(carry.settled.all(), lambda c: c, refine, carry),
                None,
            ),
            start,
            length=_LIMIT_PASSES,
        )
        applied = clamp_torque(tree, end.asked)
        given = solve_with(applied, jnp.zeros_like(applied))
        within = ~overloaded(tree, start.asked).any(0)
        return jax.tree.map(
            lambda x, y: jnp.where(within, x, y), start.accelerations, given
        ), applied

    over = overloaded(tree, unlimited.asked).any(0)
    return jax.lax.cond(
        over.any(),
        limited,
        lambda start: (start.accelerations, start.asked),
        _MotorLimits(unlimited.accelerations, unlimited.asked, ~over),
    )


def integrate(state: State, acceleration: Accelerations, h: float) -> State:
    """Semi-implicit Euler: new velocities first, and they move the positions."""
    angular, linear = state.velocity[:3], state.velocity[3:]
    # The recursion's root acceleration is spatial; a material point's has w x v on top.
    change = acceleration.root[3:] + cross(angular, linear)
    new_angular = angular + h * acceleration.root[:3]
    new_linear = linear + h * change
    qd = state.qd + h * acceleration.qdd
    return State(
        position=state.position + h * new_linear,
        orientation=integrate_quaternion(state.orientation, new_angular, h),
        velocity=jnp.concatenate([new_angular, new_linear]),
        q=state.q + h * qd,
        qd=qd,
    )
