"""One control step: the animal senses, its controller commands, the physics moves it.

The command is held for ``substeps`` physics steps.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.control.controller import Command, Observation
from evo_cpg.fusion.fuse import fuse
from evo_cpg.physics.equations import Residual, Warmstart
from evo_cpg.physics.kinematics import kinematics
from evo_cpg.physics.state import State
from evo_cpg.physics.step import Effort, first_warmstart, step
from evo_cpg.simulation.genome import Phenotype
from evo_cpg.simulation.noise import disturb_motion, disturb_start, grip_of
from evo_cpg.simulation.sensors import fathom, feel, see
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.simulation.situation import light_places, starting_state
from evo_cpg.simulation.snapshot import Forces, Snapshot
from evo_cpg.simulation.task import Transition
from evo_cpg.spatial.linear import expand_dims_like


class Animal(NamedTuple):
    """What goes on from one control step to the next.

    Attributes:
        state: of the body.
        nerves: of the controller.
        pressure: what the skin felt last.
        forces: of the last control step; None unless a sensor may ask for them.
        warmstart: of the physics; None where a step needs none.
    """

    state: State
    nerves: Any
    pressure: Float[Array, "s *n"]
    forces: Forces | None = None
    warmstart: Warmstart | None = None


class Life(NamedTuple):
    """What stays the same throughout a trial.

    Attributes:
        phenotype: what the genes became.
        keys: of the trial's noise.
        light: where it is for each individual; None where it is the same for all.
        common_light: where it is for all; None where each has its own, or there is none.
        grip: by which the ground's friction is multiplied; None for 1.
    """

    phenotype: Phenotype
    keys: Array | None
    light: Array | None
    common_light: np.ndarray | Array | None
    grip: Array | None = None


class PhysicsStep(NamedTuple):
    """What happened in a physics step.

    Attributes:
        before: the body at its beginning.
        after: the body at its end.
        effort: of motors and ground.
    """

    before: State
    after: State
    effort: Effort


class Effects(NamedTuple):
    """What happened in a control step; see `Transition`.

    Attributes:
        before: the body at its beginning.
        after: the body at its end.
        observation: of the controller.
        command: of the controller.
        forces: of motors and ground.
        energy: spent by all motors, J.
        airborne: share of the time off the ground.
        residual: of the physics, the largest of its steps; None where one solve is exact.
        physics: every physics step, stacked; None unless an observer needs them.
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


def begin_life(
    simulation: Simulation, genes: Array, keys: Array | None, trial: Array | None
) -> tuple[Life, Animal]:
    """The trials as they begin."""
    ndim, own = genes.ndim - 1, trial is not None

    def begin(genes: Array, keys: Array | None, trial: Array | None) -> tuple:
        light = light_places(simulation.lights, trial, genes.dtype) if own else None
        animal = starting_animal(simulation, keys, trial, genes.shape[1:], genes.dtype)
        grip = grip_of(simulation.noise, keys)
        return simulation.genome.decode(genes), light, grip, animal

    name = f"{type(simulation.controller).__name__}.decode"
    phenotype, light, grip, animal = fuse(begin, genes, keys, trial, batch_ndim=ndim, name=name)
    common = None if own else light_places(simulation.lights, None, genes.dtype)
    return Life(phenotype, keys, light, common, grip), animal


def starting_animal(
    simulation: Simulation,
    keys: Array | None,
    trial: Array | None,
    batch: tuple[int, ...],
    dtype: jnp.dtype,
) -> Animal:
    """Bodies at their start, nerves at rest."""
    rest = starting_state(simulation.situations, trial, simulation.world.tree, batch, dtype)
    return Animal(
        disturb_start(simulation.noise, simulation.world, rest, keys),
        simulation.controller.initial_state(batch, dtype),
        jnp.zeros((len(simulation.sensors.pressure_bodies), *batch), dtype),
        no_forces(simulation, rest) if simulation.extra_sensors else None,
        first_warmstart(simulation.world, batch, dtype),
    )


def control_step(
    simulation: Simulation, life: Life, animal: Animal, index: Array, physics: bool = False
) -> tuple[Animal, Effects]:
    """Push, sense, command, and move for one control step.

    Args:
        simulation: the trial.
        life: what stays the same throughout it.
        animal: at the beginning of the step.
        index: number of the step, from 0.
        physics: with `Effects.physics`; the physics steps are then programs of their own.
    """

    def whole(own: Life, animal: Animal):
        own = own._replace(common_light=life.common_light)
        animal = push(simulation, own, animal, index)
        observation = sense(simulation, own, animal)
        nerves, command = act(simulation, own, animal, observation)
        animal = animal._replace(nerves=nerves)
        return move(simulation, own, animal, observation, command, physics)

    if physics:
        return whole(life, animal)
    ndim = animal.state.position.ndim - 1
    given = life._replace(common_light=None), animal
    return fuse(whole, *given, batch_ndim=ndim, name="a control step")


def push(simulation: Simulation, life: Life, animal: Animal, index: Array) -> Animal:
    """The animal after the noise of one control step."""
    duration = 1.0 / simulation.control_rate

    def disturb(state: State, keys: Array | None) -> State:
        return disturb_motion(simulation.noise, state, keys, index, duration)

    ndim = animal.state.position.ndim - 1
    return animal._replace(
        state=fuse(disturb, animal.state, life.keys, batch_ndim=ndim, name="noise")
    )


