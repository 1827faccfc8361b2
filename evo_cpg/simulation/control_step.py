"""One control step: push the animal, sense, command the motors, and move it by physics steps.

The command is held for ``substeps`` physics steps, and so is the flow of the water.
"""

import dataclasses
import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from evo_cpg.control.controller import Command, Observation
from evo_cpg.creature.algebra.linear import expand_dims_like
from evo_cpg.native.fuse import fuse
from evo_cpg.physics.step.equations import Residual, Warmstart
from evo_cpg.physics.step.step import Effort, first_warmstart, step
from evo_cpg.physics.tree.joint_torque import MotorCommand
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import State
from evo_cpg.simulation.imperfect import SenseMemory, first_memories, imperfect
from evo_cpg.simulation.noise import disturb_motion, disturb_start, friction_scale_of
from evo_cpg.simulation.sensors import (
    bearings,
    body_loads,
    depth_readings,
    light_readings,
    pressure_readings,
)
from evo_cpg.simulation.simulation import Phenotype, Simulation
from evo_cpg.simulation.situation import light_places, starting_state
from evo_cpg.simulation.snapshot import Forces, Snapshot
from evo_cpg.simulation.task import CourseStart, Transition


class AnimalState(NamedTuple):
    """State that a control step takes and returns.

    Attributes:
        state: state of the body.
        nerves: state of the controller.
        pressure: latest readings of the pressure sensors.
        forces: forces of the last control step, or None if neither a sensor nor the controller
            reads them.
        warmstart: warm start of the physics, or None if a step needs none.
        memories: former readings of imperfect senses.
        course: course of a light that moves (`Task.begin_course`).
    """

    state: State
    nerves: Any
    pressure: Float[Array, "s *n"]
    forces: Forces | None = None
    warmstart: Warmstart | None = None
    memories: tuple[SenseMemory, ...] = ()
    course: PyTree = ()


class EpisodeConstants(NamedTuple):
    """Constants of a trial.

    Attributes:
        phenotype: decoded genes.
        keys: random keys of the noise.
        light: place of the light for each individual, or None if it is the same for all.
        common_light: place of the light for all, or None if there is none or each has its own.
        friction_scale: factor on the ground's friction, or None for 1.
    """

    phenotype: Phenotype
    keys: Array | None
    light: Array | None
    common_light: np.ndarray | Array | None
    friction_scale: Array | None = None


class PhysicsStep(NamedTuple):
    """Result of a physics step.

    Attributes:
        before: the body at the start of the step.
        after: the body at the end of the step.
        effort: effort of motors and ground.
    """

    before: State
    after: State
    effort: Effort


class Effects(NamedTuple):
    """Result of a control step (see `Transition`).

    Attributes:
        before: the body at the start of the step.
        after: the body at the end of the step.
        observation: readings of the senses.
        command: command of the controller.
        forces: forces of motors and ground.
        energy: energy spent by all motors, J.
        airborne: fraction of the step in which no body touches the ground.
        residual: largest residual of the physics steps, or None if the physics solves each step
            exactly, without iterations.
        physics: all physics steps of the control step, stacked, or None if no observer needs them.
        light: place of a light that moves, as sensed in the step, or None if the light rests.
        course: course of a light that moves, at the end of the step.
    """

    before: State
    after: State
    observation: Observation
    command: Command
    forces: Forces
    energy: Float[Array, " *n"]
    airborne: Float[Array, " *n"]
    residual: Residual | None = None
    physics: PhysicsStep | None = None
    light: Float[Array, "3 *n"] | None = None
    course: PyTree = ()


def begin_episode(
    simulation: Simulation, genes: Array, keys: Array | None, trial: Array | None
) -> tuple[EpisodeConstants, AnimalState]:
    """Return the constants of the trials, and the animals at the start of the trials."""
    ndim, own = genes.ndim - 1, trial is not None

    def begin(genes: Array, keys: Array | None, trial: Array | None) -> tuple:
        light = light_places(simulation.lights, trial, genes.dtype) if own else None
        animal = initial_animal(simulation, keys, trial, genes.shape[1:], genes.dtype)
        friction_scale = friction_scale_of(simulation.noise, simulation.noise_keys(keys))
        return simulation.genome.decode(genes), light, friction_scale, animal

    name = f"{type(simulation.controller).__name__}.decode"
    phenotype, light, friction_scale, animal = fuse(
        begin, genes, keys, trial, batch_ndim=ndim, name=name
    )
    common = None if own else light_places(simulation.lights, None, genes.dtype)
    noise = simulation.noise_keys(keys)
    return EpisodeConstants(phenotype, noise, light, common, friction_scale), animal


