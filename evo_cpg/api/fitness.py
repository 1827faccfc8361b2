"""Fitness as a function of a task's terms or of one genome, for JAX's transformations."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from evo_cpg.api.progress import working
from evo_cpg.io.errors import nearest
from evo_cpg.io.parameters import Parameters
from evo_cpg.simulation.backward import Backward, retention
from evo_cpg.simulation.judge import Scored
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.task import Task
from evo_cpg.training.experiment import ExperimentParts, mean_of_trials, situation_numbers


def fitness_function(
    parts: ExperimentParts,
    scales: dict[str, Float[Array, ""]],
    keys: Array | None,
    horizon: float | None,
    parameters: Parameters | None,
    task: Task | None,
) -> Callable[..., Float[Array, ""]]:
    """Return the fitness of one genome as a function.

    Args:
        parts: internal parts of the experiment.
        scales: scales of the task.
        keys: random keys of the noise in the trials, or None without noise.
        horizon: time constant of the decay of derivatives, s. None for derivatives that are exact
            in water and cut on the ground, infinity for exact derivatives.
        parameters: numbers of the configuration that are the function's second argument.
        task: task that replaces the configuration's in rebuilt simulations.
    """
    simulation, count = parts.simulation, parts.simulation.genome.count
    situations: Any = situation_numbers(parts)
    kept, exact = None, horizon == math.inf
    if horizon is not None and not exact:
        kept = float(retention(np.array([horizon]), simulation.control_rate)[0])
    rough = simulation.world.contact_model is not None and not exact
    backward = Backward(kept, rough=rough, slides=simulation.world.tree.root_slides)

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
        # JAX compiles derivatives after this function has returned, so no duration is known here.
        what = f"compiling the fitness of {parts.name!r}, and its derivatives if they are used"
        with working(f"{what} (up to a minute, once under jax.jit)"):
            return mean_of_trials(
                rollout(trial, genomes, keys, situations, Scored(scales), backward=backward)
            )

    return fitness


class UnknownTermError(KeyError):
    """Error for a term that the task lacks. The message suggests available terms."""

    def __str__(self) -> str:
        """Return the message without the quotes of a key."""
        return str(self.args[0])


class Terms(dict):
    """Terms by name. The error for an unknown name lists available terms.

    Raises:
        UnknownTermError: an unknown name is looked up.
    """

    def __missing__(self, name: object) -> Any:
        """Raise `UnknownTermError`."""
        raise UnknownTermError(f"the task has no term {name!r}: {nearest(str(name), self)}")


class JudgedBy(Task):
    """Task with another fitness function of its terms.

    Attributes:
        light: light of the original task.
        task: original task, which computes the terms.
        function: fitness as a function of the terms.
    """

    light: tuple[float, float, float] | None
    task: Task
    function: Callable = eqx.field(static=True)

    def begin(self, batch, dtype, steps):
        """Call `Task.begin` of the original task."""
        return self.task.begin(batch, dtype, steps)

    def update(self, tally, transition, steps):
        """Call `Task.update` of the original task."""
        return self.task.update(tally, transition, steps)

    def terms(self, tally, steps):
        """Call `Task.terms` of the original task."""
        return self.task.terms(tally, steps)

    def descriptors(self, terms):
        """Call `Task.descriptors` of the original task."""
        return self.task.descriptors(terms)

    def fitness(self, terms, scales):
        """Return the function's fitness of the terms."""
        del scales
        return self.function(Terms(terms))
