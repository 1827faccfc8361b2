"""Equations of one step: inertias, bias forces, torques and contacts."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import (
    as_matrix_of,
    cross,
    dot,
    expand_dims_like,
    matmul,
    matmul_t,
    matvec,
    skew,
    toward_one,
)
from evo_cpg.creature.algebra.numerics import Numbers, is_traced, xp
from evo_cpg.creature.tree import Tree
from evo_cpg.native.fuse import solve_symmetric
from evo_cpg.physics.contact.contact import Contacts, find_contacts
from evo_cpg.physics.contact.pair_contacts import PairContacts, find_pair_contacts
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.articulated import Accelerations, solve
from evo_cpg.physics.tree.ball_limit import BallLaws, ball_laws
from evo_cpg.physics.tree.generalized import generalized_equations
from evo_cpg.physics.tree.joint_torque import (
    MotorCommand,
    MotorTorque,
    expected_limit_torque,
    motor_torque,
    passive_torque,
)
from evo_cpg.physics.tree.kinematics import Kinematics, kinematics, motion_of_bodies
from evo_cpg.physics.tree.root import JOINTS, ROOT
from evo_cpg.physics.tree.spatial_algebra import Inertia, Wrench, make_inertia
from evo_cpg.physics.tree.state import State
from evo_cpg.physics.tree.tendon import TendonLaws, tendon_laws
from evo_cpg.physics.water.force_law import blocks, in_body_axes, weight


class Equations(NamedTuple):
    """Equations of one step, which stay constant while the solver searches for the accelerations.

    Attributes:
        kin, inertia, bias, passive, derivative: arguments of `solve`, without motors, joint limits
            and ground. The signs differ, because they are parts of two equations:

            | field | what it is | on the creature it acts as |
            |---|---|---|
            | ``bias`` | wrench *needed* for the accelerations A0 | the wrench ``-bias`` |
            | ``passive`` | torque *on* a joint | the torque itself |
            | ``derivative`` | resistance ``-dtau/dqdd``, never negative | ``-derivative qdd`` |
            | ``inertia`` | ``I + h D``, with the resistance of water | ``-inertia a`` |

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
        contact_frame_force: force of the ground on every contact point, in its contact frame (two
            tangents, then normal), N, or None without ground.
        contact_force: force of the ground on every contact point, in world axes, N.
        pair_force: forces between pairs of bodies, N, or None if no bodies can touch each other.
        residual: residual of `evo_cpg.physics.step.step_solver`, or None for linear equations.
        warmstart: start of the next step's search, or None for linear equations.
        tension: forces that the motors of tendons applied, or None without tendons.
    """

    root: Float[Array, "6 *n"]
    qdd: Float[Array, "d *n"]
    torque: Float[Array, "d *n"]
    contact_frame_force: Float[Array, "3 p *n"] | None = None
    contact_force: Float[Array, "3 p *n"] | None = None
    pair_force: Float[Array, "k *n"] | None = None
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
    """
    state, kin = equations.state, equations.kin
    velocity, rates = state.velocity + h * root, state.qd + h * qdd
    moving = motion_of_bodies(world.tree, kin, velocity, rates)
    rotation, tree, start = kin.rotation, world.tree, world.bodies(kin, h)
    velocity, other = start.velocity, in_body_axes(rotation, moving.angular, moving.linear)
    end = start.moving(other)
    accelerations = in_body_axes(
        rotation, moving.bias_angular - kin.bias_angular, moving.bias_linear - kin.bias_linear
    )
    constant = as_matrix_of(tree.inertia, velocity)
    needed = _gyration(world, other) - _gyration(world, velocity)
    needed = needed + matvec(constant, accelerations)
    for law in world.forces:
        for sign, bodies in ((1.0, start), (-1.0, end)):
            wrench = law.averaged(start, bodies)
            if wrench is not None:
                needed = needed + sign * wrench
        inertia = law.inertia(start)
        if inertia is not None:
            needed = needed + matvec(inertia, accelerations)
    moment, force = 0.5 * needed[:3], 0.5 * needed[3:]
    if not world.submerged:
        moment = moment - gyroscopic_change(tree, velocity[:3], h)
    change = Wrench(matvec(rotation, moment), matvec(rotation, force))
    return equations._replace(bias=jax.tree.map(jnp.add, equations.bias, change))


def solve_at_once(world: World, h: float, equations: Equations) -> Accelerations:
    """Return the motion of a step without contact and motor limits, which needs no search."""
    tree, motor = world.tree, equations.motor
    stop, stop_derivative = expected_limit_torque(tree, equations.state, h)
    torque = equations.passive + motor.start + stop
    derivative = equations.derivative + h * (motor.derivative(tree, h) + stop_derivative)
    kin, inertia, bias = equations.kin, equations.inertia, equations.bias
    if equations.tendons is None and equations.balls is None:
        return solve(tree, kin, inertia, bias, torque, derivative, world.held)
    matrix, force = generalized_equations(tree, kin, inertia, bias, torque, derivative)
    if equations.tendons is not None:
        matrix, force = equations.tendons.expected(h).added_to(matrix, force)
    if equations.balls is not None:
        matrix, force = equations.balls.expected(h).added_to(matrix, force)
    if world.held:
        qdd = solve_symmetric(matrix[JOINTS, JOINTS], force[JOINTS])
        return Accelerations(jnp.zeros_like(force[ROOT]), qdd)
    y = solve_symmetric(matrix, force)
    return Accelerations(y[ROOT], y[JOINTS])


