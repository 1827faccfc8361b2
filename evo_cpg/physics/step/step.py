"""One step of the world: forces, the implicit solve, integration.

The integrator is semi-implicit Euler: the velocities at the end of the step move the positions.
Velocity products and drag are means of their values before and after the step. The motion is
therefore of second order if no forces are stiff, because positions and velocities leapfrog. A step
without motor limits and contact takes two solves with one matrix.
`evo_cpg.physics.step.step_solver` solves the other steps.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import expand_dims_like, matvec, matvec_t
from evo_cpg.creature.tree import Tree
from evo_cpg.native.fuse import fuse
from evo_cpg.physics.step.equations import (
    Residual,
    StepSolution,
    Warmstart,
    prepare,
    solve_at_once,
    with_mean_products,
)
from evo_cpg.physics.step.step_solver import coldstart, solve_step
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.articulated import Accelerations
from evo_cpg.physics.tree.generalized import body_accelerations, generalized_force
from evo_cpg.physics.tree.joint_torque import MotorCommand
from evo_cpg.physics.tree.kinematics import Kinematics
from evo_cpg.physics.tree.muscle import metabolic_power
from evo_cpg.physics.tree.root import ROOT
from evo_cpg.physics.tree.spatial_algebra import Inertia, Wrench
from evo_cpg.physics.tree.state import State, integrate
from evo_cpg.physics.tree.tendon import length_of, torque_of


class Effort(NamedTuple):
    """Motor and contact forces of one step.

    Attributes:
        torque: torque of the motor or the muscles on each axis at the end of the step, and of
            motors that pull by tendons, N m.
        energy: energy of all motors, the sum of |torque x rate| over the step, and metabolic energy
            of all muscles (`evo_cpg.physics.tree.muscle.metabolic_power`), J.
        contact_frame_force: force of the ground on every contact point, in its contact frame (two
            tangents, then the normal), N, or None without ground.
        contact_force: force of the ground on every contact point, in world axes, N.
        pair_force: force between the bodies at every point of `World.pairs`, N, or None if no
            bodies can touch.
        residual: residual of the step's equations, or None if they are solved exactly.
        warmstart: warm start of the next step, or None if no iteration is needed.
        holding: moment (N m) and force (N) that hold the root still, in world axes, or None for a
            free root.
        tension: forces of the motors of tendons (`evo_cpg.creature.creature.Tendon`), or None
            without tendons.
    """

    torque: Float[Array, "d *n"]
    energy: Float[Array, " *n"]
    contact_frame_force: Float[Array, "3 p *n"] | None = None
    contact_force: Float[Array, "3 p *n"] | None = None
    pair_force: Float[Array, "k *n"] | None = None
    residual: Residual | None = None
    warmstart: Warmstart | None = None
    holding: Float[Array, "6 *n"] | None = None
    tension: Float[Array, "t *n"] | None = None


def step(
    world: World,
    state: State,
    command: MotorCommand | Float[Array, "d *n"],
    h: float,
    warmstart: Warmstart | None = None,
    friction_scale: Float[Array, " *n"] | None = None,
) -> tuple[State, Effort]:
    """Advance the world by ``h`` seconds.

    Args:
        world: the creature and its environment.
        state: state at the start of the step.
        command: command to motors and muscles, constant over the step, or only the target rates of
            the motors, rad/s.
        h: step, s.
        warmstart: result of the previous step, which saves iterations, or None for a first step.
            The solution changes only within the solver's tolerance.
        friction_scale: factor of the world's static and dynamic friction, or None for 1.
    """
    run = functools.partial(_step, world, h)
    if not isinstance(command, MotorCommand):
        command = MotorCommand(command)
    given = state, command, warmstart, friction_scale
    return fuse(run, *given, batch_ndim=state.q.ndim - 1, name="a physics step")


def first_warmstart(world: World, batch: tuple[int, ...], dtype: DTypeLike) -> Warmstart | None:
    """Return the warm start of a trial's first step, or None if steps need no iteration."""
    return coldstart(world, batch, dtype) if needs_iteration(world) else None


