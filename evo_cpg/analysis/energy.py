"""Energy and momentum balance of a trial, with the part that no force explains.

Over every physics step

    dE = motors + dampers + limits of joints + ground + limbs + water + own + pushes + left over,

where E is the kinetic energy of bodies and rotors, their potential energy in gravity and the energy
of the passive springs of joints and tendons. Velocities are half a step behind the poses, so E uses
the pose half a step before. Work is force times the mean of the velocities before and after the
step.

Forces of motors, ground and limbs are the solver's results. Forces of water and of the user's force
laws are the laws at the mean velocity, which also checks the solver.

The energy left over is an error of the simulator and vanishes with the step. A gait must not depend
on it. Momentum that no force explains is also an error of the simulator.

All computations are in float64, from the states.
"""

import dataclasses
import functools
import operator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.analysis.along_time import along_time
from evo_cpg.creature.algebra.linear import cross, dot, expand_dims_like, matvec
from evo_cpg.creature.tendons import Tendons
from evo_cpg.physics.contact.contact import find_contacts
from evo_cpg.physics.contact.pair_contacts import find_pair_contacts
from evo_cpg.physics.step.step import needs_iteration
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.ball_limit import Angles, ball_laws
from evo_cpg.physics.tree.joint_torque import (
    Coordinates,
    Limits,
    expected_limit_torque,
    friction_torque,
    limit_torque,
)
from evo_cpg.physics.tree.kinematics import Kinematics, kinematics
from evo_cpg.physics.tree.per_body import take
from evo_cpg.physics.tree.state import State
from evo_cpg.physics.tree.tendon import length_of, lengths_of, tendon_energy, torque_of
from evo_cpg.physics.water.force_law import Bodies, body_velocity
from evo_cpg.physics.water.weight import buoyancy_alone
from evo_cpg.simulation.observers import PhysicsSteps
from evo_cpg.simulation.snapshot import Snapshot


class Ledger(NamedTuple):
    """Work and energy in every physics step, J. The module's docstring has the balance.

    Attributes:
        stored: increase of E.
        motors: work of the motors, negative when they brake.
        dampers: work of the dampers and the dry friction of joints and tendons.
        limits: work of the soft limits of joints and tendons.
        lift: work of the ground's normal forces.
        friction: work of the ground's friction.
        limbs: work of limbs that push each other apart.
        water: work of drag, buoyancy and carried water.
        own: work of the user's force laws.
        pushes: energy of random pushes before the step.
        push_out: part of `lift` that lifts sunken points out of the ground, up to the speed of the
            contact law.
        impulse: impulse that no force explains, world axes, N s.
        given: sum of the magnitudes of the impulses of ground, water and own force laws on points
            and bodies, without weight and buoyancy, N s.
    """

    stored: Float[np.ndarray, " t"]
    motors: Float[np.ndarray, " t"]
    dampers: Float[np.ndarray, " t"]
    limits: Float[np.ndarray, " t"]
    lift: Float[np.ndarray, " t"]
    friction: Float[np.ndarray, " t"]
    limbs: Float[np.ndarray, " t"]
    water: Float[np.ndarray, " t"]
    own: Float[np.ndarray, " t"]
    pushes: Float[np.ndarray, " t"]
    push_out: Float[np.ndarray, " t"]
    impulse: Float[np.ndarray, "3 t"]
    given: Float[np.ndarray, " t"]

    @property
    def work(self) -> dict[str, Float[np.ndarray, " t"]]:
        """Work in every physics step by source, J."""
        return {name: getattr(self, name) for name in self._fields[1:10]}

    @property
    def left_over(self) -> Float[np.ndarray, " t"]:
        """Unexplained energy in every step, J, negative if the simulator lost energy."""
        return self.stored - sum(self.work.values())

    @property
    def effort(self) -> float:
        """Sum of the absolute work of the motors, J."""
        return float(np.abs(self.motors).sum())


def ledger(world: World, steps: PhysicsSteps, h: float) -> Ledger:
    """Compute the ledger of a trial.

    Args:
        world: world of the trial.
        steps: physics steps of the trial.
        h: duration of a physics step, s.
    """
    previous = jax.tree.map(_delayed, steps.after, steps.before)

    def entries(steps: PhysicsSteps, previous: State) -> tuple[Array, ...]:
        return _entries(world, steps, previous, h)

    return Ledger(*along_time(entries, steps, previous))


def _entries(world: World, steps: PhysicsSteps, previous: State, h: float) -> tuple[Array, ...]:
    """Return the fields of `Ledger`."""
    tree, before, after = world.tree, steps.before, steps.after
    # Velocities are half a step behind the poses, so move the poses back by half a step.
    earlier, first, last = (
        Snapshot(world, h, state.moved(world.tree, -0.5 * h)) for state in (previous, before, after)
    )
    rate = (before.qd + after.qd) / 2
    velocity = (before.velocity + after.velocity) / 2
    middle = dataclasses.replace(before, velocity=velocity, qd=rate)
    kin = kinematics(tree, middle)
    braking = -expand_dims_like(tree.damping, rate) * after.qd
    if tree.dry_friction is not None:
        braking = braking + friction_torque(tree, after.qd, h)[0]
    if tree.tendons is not None:
        braking = braking + _tendon_braking(tree.tendons, after, h)
    contact = _ground_work(world, steps.contact_force, kinematics(tree, before), kin, h)
    lift, friction, push_out, ground = contact
    at = [world.bodies(each, h) for each in (first.kinematics, kin, last.kinematics)]
    water, own, driven, buoyed = _law_work(world, *at)
    mass = tree.mass.sum()
    explained = h * (ground.sum(1) + driven.sum(1) + buoyed).at[2].add(-mass * world.gravity)
    given = h * jnp.sqrt(dot(ground, ground)).sum(0) + h * jnp.sqrt(dot(driven, driven)).sum(0)
    return (
        mechanical_energy(last) - mechanical_energy(first),
        h * (steps.torque * rate).sum(0),
        h * (braking * rate).sum(0),
        h * (_limit_torques(world, before, after, h) * rate).sum(0),
        lift,
        friction,
        _limb_work(world, steps, kin, rate, h),
        water,
        own,
        mechanical_energy(first) - mechanical_energy(earlier),
        push_out,
        mass * (last.centre_of_mass_velocity - first.centre_of_mass_velocity) - explained,
        given,
    )