def initial_animal(
    simulation: Simulation,
    keys: Array | None,
    trial: Array | None,
    batch: tuple[int, ...],
    dtype: jnp.dtype,
) -> AnimalState:
    """Return bodies in their initial pose with noise, and controllers in their initial state.

    ``keys`` are those of `rollout`.
    """
    rest = starting_state(simulation.situations, trial, simulation.world.tree, batch, dtype)
    noise = simulation.noise_keys(keys)
    return AnimalState(
        disturb_start(simulation.noise, simulation.world, rest, noise),
        simulation.controller.initial_state(batch, dtype),
        jnp.zeros((len(simulation.sensors.pressure_bodies), *batch), dtype),
        # Keep the forces of the last control step only if a sense needs them.
        no_forces(simulation, rest)
        if simulation.extra_sensors or simulation.controller.uses_load
        else None,
        first_warmstart(simulation.world, batch, dtype),
        first_memories(simulation.imperfections, batch, dtype),
        _first_course(simulation, keys, trial, rest.position),
    )


def _first_course(
    simulation: Simulation, keys: Array | None, trial: Array | None, start: Float[Array, "3 *n"]
) -> PyTree:
    """Return the course of a light that moves, at the start of the trials."""
    if not simulation.task.moves_light:
        return ()
    place = light_places(simulation.lights, trial, start.dtype)
    assert place is not None, "a task that moves its light has a light"
    light = jnp.broadcast_to(expand_dims_like(jnp.asarray(place, start.dtype), start), start.shape)
    return simulation.task.begin_course(CourseStart(start, light, simulation.course_keys(keys)))


def lit(simulation: Simulation, constants: EpisodeConstants, animal: AnimalState):
    """Return the constants of a trial with the present place of a light that moves."""
    if not simulation.task.moves_light:
        return constants
    return constants._replace(light=simulation.task.place_light(animal.course), common_light=None)


def control_step(
    simulation: Simulation,
    constants: EpisodeConstants,
    animal: AnimalState,
    index: Array,
    physics: bool = False,
) -> tuple[AnimalState, Effects]:
    """Push, sense, command, and move for one control step.

    With ``physics``, `Effects.physics` is returned, and physics steps are separate programs.
    """

    def advance(own: EpisodeConstants, animal: AnimalState):
        own = lit(simulation, own._replace(common_light=constants.common_light), animal)
        animal = push(simulation, own, animal, index)
        observation, memories = sense(simulation, own, animal, index)
        nerves, command = act(simulation, own, animal, observation)
        animal = animal._replace(nerves=nerves, memories=memories)
        return move(simulation, own, animal, observation, command, index, physics)

    if physics:
        return advance(constants, animal)
    ndim = animal.state.position.ndim - 1
    given = constants._replace(common_light=None), animal
    return fuse(advance, *given, batch_ndim=ndim, name="a control step")


def at_time(simulation: Simulation, index: Array | int, like: State) -> Simulation:
    """Return the simulation with the water at the start of a control step, of the state's dtype.

    A steady world is returned unchanged, so that its program has no time.
    """
    if not simulation.world.changes:
        return simulation
    time = jnp.asarray(index / simulation.control_rate, like.q.dtype)
    return dataclasses.replace(simulation, world=simulation.world.at(time))


def push(
    simulation: Simulation, constants: EpisodeConstants, animal: AnimalState, index: Array
) -> AnimalState:
    """Return the animal after the random push (noise) of one control step."""
    given, duration = (simulation.noise, simulation.world.tree), 1.0 / simulation.control_rate
    disturb = functools.partial(disturb_motion, *given, index=index, duration=duration)
    ndim = animal.state.position.ndim - 1
    return animal._replace(
        state=fuse(disturb, animal.state, constants.keys, batch_ndim=ndim, name="noise")
    )


