"""The equations of one step: inertias, bias forces, torques, and where bodies touch."""

from typing import NamedTuple

import jax
from jaxtyping import Array, Float

from evo_cpg.physics.articulated import Accelerations, solve
from evo_cpg.physics.body_equations import bias_of_mean, body_equations
from evo_cpg.physics.contact import Contacts, find_contacts
from evo_cpg.physics.joint_torque import (
    expected_limit_torque,
    passive_torque,
    servo_slope,
    servo_torque,
)
from evo_cpg.physics.kinematics import Kinematics, kinematics, motion_of_bodies
from evo_cpg.physics.pair_contacts import PairContacts, find_pair_contacts
from evo_cpg.physics.spatial_algebra import Inertia, Wrench, plus
from evo_cpg.physics.state import State
from evo_cpg.physics.world import World
from evo_cpg.spatial.linear import expand_dims_like


class Equations(NamedTuple):
    """What stays the same throughout the search of a step.

    Attributes:
        state: at the start of the step.
        kin, inertia, bias, passive, derivative: as `solve` takes them, without motors, limits of
            joints and ground.
        start_torque: motor torques at the present rates, N m.
        contacts: None without ground.
        pairs: bodies that may touch each other; None where none can.
    """

    state: State
    kin: Kinematics
    inertia: Inertia
    bias: Wrench
    passive: Array
    derivative: Array
    start_torque: Array
    contacts: Contacts | None
    pairs: PairContacts | None


class ContactForces(NamedTuple):
    """Forces of the ground.

    Attributes:
        local: on every contact point, in its contact frame (two tangents, then the normal), N.
        world: the same in world axes.
    """

    local: Float[Array, "3 p *n"]
    world: Float[Array, "3 p *n"]


class Residual(NamedTuple):
    """What forces miss their laws by, as a share of those that there are (`StepProblem`).

    Attributes:
        solved: with the friction cones under which the motion was found.
        coulomb: with those that its own normal forces give, at most.
    """

    solved: Float[Array, "*n"]
    coulomb: Float[Array, "*n"]


class Warmstart(NamedTuple):
    """What a step came to, with which the next begins its search.

    Attributes:
        qdd: joint accelerations, rad/s^2.
        velocity: of the contact points, m/s; None without ground.
        radius: of their friction cones, N.
    """

    qdd: Float[Array, "d *n"]
    velocity: Float[Array, "3 p *n"] | None
    radius: Float[Array, "p *n"]


class StepSolution(NamedTuple):
    """Accelerations of a step, and the forces in it.

    Attributes:
        root: acceleration of the root, as in `Accelerations`.
        qdd: joint accelerations.
        torque: that the motors applied, N m.
        contact: what the ground did; None without ground.
        pairs: with which pairs of bodies push each other, N; None where none can touch.
        residual: see `evo_cpg.physics.step_solver`; None where the equations are linear.
        warmstart: for the next step; None where the equations are linear.
    """

    root: Float[Array, "6 *n"]
    qdd: Float[Array, "d *n"]
    torque: Float[Array, "d *n"]
    contact: ContactForces | None = None
    pairs: Float[Array, "k *n"] | None = None
    residual: Residual | None = None
    warmstart: Warmstart | None = None


def prepare(
    world: World, h: float, state: State, target_rate: Array, target_angle: Array | None
) -> Equations:
    """The equations of motion of a step."""
    tree = world.tree
    with jax.named_scope("kinematics"):
        kin = kinematics(tree, state)
    with jax.named_scope("forces"):
        inertia, bias = body_equations(world, kin, h)
        passive, derivative = passive_torque(tree, state, h)
        derivative = derivative + expand_dims_like(tree.armature, derivative)
        start_torque = servo_torque(tree, state, target_rate, target_angle, h)
        contacts = (
            None if world.contact_model is None else find_contacts(world.contact_model, kin, h)
        )
        pairs = (
            None if world.pairs is None else find_pair_contacts(tree, world.pairs, kin, state.qd, h)
        )
    return Equations(state, kin, inertia, bias, passive, derivative, start_torque, contacts, pairs)


def with_mean_products(
    world: World,
    h: float,
    equations: Equations,
    root: Float[Array, "6 *n"],
    qdd: Float[Array, "d *n"],
) -> Equations:
    """The equations with the mean of the velocity products before and after a step.

    What turning bodies need (Coriolis, centrifugal and gyroscopic forces) is quadratic in the
    velocities. Held at its value at the start of the step it makes the motion one of first order,
    and a swimmer is led astray by 0.1 m in a second. The mean of before and after (the trapezoidal
    rule) is of second order, and keeps momentum even where motors change velocities at once, as
    between commands: with the products at the mean velocity a tree could push itself off from
    nothing. The motion that gives the velocities after the step need not be exact.

    Args:
        world: the creature and its surroundings.
        h: s.
        equations: of the step.
        root: acceleration of the root's velocity.
        qdd: joint accelerations.
    """
    state, kin = equations.state, equations.kin
    velocity, rates = state.velocity + h * root, state.qd + h * qdd
    moving = motion_of_bodies(world.tree, kin, velocity, rates)
    bias = plus(equations.bias, bias_of_mean(world, kin, moving, h))
    return equations._replace(bias=bias)


def solve_at_once(world: World, h: float, equations: Equations) -> Accelerations:
    """The motion of a step without contact whose motors have no limits: no search is needed."""
    tree, start_torque = world.tree, equations.start_torque
    stop, stop_slope = expected_limit_torque(tree, equations.state, h)
    torque = equations.passive + start_torque + stop
    derivative = equations.derivative + h * (servo_slope(tree, start_torque, h) + stop_slope)
    kin, inertia, bias = equations.kin, equations.inertia, equations.bias
    return solve(tree, kin, inertia, bias, torque, derivative)