def needs_iteration(world: World) -> bool:
    """Return whether steps need iteration, because forces other than joint limits have kinks."""
    if world.contact_model is not None or world.pairs is not None:
        return True
    for laws in (world.tree, world.tree.tendons):
        if laws is None:
            continue
        limit, gains = laws.torque_limit, (laws.servo_gain, laws.servo_stiffness)
        if laws.dry_friction is not None or not isinstance(limit, np.ndarray):
            # Traced limits count as limits.
            return True
        # A joint without a motor has the limit 0.
        driven = limit > 0
        if all(isinstance(gain, np.ndarray) for gain in gains):
            driven = (gains[0] > 0) | (gains[1] > 0)
        if np.isfinite(limit[driven]).any():
            return True
    return False


def _step(
    world: World,
    h: float,
    state: State,
    command: MotorCommand,
    warmstart: Warmstart | None,
    friction_scale: Array | None,
) -> tuple[State, Effort]:
    if friction_scale is not None:
        world = world.with_friction(friction_scale)
    tree, holding = world.tree, None
    if needs_iteration(world):
        if world.held:
            raise ValueError("only a step without iteration can hold the root still")
        solution = solve_step(world, h, state, command, warmstart)
    else:
        equations = prepare(world, h, state, command)
        with jax.named_scope("solve"):
            first = solve_at_once(world, h, equations)
            equations = with_mean_products(world, h, equations, *first)
            # Both solves have the same matrix, only their forces differ.
            found = solve_at_once(world, h, equations)
        motor, laws, tension = equations.motor.at(tree, found.qdd, h), equations.tendons, None
        if laws is not None:
            tension = laws.motor.at(laws.tendons, length_of(laws.tendons, found.qdd), h)
        solution = StepSolution(found.root, found.qdd, motor, tension=tension)
        if world.held:
            kin, inertia, bias = equations.kin, equations.inertia, equations.bias
            holding = holding_wrench(tree, kin, inertia, bias, found)
    with jax.named_scope("integrate"):
        new_state = integrate(tree, state, solution.root, solution.qdd, h)
    power = jnp.abs(solution.torque * 0.5 * (state.qd + new_state.qd))
    if tree.muscles is not None:
        driven = expand_dims_like(np.array(tree.muscles.driven), power).astype(bool)
        rate = 0.5 * (state.qd + new_state.qd)
        power = jnp.where(driven, metabolic_power(tree.muscles, command.activation, rate), power)
    energy, torque = h * power.sum(0), solution.torque
    if tree.tendons is not None and solution.tension is not None:
        pull = torque_of(tree.tendons, solution.tension, len(torque))
        rate = length_of(tree.tendons, 0.5 * (state.qd + new_state.qd))
        energy, torque = energy + h * jnp.abs(solution.tension * rate).sum(0), torque + pull
    return new_state, Effort(
        torque,
        energy,
        solution.contact_frame_force,
        solution.contact_force,
        solution.pair_force,
        solution.residual,
        solution.warmstart,
        holding,
        solution.tension,
    )


def holding_wrench(
    tree: Tree, kin: Kinematics, inertia: Inertia, bias: Wrench, found: Accelerations
) -> Float[Array, "6 *n"]:
    """Return the moment (N m) and force (N) that hold a root still, as in a flume, world axes.

    The moment is about the root's centre. A held root has no acceleration, so inverse dynamics give
    the wrench: ``f = sum_i X_i^T (I_i a_i + p_i)``, with the inertias I + h D and the bias wrenches
    p of the step. X moves a wrench to the root's centre. The wrench includes the reaction to the
    implicit drag, so the momentum of the step balances to rounding.
    """
    turning, moving = body_accelerations(tree, kin, jnp.concatenate(found))
    moment = matvec(inertia.angular, turning) + matvec(inertia.mixed, moving)
    force = matvec_t(inertia.mixed, turning) + matvec(inertia.linear, moving)
    total = Wrench(moment + bias.moment, force + bias.force)
    return generalized_force(tree, kin, total)[ROOT]
