"""Run a trial: an animal with its controller in a world, and observers that follow it.

One trial is ``steps`` control steps of ``1 / control_rate`` seconds (2000 steps of 1/60 s in
Iwadate 2010), each as in `evo_cpg.simulation.control_step`.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PyTree, UInt32

from evo_cpg.native.engine import using
from evo_cpg.native.fuse import fuse
from evo_cpg.physics.tree.state import State
from evo_cpg.simulation.backward import Backward
from evo_cpg.simulation.batched import BatchedSimulation, inputs_of
from evo_cpg.simulation.control_step import begin_episode, control_step
from evo_cpg.simulation.judge import JUDGE
from evo_cpg.simulation.observers import Observer, Seen
from evo_cpg.simulation.simulation import NumberBuilder, Simulation

# Leaves are observers.
Observers = PyTree[Observer]


def rollout(
    simulation: Simulation | BatchedSimulation,
    genes: Float[Array, "g *n"],
    keys: UInt32[Array, "w *n"] | None = None,
    trial: Int[Array, " *n"] | None = None,
    observers: Observers = JUDGE,
    *,
    backward: Backward | None = None,
    begin: Callable[[State], State] | None = None,
) -> Any:
    """Run one trial of every individual.

    Args:
        simulation: the trial, or one trial for each individual. In the second case genes, keys and
            trial have one batch axis, the last, and so has every result.
        genes: one genome per individual, on the trailing axes.
        keys: raw random keys of each trial, or None if nothing is random: one for its noise, and
            another one after it for its course if courses are drawn.
        trial: number of the situation of each individual, or None for the first situation.
        observers: one observer, or a tuple or dict of several.
        backward: settings of reverse-mode differentiation, or None. Do not combine it with
            observers of every step. A gradient is fastest with `Scored` as the observer.
        begin: function that changes the initial state of the trial.

    Raises:
        ValueError: plans evolve in the simulation.

    Returns:
        Result of each observer. For `JUDGE`, an `evo_cpg.simulation.judge.Outcome`.
    """
    if isinstance(simulation, Simulation) and simulation.plans is not None:
        raise ValueError("plans run in programs of several sizes. Use the body of one genome alone")
    if isinstance(simulation, Simulation) and simulation.bodies is not None:
        simulation = _with_bodies(simulation, genes)
    if isinstance(simulation, Simulation) and simulation.draws is not None:
        simulation = _with_courses(simulation, keys)
    if isinstance(simulation, BatchedSimulation):
        common, inputs, values = simulation

        def alone(
            values: list[Array], genes: Array, keys: Array | None, trial: Array | None
        ) -> Any:
            own = inputs.put(common, values)
            return rollout(own, genes, keys, trial, observers, backward=backward, begin=begin)

        own = [jnp.asarray(value, genes.dtype) for value in values]
        found = jax.vmap(alone, in_axes=-1, out_axes=-1)(own, genes, keys, trial)
        return jax.tree.map(lambda one, result: one.of_bodies(result), observers, found)
    # An argument without effect is dropped from the program.
    keys = None if simulation.silent else keys
    trial = None if len(simulation.situations) == 1 else trial

    physics = any(one.physics for one in jax.tree.leaves(observers))

    def run(genes: Array, keys: Array | None, trial: Array | None) -> Any:
        constants, animal = begin_episode(simulation, genes, keys, trial)
        if begin is not None:
            animal = animal._replace(state=begin(animal.state))

        def advance(carry, index):
            animal, tally = carry
            if backward is not None:
                inner = animal.nerves, animal.warmstart
                state, (nerves, warmstart) = backward.forget(animal.state, inner)
                animal = animal._replace(state=state, nerves=nerves, warmstart=warmstart)
            # Each control step is a program, or a part of the program of the trial.
            animal, effects = control_step(simulation, constants, animal, index, physics)
            seen = Seen(simulation, constants, index, animal, effects)
            tally = jax.tree.map(lambda one, own: one.update(own, seen), observers, tally)
            return (animal, tally), jax.tree.map(lambda one: one.of_step(seen), observers)

        tally = jax.tree.map(lambda one: one.begin(simulation, animal), observers)
        carry, steps = (animal, tally), simulation.steps
        if backward is None:
            (_, tally), kept = jax.lax.scan(advance, carry, jnp.arange(steps))
        else:
            _, tally = backward.scan(advance, carry, steps, animal.state.position.shape[1:])
            kept = jax.tree.map(lambda one: (), observers)
        return jax.tree.map(lambda one, *own: one.finish(simulation, *own), observers, tally, kept)

    with using(simulation.engine):
        # Results stacked along time cannot become native code, but control steps can.
        if any(one.every_step for one in jax.tree.leaves(observers)):
            return run(genes, keys, trial)
        return fuse(run, genes, keys, trial, batch_ndim=genes.ndim - 1, name="a trial")


def _with_bodies(simulation: Simulation, genes: Array) -> Simulation | BatchedSimulation:
    """Return the simulation with the body of each individual as a function of its genes."""
    assert simulation.bodies is not None
    own, common = simulation.genome.of_body(genes), dataclasses.replace(simulation, bodies=None)
    return _with_numbers(common, simulation.bodies, own)


def _with_courses(simulation: Simulation, keys: Array | None) -> Simulation | BatchedSimulation:
    """Return the simulation with the course of each trial as a function of its random key."""
    own, common = simulation.course_keys(keys), dataclasses.replace(simulation, draws=None)
    assert simulation.draws is not None and own is not None, "courses need random keys"
    return _with_numbers(common, simulation.draws, own)


def _with_numbers(
    common: Simulation, builder: NumberBuilder, origin: Array
) -> Simulation | BatchedSimulation:
    inputs, kept = inputs_of(builder, common)
    if origin.ndim == 1:
        values = builder.traced(origin)
        return inputs.put(common, [values[i] for i in kept])
    values = jax.vmap(builder.traced, in_axes=-1, out_axes=-1)(origin)
    return BatchedSimulation(common, inputs, [values[i] for i in kept])