def sense(
    simulation: Simulation, constants: EpisodeConstants, animal: AnimalState, index: Array | int
) -> tuple[Observation, tuple[SenseMemory, ...]]:
    """Return the observation of the controller in a control step, and the memory after it."""
    simulation = at_time(simulation, index, animal.state)
    world, state = simulation.world, animal.state

    def read_built_in(state: State, light: Array | None) -> tuple[Array, Array, Array, Array]:
        snapshot = snapshot_of(simulation, constants._replace(light=light), state)
        sensors, kin = simulation.sensors, snapshot.kinematics
        seen = light_readings(sensors, kin, snapshot.light_position)
        return *seen, depth_readings(sensors, world, kin)

    def read(state: State, forces: Forces, light: Array | None) -> Array:
        snapshot = snapshot_of(simulation, constants._replace(light=light), state)
        return jnp.concatenate([one.sense(snapshot, forces) for one in simulation.extra_sensors])

    ndim = state.position.ndim - 1
    strength, cosine, sine, depth = fuse(
        read_built_in, state, constants.light, batch_ndim=ndim, name="eyes and depth"
    )
    custom = None
    if simulation.extra_sensors:
        names = ", ".join(f"{type(one).__name__}.sense" for one in simulation.extra_sensors)
        custom = fuse(read, state, animal.forces, constants.light, batch_ndim=ndim, name=names)
    load = None
    if simulation.controller.uses_load and animal.forces is not None:
        load = fuse(
            lambda force: body_loads(world, force),
            animal.forces.contact_force,
            batch_ndim=ndim,
            name="load sensors",
        )
    bearing = None
    if simulation.controller.uses_bearing:

        def look(state: State, light: Array | None) -> Array:
            return bearings(snapshot_of(simulation, constants._replace(light=light), state))

        bearing = fuse(look, state, constants.light, batch_ndim=ndim, name="bearing")
    seen = strength, animal.pressure, cosine, sine, state.q, state.qd, depth, custom, load, bearing
    if not simulation.imperfections:
        return Observation(*seen), animal.memories
    given = Observation(*seen), animal.memories, constants.keys
    blur = functools.partial(imperfect, simulation.imperfections, index)
    return fuse(blur, *given, batch_ndim=ndim, name="imperfect senses")


def act(
    simulation: Simulation,
    constants: EpisodeConstants,
    animal: AnimalState,
    observation: Observation,
) -> tuple[Any, Command]:
    """Return the controller's next state and its command to the motors."""
    controller, ndim = simulation.controller, animal.state.position.ndim - 1
    name = f"{type(controller).__name__}.act"
    given = constants.phenotype.controller, animal.nerves, observation
    return fuse(controller.act, *given, batch_ndim=ndim, name=name)


def motor_command(command: Command) -> MotorCommand:
    """Return the part of a controller's command that moves motors and muscles."""
    return MotorCommand(
        command.target_rate, command.target_angle, command.activation, command.torque
    )


