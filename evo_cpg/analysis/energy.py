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

`water_power` measures what a swimmer puts into the water. The net force on a free swimmer is zero
on average, so a force law that pushes has to be told from laws that resist. **Thrust** is the force
of reactive thrust alone, of the water that leaves the tail. **Power** is the energy that all laws
of the water take from the body per time. Without reactive thrust, drag both pushes and resists, and
thrust cannot be told apart. Such an animal needs a tow.
"""

import dataclasses
import functools
import operator
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import as_matrix_of, cross, dot, expand_dims_like, matvec
from evo_cpg.creature.per_body import take
from evo_cpg.physics.contact.contact import find_contacts
from evo_cpg.physics.contact.pair_contacts import find_pair_contacts
from evo_cpg.physics.step.step import needs_iteration
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.ball_limit import ball_laws
from evo_cpg.physics.tree.joint_torque import (
    Coordinates,
    Limits,
    expected_limit_torque,
    friction_torque,
    limit_torque,
)
from evo_cpg.physics.tree.joints import Subspace
from evo_cpg.physics.tree.kinematics import Kinematics, kinematics
from evo_cpg.physics.tree.state import State
from evo_cpg.physics.tree.tendon import length_of, lengths_of, stretch_of, torque_of
from evo_cpg.physics.water.force_law import Bodies, buoyancy_alone, in_body_axes
from evo_cpg.physics.water.reactive_thrust import ReactiveThrust
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
    """Compute the ledger of a trial with physics steps of h (s)."""
    # The final state of the step before. The first step gets its own initial state.
    previous = jax.tree.map(
        lambda after, before: np.concatenate([before[..., :1], after[..., :-1]], -1),
        steps.after,
        steps.before,
    )
    entries = functools.partial(_entries, world, h)
    # Each step has its own water if the water changes.
    entries = jax.vmap(entries, -1, -1) if world.changes else entries
    return Ledger(*along_time(entries, steps, previous))


def _entries(world: World, h: float, steps: PhysicsSteps, previous: State) -> tuple[Array, ...]:
    """Return the fields of `Ledger`."""
    if steps.time is not None:
        world = world.at(steps.time)
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
        pulling = length_of(tree.tendons, after.qd)
        force = -expand_dims_like(tree.tendons.damping, pulling) * pulling
        if tree.tendons.dry_friction is not None:
            force = force + friction_torque(tree.tendons, pulling, h)[0]
        braking = braking + torque_of(tree.tendons, force, len(after.q))
    limbs = jnp.zeros_like(kin.origin[0, 0])
    if world.pairs is not None:
        pairs = find_pair_contacts(tree, world.pairs, kin, rate, h)
        limbs = h * (steps.pair_force * pairs.parting(rate)).sum(0)
    ground = steps.contact_force
    lift = friction = push_out = jnp.zeros_like(kin.origin[0, 0])
    if world.contact_model is not None:
        contacts = find_contacts(world.contact_model, kinematics(tree, before), h)
        bodies = np.array(world.contact_model.bodies)
        moving = take(kin.linear, bodies) + cross(take(kin.angular, bodies), contacts.offset)
        local, moving = matvec(contacts.frame, ground), matvec(contacts.frame, moving)
        # A resting point does not move, although its `rest_velocity` may be positive.
        risen = jnp.clip(moving[2], 0.0, jnp.maximum(contacts.rest_velocity, 0.0))
        push_out = h * (local[2] * risen).sum(0)
        lift = h * (local[2] * moving[2]).sum(0)
        friction = h * dot(local[:2], moving[:2]).sum(0)
    at = [world.bodies(each, h) for each in (first.kinematics, kin, last.kinematics)]
    water, own, driven, buoyed = _law_work(world, *at)
    mass = tree.mass.sum()
    explained = h * (ground.sum(1) + driven.sum(1) + buoyed).at[2].add(-mass * world.gravity)
    given = h * jnp.sqrt(dot(ground, ground)).sum(0) + h * jnp.sqrt(dot(driven, driven)).sum(0)
    # Torques of the limits of joints and tendons as in the solver, N m.
    stops = _limits(world, tree, before, after, h)
    balls = ball_laws(tree.ball_limits, before)
    if balls is not None:
        turned = Coordinates(balls.angles.q, balls.rate(after.qd))
        own_stops = _limits(world, balls.limits, balls.angles, turned, h)
        stops = stops + balls.torque_of(own_stops, len(stops))
    if tree.tendons is not None:
        lengths = lengths_of(tree.tendons, before), lengths_of(tree.tendons, after)
        pull = _limits(world, tree.tendons, *lengths, h)
        stops = stops + torque_of(tree.tendons, pull, len(stops))
    return (
        mechanical_energy(last) - mechanical_energy(first),
        h * (steps.torque * rate).sum(0),
        h * (braking * rate).sum(0),
        h * (stops * rate).sum(0),
        lift,
        friction,
        limbs,
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
    velocity = in_body_axes(kin.rotation, kin.angular, kin.linear)
    momentum = matvec(as_matrix_of(tree.inertia, velocity), velocity)
    armature, stiffness = (expand_dims_like(x, state.q) for x in (tree.armature, tree.stiffness))
    stretch = state.q if tree.rest is None else state.q - expand_dims_like(tree.rest, state.q)
    energy = (
        0.5 * (velocity * momentum).sum((0, 1))
        + tree.mass.sum() * snapshot.world.gravity * snapshot.centre_of_mass[2]
        + 0.5 * (armature * state.qd**2 + stiffness * stretch**2).sum(0)
    )
    tendons = tree.tendons
    if tendons is None:
        return energy
    length, rate = lengths_of(tendons, state)
    stiffness, armature = (
        expand_dims_like(x, length) for x in (tendons.stiffness, tendons.armature)
    )
    stretch, _ = stretch_of(tendons, length)
    return energy + 0.5 * (armature * rate**2 + stiffness * stretch**2).sum(0)


def _limits(
    world: World, laws: Limits, before: State | Coordinates, after: State | Coordinates, h: float
) -> Float[Array, "d t"]:
    if needs_iteration(world):
        return limit_torque(laws, before.q, after.qd, h)[0]
    torque, derivative = expected_limit_torque(laws, before, h)
    return torque - derivative * (after.qd - before.qd)


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


# Number of steps in a block. Arrays of surface points at all steps would need too much memory.
_BLOCK = 1024


def along_time(function: Callable, *steps: Any) -> Any:
    """Return ``function(*steps)``, block by block: one program serves trials of any length.

    Args:
        function: function of each step alone. Time is the last axis of arguments and results.
        steps: pytrees of arrays.
    """
    with jax.enable_x64(True):
        exact = jax.tree.map(lambda x: np.asarray(x, np.float64), steps)
        count = jax.tree.leaves(exact)[0].shape[-1]
        program = jax.jit(function)
        parts = []
        for start in range(0, count, _BLOCK):
            # The last block repeats the last step.
            block = np.minimum(np.arange(start, start + _BLOCK), count - 1)
            own = jax.tree.map(operator.itemgetter((..., block)), exact)
            parts.append(jax.device_get(program(*own)))
    return jax.tree.map(lambda *x: np.concatenate(x, -1)[..., :count], *parts)


class WaterPower(NamedTuple):
    """Force and power at every control step.

    Attributes:
        thrust: force of reactive thrust on the whole body, world axes, N.
        power: energy that the water takes from the body per time, W.
    """

    thrust: Float[np.ndarray, "t 3"]
    power: Float[np.ndarray, " t"]


def water_power(
    world: World,
    frames: Mapping[str, Array | np.ndarray],
    h: float,
    time: Float[np.ndarray, " t"] | None = None,
) -> WaterPower | None:
    """Return thrust and power of a recorded trial, or None without reactive thrust.

    Args:
        world: world of the trial.
        frames: ``full`` frames of one individual (`evo_cpg.simulation.recording.Recorder`).
        h: duration of a physics step, s.
        time: time of each frame, s, or None if the water does not change.
    """
    if world.law(ReactiveThrust) is None or "angular_velocity" not in frames:
        return None
    laws = [law for law in world.forces if law.of_water]

    def of_step(
        position: Array, rotation: Array, velocity: Array, turning: Array, time: Array | None
    ) -> tuple:
        lever = matvec(rotation, expand_dims_like(world.tree.centre, position))
        still = jnp.zeros_like(position)
        kin = Kinematics(
            rotation=rotation,
            origin=position - lever,
            offset=still,
            axes=Subspace(still[:, :0]),
            angular=turning,
            linear=velocity - cross(turning, lever),
            bias_angular=still,
            bias_linear=still,
        )
        bodies = world.at(time).bodies(kin, h)
        thrust, power = jnp.zeros_like(position[:, 0]), jnp.zeros_like(position[0, 0])
        for law in laws:
            wrench = law.wrench(bodies)
            power = power - (wrench * bodies.relative).sum((0, 1))
            if isinstance(law, ReactiveThrust):
                thrust = thrust + matvec(rotation, wrench[3:]).sum(1)
        return thrust, power

    names = ("position", "rotation", "velocity", "angular_velocity")
    steps = [np.moveaxis(np.asarray(frames[name])[..., 0], 0, -1) for name in names]
    of_steps = jax.vmap(of_step, -1, -1) if world.changes else of_step
    thrust, power = along_time(of_steps, *steps, time)
    return WaterPower(thrust.T, power)