# Radius of gyration below which rounding would turn a body that falls, m.
_TURNS_EASILY = 0.01


def body_equations(world: World, kin: Kinematics, h: float) -> tuple[Inertia, Wrench]:
    """Return the inertia ``I + h D`` and the bias wrench of every body, in world axes.

    The bias wrench is the wrench for the velocity-product accelerations, which come from the change
    of pose. It includes the inertia of the body and of the force laws, but not D. Force laws use
    the velocities in the pose at the start of the step.
    """
    tree, bodies = world.tree, world.bodies(kin, h)
    rotation, velocity = kin.rotation, bodies.velocity
    constant = as_matrix_of(tree.inertia, velocity)
    accelerations = in_body_axes(rotation, kin.bias_angular, kin.bias_linear)
    wrench = weight(bodies) - matvec(constant, accelerations)
    matrix = blocks(constant)
    for law in world.forces:
        for part in law.parts(bodies):
            wrench = wrench + part.wrench
            if part.inertia is not None:
                wrench = wrench - matvec(part.inertia, accelerations)
                matrix = matrix + blocks(part.inertia)
            if part.resistance is not None:
                matrix = matrix + part.resistance
    needed = _gyration(world, velocity) - wrench
    moment, force = needed[:3], needed[3:]
    if not world.submerged:
        # Under water drag slows spins, so this correction is not needed.
        moment = moment + gyroscopic_change(tree, velocity[:3], h)
    angular, mixed, linear = (matmul_t(matmul(rotation, block), rotation) for block in matrix)
    bias = Wrench(matvec(rotation, moment), matvec(rotation, force))
    return make_inertia(angular, mixed, linear), bias


def _gyration(world: World, velocity: Float[Array, "6 b *n"]) -> Float[Array, "6 b *n"]:
    """Return ``V x* I V``."""
    inertia = as_matrix_of(world.tree.inertia, velocity)
    momentum, w, v = matvec(inertia, velocity), velocity[:3], velocity[3:]
    across = momentum[3:]
    # Rounding of v x m v would turn a body of a small radius of gyration r, because it accelerates
    # it by about 1e-7 v^2 / r^2 rad/s^2. Larger bodies keep the plain formula and its rounding.
    least = xp.diagonal(central_inertia(world.tree)).min(1)
    small = least < _TURNS_EASILY**2 * world.tree.mass
    # In deep water drag keeps v small, so rounding of v x m v does not matter.
    if not world.submerged and (is_traced(small) or small.any()):
        # The part m v of the momentum adds only rounding to the moment v x m v.
        without = xp.where(small[None, None], 0.0, world.tree.inertia[3:, 3:])
        rows = xp.concatenate([world.tree.inertia[3:, :3], without], 1)
        across = matvec(as_matrix_of(rows, velocity), velocity)
    moment = cross(w, momentum[:3]) + cross(v, across)
    return jnp.concatenate([moment, cross(w, momentum[3:])])


def gyroscopic_change(
    tree: Tree, angular: Float[Array, "3 b *n"], h: float
) -> Float[Array, "3 b *n"]:
    """Return the mean of ``w x I w`` over a step minus its initial value, body axes, N m."""
    own = central_inertia(tree)
    # Cramer's rule multiplies three moments of inertia. The scale keeps the product within float32.
    scale = toward_one(xp.trace(own)) ** 2
    inertia = as_matrix_of(scale[None, None] * own, angular)
    momentum = matvec(inertia, angular)
    torque = cross(angular, momentum)
    derivative = matmul(skew(angular), inertia) - skew(momentum)
    matrix, empty = inertia + 0.5 * h * derivative, tree.mass <= 0
    if is_traced(empty) or empty.any():
        # A welded body has no inertia, and no such torque.
        ones = np.eye(3)[..., None] * xp.where(empty, 1.0, 0.0)[None, None]
        matrix = matrix + as_matrix_of(ones, angular)
    # Solve matrix x change = -h torque by Cramer's rule.
    a, b, c, v = matrix[:, 0], matrix[:, 1], matrix[:, 2], -h * torque
    across = cross(b, c)
    parts = [dot(v, across), dot(a, cross(v, c)), dot(a, cross(b, v))]
    change = jnp.stack(parts) / dot(a, across)[None]
    return expand_dims_like(0.5 / scale, angular[0])[None] * matvec(derivative, change)


def central_inertia(tree: Tree) -> Float[Numbers, "3 3 b"]:
    """Return the inertias about the centres of mass, in the working frames, kg m^2."""
    x, y, z = tree.com
    none = xp.zeros_like(x)
    across = xp.array([[none, -z, y], [z, none, -x], [-y, x, none]])
    square = (across[:, :, None] * across[None]).sum(1)
    return tree.inertia[:3, :3] + tree.mass[None, None] * square