def mechanical_energy(snapshot: Snapshot) -> Float[Array, " *n"]:
    """Return E, J: kinetic (bodies and rotors), gravitational, of passive springs and tendons."""
    tree, state, kin = snapshot.world.tree, snapshot.state, snapshot.kinematics
    velocity = body_velocity(kin)
    momentum = matvec(expand_dims_like(tree.inertia, velocity, velocity.ndim + 1), velocity)
    armature, stiffness = (expand_dims_like(x, state.q) for x in (tree.armature, tree.stiffness))
    stretch = state.q if tree.rest is None else state.q - expand_dims_like(tree.rest, state.q)
    energy = (
        0.5 * (velocity * momentum).sum((0, 1))
        + tree.mass.sum() * snapshot.world.gravity * snapshot.centre_of_mass[2]
        + 0.5 * (armature * state.qd**2 + stiffness * stretch**2).sum(0)
    )
    return energy if tree.tendons is None else energy + tendon_energy(tree.tendons, state)


def _tendon_braking(tendons: Tendons, after: State, h: float) -> Float[Array, "d t"]:
    """Return the torques of the tendons' dampers and dry friction, N m."""
    rate = length_of(tendons, after.qd)
    force = -expand_dims_like(tendons.damping, rate) * rate
    if tendons.dry_friction is not None:
        force = force + friction_torque(tendons, rate, h)[0]
    return torque_of(tendons, force, len(after.q))


def _limit_torques(world: World, before: State, after: State, h: float) -> Float[Array, "d t"]:
    """Return the torques of the limits of joints and tendons as in the solver, N m."""
    tendons = world.tree.tendons
    own = _limits(world, world.tree, before, after, h)
    balls = ball_laws(world.tree.ball_limits, before)
    if balls is not None:
        last = Angles(balls.angles.q, balls.rate(after.qd))
        stops = _limits(world, balls.limits, balls.angles, last, h)
        own = own + balls.torque_of(stops, len(own))
    if tendons is None:
        return own
    first, last = lengths_of(tendons, before), lengths_of(tendons, after)
    return own + torque_of(tendons, _limits(world, tendons, first, last, h), len(own))


def _limits(
    world: World, laws: Limits, before: Coordinates, after: Coordinates, h: float
) -> Float[Array, "d t"]:
    if needs_iteration(world):
        return limit_torque(laws, before.q, after.qd, h)[0]
    torque, derivative = expected_limit_torque(laws, before, h)
    return torque - derivative * (after.qd - before.qd)


def _ground_work(
    world: World, force: Float[Array, "3 p t"], first: Kinematics, middle: Kinematics, h: float
) -> tuple[Array, Array, Array, Array]:
    """Return work of normal forces, friction and push-out, J, and force on every point, N."""
    if world.contact_model is None:
        none = jnp.zeros_like(first.origin[0, 0])
        return none, none, none, force
    contacts = find_contacts(world.contact_model, first, h)
    bodies = np.array(world.contact_model.bodies)
    velocity = take(middle.linear, bodies) + cross(take(middle.angular, bodies), contacts.offset)
    local, moving = matvec(contacts.frame, force), matvec(contacts.frame, velocity)
    lift, friction = local[2] * moving[2], dot(local[:2], moving[:2])
    # A resting point does not move, although its `rest_velocity` may be positive.
    risen = jnp.clip(moving[2], 0.0, jnp.maximum(contacts.rest_velocity, 0.0))
    push_out = h * (local[2] * risen).sum(0)
    return h * lift.sum(0), h * friction.sum(0), push_out, force


def _limb_work(
    world: World, steps: PhysicsSteps, kin: Kinematics, rate: Array, h: float
) -> Float[Array, " t"]:
    if world.pairs is None:
        return jnp.zeros_like(kin.origin[0, 0])
    contacts = find_pair_contacts(world.tree, world.pairs, kin, rate, h)
    return h * (steps.pair_force * contacts.parting(rate)).sum(0)


def _law_work(
    world: World, first: Bodies, middle: Bodies, last: Bodies
) -> tuple[Float[Array, " t"], Float[Array, " t"], Float[Array, "3 b t"], Float[Array, "3 t"]]:
    """Return the work of the water and of own laws, J, and forces, N: of all laws, and buoyancy."""
    velocity = middle.velocity
    none = jnp.zeros_like(velocity)
    flow, own = (
        functools.reduce(
            operator.add,
            [law.over_step(first, middle, last) for law in world.forces if law.of_water == of_water]
            or [none],
        )
        for of_water in (True, False)
    )
    lift = none if world.water is None else buoyancy_alone(middle)
    water, others = (middle.h * (wrench * velocity).sum((0, 1)) for wrench in (flow + lift, own))
    driven, buoyed = (matvec(middle.kin.rotation, x[3:]) for x in (flow + own, lift))
    return water, others, driven, buoyed.sum(1)


def _delayed(after: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Return the final state of the step before. The first step gets its own initial state."""
    return np.concatenate([before[..., :1], after[..., :-1]], -1)