def sense(simulation: Simulation, life: Life, animal: Animal) -> Observation:
    """What the controller gets to know."""
    world, state = simulation.world, animal.state

    def look(state: State, light: Array | None) -> tuple[Array, Array, Array, Array]:
        kin = kinematics(world.tree, state)
        place = _light_of(life, light, state.position)
        return *see(simulation.sensors, kin, place), fathom(simulation.sensors, world, kin)

    def read(state: State, forces: Forces, light: Array | None) -> Array:
        snapshot = snapshot_of(simulation, life._replace(light=light), state)
        return jnp.concatenate([one.sense(snapshot, forces) for one in simulation.extra_sensors])

    ndim = state.position.ndim - 1
    strength, cosine, sine, depth = fuse(look, state, life.light, batch_ndim=ndim, name="sensors")
    custom = None
    if simulation.extra_sensors:
        names = ", ".join(f"{type(one).__name__}.sense" for one in simulation.extra_sensors)
        custom = fuse(read, state, animal.forces, life.light, batch_ndim=ndim, name=names)
    return Observation(strength, animal.pressure, cosine, sine, state.q, state.qd, depth, custom)


def act(
    simulation: Simulation, life: Life, animal: Animal, observation: Observation
) -> tuple[Any, Command]:
    """The controller's next state, and what it asks of the motors."""
    controller, ndim = simulation.controller, animal.state.position.ndim - 1
    name = f"{type(controller).__name__}.act"
    given = life.phenotype.controller, animal.nerves, observation
    return fuse(controller.act, *given, batch_ndim=ndim, name=name)


def move(
    simulation: Simulation,
    life: Life,
    animal: Animal,
    observation: Observation,
    command: Command,
    physics: bool = False,
) -> tuple[Animal, Effects]:
    """The physics steps of a control step; see `control_step`."""
    world, h, state = simulation.world, simulation.step_length, animal.state
    batch = state.position.shape[1:]

    def advance(carry, _):
        before, warmstart, energy, airborne, forces, ground_force, residual = carry
        told = command.target_rate, h, command.target_angle
        state, effort = step(world, before, *told, warmstart, life.grip)
        if effort.contact_frame_force is not None:
            ground_force = effort.contact_frame_force
        airborne = airborne + _is_airborne(effort) / simulation.substeps
        forces = _add_share(forces, effort, 1.0 / simulation.substeps)
        energy = energy + effort.energy
        residual = jax.tree.map(jnp.maximum, residual, effort.residual)
        carry = state, effort.warmstart, energy, airborne, forces, ground_force, residual
        return carry, PhysicsStep(before, state, effort) if physics else None

    none, still = jnp.zeros(batch, state.q.dtype), no_forces(simulation, state)
    exact = None if animal.warmstart is None else Residual(none, none)
    start = state, animal.warmstart, none, none, still, still.contact_force, exact
    (moved, warmstart, energy, airborne, forces, ground_force, residual), each = jax.lax.scan(
        advance, start, None, length=simulation.substeps
    )

    def touch(state: State, ground_force: Array) -> Array:
        return feel(simulation.sensors, world, kinematics(world.tree, state), ground_force)

    pressure = animal.pressure
    if world.footing is not None and simulation.sensors.pressure_bodies:
        pressure = fuse(touch, moved, ground_force, batch_ndim=len(batch), name="sensors")
    kept = forces if animal.forces else None
    after = Animal(moved, animal.nerves, pressure, kept, warmstart)
    told = observation, command, forces, energy, airborne
    return after, Effects(state, moved, *told, residual, each)


def transition(simulation: Simulation, life: Life, effects: Effects, index: Array) -> Transition:
    """A control step as a task sees it."""
    before, after = (
        snapshot_of(simulation, life, state) for state in (effects.before, effects.after)
    )
    return Transition(index, before, after, *effects[2:7])


def snapshot_of(simulation: Simulation, life: Life, state: State) -> Snapshot:
    """The animal in a state, as tasks and sensors see it."""
    light = _light_of(life, life.light, state.position)
    return Snapshot(simulation.world, 1.0 / simulation.control_rate, state, light)


def _light_of(life: Life, own: Array | None, position: Array) -> Array | None:
    """Where the light is, with axes of individuals."""
    place = life.common_light if own is None else own
    return None if place is None else expand_dims_like(place, position)


def no_forces(simulation: Simulation, state: State) -> Forces:
    """Those of motors that do nothing, off the ground, of limbs apart."""
    footing, pairs = simulation.world.footing, simulation.world.pairs
    points = 0 if footing is None else len(footing.bodies)
    meeting = 0 if pairs is None else len(pairs.owners[0])
    batch, dtype = state.position.shape[1:], state.q.dtype
    none = (jnp.zeros((*shape, *batch), dtype) for shape in ((3, points), (meeting,)))
    return Forces(jnp.zeros_like(state.q), *none)


def _add_share(forces: Forces, effort: Effort, share: float) -> Forces:
    """The means so far, with those of one more physics step."""
    of_step = effort.torque, effort.contact_force, effort.pair_force
    return Forces(
        *(
            mean if force is None else mean + share * force
            for mean, force in zip(forces, of_step, strict=True)
        )
    )


def _is_airborne(effort: Effort) -> Float[Array, " *n"]:
    """1 where nothing touched the ground in a physics step, else 0; 1 without ground."""
    if effort.contact_frame_force is None:
        return jnp.ones_like(effort.energy)
    return jnp.all(effort.contact_frame_force[2] <= 0, axis=0).astype(effort.energy.dtype)
