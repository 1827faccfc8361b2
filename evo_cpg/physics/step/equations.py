"""Equations of one step: inertias, bias forces, torques and contacts."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import expand_dims_like
from evo_cpg.native.fuse import solve_symmetric
from evo_cpg.physics.contact.contact import Contacts, find_contacts
from evo_cpg.physics.contact.pair_contacts import PairContacts, find_pair_contacts
from evo_cpg.physics.step.body_equations import bias_of_mean, body_equations
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.articulated import Accelerations, solve
from evo_cpg.physics.tree.ball_limit import BallLaws, ball_laws
from evo_cpg.physics.tree.generalized import generalized_force, mass_matrix
from evo_cpg.physics.tree.joint_torque import (
    MotorCommand,
    MotorTorque,
    expected_limit_torque,
    motor_torque,
    passive_torque,
)
from evo_cpg.physics.tree.kinematics import Kinematics, kinematics, motion_of_bodies
from evo_cpg.physics.tree.root import (
    joint_block,
    joint_part,
    plus_joint_diagonal,
    plus_torque,
    root_part,
)
from evo_cpg.physics.tree.spatial_algebra import Inertia, Wrench, plus
from evo_cpg.physics.tree.state import State
from evo_cpg.physics.tree.tendon import TendonLaws, tendon_laws


class Equations(NamedTuple):
    """Equations of one step, which stay constant while the solver searches for the accelerations.

    Attributes:
        state: state at the start of the step.
        kin, inertia, bias, passive, derivative: arguments of `solve`, without motors, joint limits
            and ground.
        motor: torques that motors and muscles command.
        contacts: contacts with the ground, or None without ground.
        pairs: contacts between bodies of the creature, or None if no bodies can touch each other.
        tendons: laws of the tendons, or None without tendons.
        balls: limits of balls, or None without limits.
    """

    state: State
    kin: Kinematics
    inertia: Inertia
    bias: Wrench
    passive: Array
    derivative: Array
    motor: MotorTorque
    contacts: Contacts | None
    pairs: PairContacts | None
    tendons: TendonLaws | None = None
    balls: BallLaws | None = None


class ContactForces(NamedTuple):
    """Forces of the ground.

    Attributes:
        local: force on every contact point, in its contact frame (two tangents, then normal), N.
        world: force on every contact point, in world axes, N.
    """

    local: Float[Array, "3 p *n"]
    world: Float[Array, "3 p *n"]


class Residual(NamedTuple):
    """Errors of the forces in their laws, as fractions of the present forces (`StepProblem`).

    Attributes:
        solved: error with the friction cones of the solve.
        coulomb: largest error with the friction cones of the solution's own normal forces.
    """

    solved: Float[Array, "*n"]
    coulomb: Float[Array, "*n"]


class Warmstart(NamedTuple):
    """Result of a step from which the next step starts its search.

    Attributes:
        qdd: joint accelerations, rad/s^2.
        velocity: velocities of the contact points, m/s, or None without ground.
        radius: radii of the friction cones, N.
    """

    qdd: Float[Array, "d *n"]
    velocity: Float[Array, "3 p *n"] | None
    radius: Float[Array, "p *n"]


class StepSolution(NamedTuple):
    """Accelerations of a step, and the forces in it.

    Attributes:
        root: acceleration of the root, as in `Accelerations`.
        qdd: joint accelerations, rad/s^2.
        torque: torques that the motors of joints applied, N m.
        contact: forces of the ground, or None without ground.
        pairs: forces between pairs of bodies, N, or None if no bodies can touch each other.
        residual: residual of `evo_cpg.physics.step.step_solver`, or None for linear equations.
        warmstart: start of the next step's search, or None for linear equations.
        tension: forces that the motors of tendons applied, or None without tendons.
    """

    root: Float[Array, "6 *n"]
    qdd: Float[Array, "d *n"]
    torque: Float[Array, "d *n"]
    contact: ContactForces | None = None
    pairs: Float[Array, "k *n"] | None = None
    residual: Residual | None = None
    warmstart: Warmstart | None = None
    tension: Float[Array, "t *n"] | None = None


def prepare(world: World, h: float, state: State, command: MotorCommand) -> Equations:
    """Return the equations of motion of a step."""
    tree = world.tree
    with jax.named_scope("kinematics"):
        kin = kinematics(tree, state)
    with jax.named_scope("forces"):
        inertia, bias = body_equations(world, kin, h)
        passive, derivative = passive_torque(tree, state, h)
        derivative = derivative + expand_dims_like(tree.armature, derivative)
        motor = motor_torque(tree, state, command, h)
        contacts = (
            None if world.contact_model is None else find_contacts(world.contact_model, kin, h)
        )
        pairs = (
            None if world.pairs is None else find_pair_contacts(tree, world.pairs, kin, state.qd, h)
        )
        tendons = tendon_laws(tree.tendons, state, command, h)
        balls = ball_laws(tree.ball_limits, state)
    forces = passive, derivative, motor, contacts, pairs, tendons, balls
    return Equations(state, kin, inertia, bias, *forces)


def with_mean_products(
    world: World,
    h: float,
    equations: Equations,
    root: Float[Array, "6 *n"],
    qdd: Float[Array, "d *n"],
) -> Equations:
    """Return the equations with the mean of the velocity products before and after a step.

    Coriolis, centrifugal and gyroscopic forces are quadratic in the velocities. Their initial
    values make a step only of first order, and a swimmer drifts by 0.1 m in a second. The mean of
    before and after (trapezoidal rule) is of second order. The mean conserves momentum even if
    motors change velocities at once, as between commands. Products at the mean velocity would let a
    tree push off from nothing. The motion that predicts the final velocities may be inexact.

    Args:
        world: the creature and its environment.
        h: step, s.
        equations: equations of the step.
        root: acceleration of the root's velocity.
        qdd: joint accelerations, rad/s^2.
    """
    state, kin = equations.state, equations.kin
    velocity, rates = state.velocity + h * root, state.qd + h * qdd
    moving = motion_of_bodies(world.tree, kin, velocity, rates)
    bias = plus(equations.bias, bias_of_mean(world, kin, moving, h))
    return equations._replace(bias=bias)


def solve_at_once(world: World, h: float, equations: Equations) -> Accelerations:
    """Return the motion of a step without contact and motor limits, which needs no search."""
    tree, motor = world.tree, equations.motor
    stop, stop_derivative = expected_limit_torque(tree, equations.state, h)
    torque = equations.passive + motor.start + stop
    derivative = equations.derivative + h * (motor.derivative(tree, h) + stop_derivative)
    kin, inertia, bias = equations.kin, equations.inertia, equations.bias
    if equations.tendons is None and equations.balls is None:
        return solve(tree, kin, inertia, bias, torque, derivative, world.held)
    matrix = plus_joint_diagonal(mass_matrix(tree, kin, inertia), derivative)
    force = generalized_force(tree, kin, Wrench(-bias.moment, -bias.force))
    force = plus_torque(force, torque)
    if equations.tendons is not None:
        matrix, force = equations.tendons.expected(h).added_to(matrix, force)
    if equations.balls is not None:
        matrix, force = equations.balls.expected(h).added_to(matrix, force)
    if world.held:
        qdd = solve_symmetric(joint_block(matrix), joint_part(force))
        return Accelerations(jnp.zeros_like(root_part(force)), qdd)
    y = solve_symmetric(matrix, force)
    return Accelerations(root_part(y), joint_part(y))