def move(
    simulation: Simulation,
    constants: EpisodeConstants,
    animal: AnimalState,
    observation: Observation,
    command: Command,
    index: Array | int,
    physics: bool = False,
) -> tuple[AnimalState, Effects]:
    """Take the physics steps of a control step (see `control_step`), and move the light."""
    simulation = at_time(simulation, index, animal.state)
    world, h, state = simulation.world, simulation.step_length, animal.state
    batch = state.position.shape[1:]
    motors, fraction = motor_command(command), 1.0 / simulation.substeps

    def advance(carry, _):
        before, warmstart, energy, airborne, forces, ground_force, residual = carry
        state, effort = step(world, before, motors, h, warmstart, constants.friction_scale)
        if effort.contact_frame_force is not None:
            ground_force = effort.contact_frame_force
        # Nothing touches the ground, or there is none.
        in_air = jnp.ones_like(effort.energy)
        if effort.contact_frame_force is not None:
            in_air = jnp.all(effort.contact_frame_force[2] <= 0, axis=0).astype(in_air.dtype)
        airborne = airborne + in_air / simulation.substeps
        # Means over the control step.
        added = effort.torque, effort.contact_force, effort.pair_force, effort.holding, None
        means: list[Any] = [
            mean if mean is None or force is None else mean + fraction * force
            for mean, force in zip(forces, added, strict=True)
        ]
        forces = Forces(*means)
        energy = energy + effort.energy
        residual = jax.tree.map(jnp.maximum, residual, effort.residual)
        carry = state, effort.warmstart, energy, airborne, forces, ground_force, residual
        return carry, PhysicsStep(before, state, effort) if physics else None

    none, still = jnp.zeros(batch, state.q.dtype), no_forces(simulation, state)
    still = still._replace(acceleration=None)
    exact = None if animal.warmstart is None else Residual(none, none)
    start = state, animal.warmstart, none, none, still, still.contact_force, exact
    (moved, warmstart, energy, airborne, forces, ground_force, residual), each = jax.lax.scan(
        advance, start, None, length=simulation.substeps
    )

    if animal.forces is not None and animal.forces.acceleration is not None:
        felt = functools.partial(with_acceleration, simulation)
        forces = fuse(felt, forces, state, moved, batch_ndim=len(batch), name="acceleration")

    def touch(state: State, ground_force: Array) -> Array:
        return pressure_readings(
            simulation.sensors, world, kinematics(world.tree, state), ground_force
        )

    pressure = animal.pressure
    if world.contact_model is not None and simulation.sensors.pressure_bodies:
        pressure = fuse(touch, moved, ground_force, batch_ndim=len(batch), name="pressure sensors")
    kept = forces if animal.forces else None
    light, course = None, animal.course
    if simulation.task.moves_light:
        light, there = constants.light, snapshot_of(simulation, constants, moved)
        course = simulation.task.advance_course(course, there, jnp.asarray(index))
    after = animal._replace(
        state=moved, pressure=pressure, forces=kept, warmstart=warmstart, course=course
    )
    means = observation, command, forces, energy, airborne
    return after, Effects(state, moved, *means, residual, each, light, course)


def transition(
    simulation: Simulation, constants: EpisodeConstants, effects: Effects, index: Array
) -> Transition:
    """Return a control step as a task sees it."""
    simulation = at_time(simulation, index, effects.before)
    if effects.light is not None:
        constants = constants._replace(light=effects.light, common_light=None)
    before, after = (
        snapshot_of(simulation, constants, state) for state in (effects.before, effects.after)
    )
    return Transition(index, before, after, *effects[2:7], effects.course)


def snapshot_of(simulation: Simulation, constants: EpisodeConstants, state: State) -> Snapshot:
    """Return the animal in a state, as tasks and sensors see it."""
    light = constants.common_light if constants.light is None else constants.light
    if light is not None:
        light = expand_dims_like(light, state.position)
    return Snapshot(simulation.world, 1.0 / simulation.control_rate, state, light)


def no_forces(simulation: Simulation, state: State) -> Forces:
    """Return zero forces: idle motors, no contact with the ground or between limbs."""
    contact_model, pairs = simulation.world.contact_model, simulation.world.pairs
    points = 0 if contact_model is None else len(contact_model.bodies)
    meeting = 0 if pairs is None else len(pairs.owners[0])
    batch, dtype = state.position.shape[1:], state.q.dtype
    contact = jnp.zeros((3, points, *batch), dtype)
    between = jnp.zeros((meeting, *batch), dtype)
    held = jnp.zeros_like(state.velocity) if simulation.world.held else None
    feels = any(sensor.uses_acceleration for sensor in simulation.extra_sensors)
    bodies = len(simulation.world.tree.names)
    acceleration = jnp.zeros((3, bodies, *batch), dtype) if feels else None
    return Forces(jnp.zeros_like(state.q), contact, between, held, acceleration)


def with_acceleration(
    simulation: Simulation, forces: Forces, before: State, after: State
) -> Forces:
    """Return the forces of a control step with the accelerations of the bodies' centres."""
    step = 1.0 / simulation.control_rate
    first, last = (Snapshot(simulation.world, step, x).velocity for x in (before, after))
    return forces._replace(acceleration=(last - first) / step)
