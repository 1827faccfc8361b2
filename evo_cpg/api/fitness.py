"""Fitness as a function: of the terms of a task, and of one genome, for JAX's transformations."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from evo_cpg.config.errors import nearest
from evo_cpg.config.parameters import Parameters
from evo_cpg.simulation.backward import Backward, retention
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.task import Task
from evo_cpg.training.experiment import Experiment, judge, situation_numbers


def fitness_function(
    parts: Experiment,
    scales: dict[str, Float[Array, ""]],
    keys: Array | None,
    horizon: float | None,
    parameters: Parameters | None,
    task: Task | None,
) -> Callable[..., Float[Array, ""]]:
    """The fitness of one genome.

    Args:
        parts: of the experiment.
        scales: the task's yardsticks.
        keys: of the noise in its trials.
        horizon: time constant with which derivatives fade, s; None for derivatives that are exact
            in water and cut on the ground, infinity for exact ones.
        parameters: numbers of the configuration that the function takes as well.
        task: instead of the configuration's.
    """
    simulation, count = parts.simulation, parts.simulation.genome.count
    situations: Any = situation_numbers(parts)
    kept, exact = None, horizon == math.inf
    if horizon is not None and not exact:
        kept = float(retention(np.array([horizon]), simulation.control_rate)[0])
    backward = Backward(kept, rough=simulation.world.contact_model is not None and not exact)

    def fitness(genome: ArrayLike, values: ArrayLike | None = None) -> Float[Array, ""]:
        genome = jnp.asarray(genome)
        if genome.shape != (count,):
            raise ValueError(f"genome must have the shape ({count},), got {genome.shape}")
        trial = simulation
        if parameters is not None:
            shape = (len(parameters.keys),)
            if values is None or jnp.shape(values) != shape:
                given = "none" if values is None else jnp.shape(values)
                raise ValueError(f"values must have the shape {shape}, got {given}")
            trial = parameters.simulation(parameters.checked(jnp.asarray(values, genome.dtype)))
            trial = dataclasses.replace(trial, task=task) if task else trial
        genomes = jnp.broadcast_to(genome[:, None], (count, parts.trials))
        outcome = rollout(trial, genomes, keys, situations, backward=backward)
        return judge(trial.task, outcome, scales)[0]

    return fitness


class UnknownTermError(KeyError):
    """A term that the task has not; the message says which it has."""

    def __str__(self) -> str:
        """Without the quotes of a key."""
        return str(self.args[0])


class Terms(dict):
    """Terms by name; of one that is none it says which there are.

    Raises:
        UnknownTermError: by the look-up of another name.
    """

    def __missing__(self, name: object) -> Any:
        """Complain."""
        raise UnknownTermError(f"the task has no term {name!r}; {nearest(str(name), self)}")


class JudgedBy(Task):
    """A task whose terms something else makes a fitness of.

    Attributes:
        light: the task's.
        task: whose terms they are.
        function: of the terms.
    """

    light: tuple[float, float, float] | None
    task: Task
    function: Callable = eqx.field(static=True)

    def begin(self, batch, dtype, steps):
        """See `Task.begin`."""
        return self.task.begin(batch, dtype, steps)

    def update(self, tally, transition, steps):
        """See `Task.update`."""
        return self.task.update(tally, transition, steps)

    def terms(self, tally, steps):
        """See `Task.terms`."""
        return self.task.terms(tally, steps)

    def descriptors(self, terms):
        """See `Task.descriptors`."""
        return self.task.descriptors(terms)

    def fitness(self, terms, scales):
        """That of the function."""
        del scales
        return self.function(Terms(terms))
