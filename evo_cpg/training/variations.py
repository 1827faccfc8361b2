"""Displacement of an individual under conditions that it did not evolve in.

A gait that fails with slightly more friction, half the step or a slightly different start exploits
one simulation.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from evo_cpg.native.engine import Engine
from evo_cpg.simulation.batched import batch
from evo_cpg.simulation.judge import Outcome
from evo_cpg.simulation.measures import DISPLACEMENT
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.simulation import Simulation, with_displacement
from evo_cpg.training.checkpoint import Champion
from evo_cpg.training.experiment import ExperimentParts, champion_keys, judge, situation_numbers

# Seed of the fresh draws of noise.
_SEED = 20


class Variation(NamedTuple):
    """Changed conditions of one kind.

    Attributes:
        name: name for tables.
        simulations: one simulation, or several that differ in numbers only.
        draws: draws of noise in each simulation.
        double: whether the trials are computed in float64.
    """

    name: str
    simulations: tuple[Simulation, ...]
    draws: int = 1
    double: bool = False


class Varied(NamedTuple):
    """Results of an individual, one for each simulation and draw.

    Attributes:
        displacement: mean displacement over the individual's trials, m, or NaN if it diverged.
        fitness: mean fitness over the trials, or -inf if it diverged or broke a rule.
        alive: False if the individual diverged in any trial.
        terms: means of the task's terms and of the measures.
    """

    displacement: Float[np.ndarray, " n"]
    fitness: Float[np.ndarray, " n"]
    alive: Bool[np.ndarray, " n"]
    terms: dict[str, Float[np.ndarray, " n"]]

    def mean_displacements(self, variation: Variation) -> Float[np.ndarray, " simulations"]:
        """Return means over the draws of noise, m. A rollout that diverged counts as 0."""
        each = np.where(self.alive, np.nan_to_num(self.displacement), 0.0)
        return each.reshape(len(variation.simulations), variation.draws).mean(1)


def compile_variation(
    experiment: ExperimentParts, variation: Variation
) -> Callable[[Champion], Varied]:
    """Compile an individual's trials under other conditions, before there is a champion.

    Args:
        experiment: the experiment that the champion evolves in.
        variation: the conditions.

    Returns:
        A function of the champion.
    """
    trials, sims = experiment.trials, tuple(map(with_displacement, variation.simulations))
    rollouts = len(sims) * variation.draws
    numbers = situation_numbers(experiment)
    numbers = None if numbers is None else np.tile(numbers, rollouts)
    # Lanes are ordered by simulation, then by draw, then by trial.
    owners = np.repeat(np.arange(len(sims)), variation.draws * trials)
    dtype = np.float64 if variation.double else np.float32
    gene_count = experiment.simulation.genome.count
    placeholder = Champion(np.zeros(gene_count), 0.0, 0, {}, {}, 0, 0)
    with jax.enable_x64(variation.double):
        keys = jax.eval_shape(lambda: _keys(experiment, placeholder, variation))
        lanes = jax.ShapeDtypeStruct((gene_count, rollouts * trials), dtype)
        program = jax.jit(_program(sims, owners)).lower(lanes, keys, numbers).compile()

    def of(champion: Champion) -> Varied:
        with jax.enable_x64(variation.double):
            genes = np.asarray(champion.genes, dtype)[:, None].repeat(rollouts * trials, 1)
            outcome = program(genes, _keys(experiment, champion, variation), numbers)
            shaped = jax.tree.map(lambda x: x.reshape(rollouts, trials), outcome)
            scales = {name: jnp.asarray(value, dtype) for name, value in champion.scales.items()}
            fitness, mean = jax.device_get(judge(sims[0].task, shaped, scales))
        displacement = np.where(mean.alive, mean.terms[DISPLACEMENT], np.nan).astype(float)
        terms = {k: np.asarray(x, float) for k, x in mean.terms.items() if k != DISPLACEMENT}
        return Varied(displacement, fitness.astype(float), np.asarray(mean.alive), terms)

    return of


def finer(simulation: Simulation, times: int) -> Simulation:
    """Return the simulation with each physics step divided into several."""
    return dataclasses.replace(simulation, substeps=times * simulation.substeps)


def with_friction(simulation: Simulation, factor: float) -> Simulation:
    """Return the simulation with the ground's static and dynamic friction scaled.

    Raises:
        ValueError: there is no ground.
    """
    return dataclasses.replace(simulation, world=simulation.world.with_friction(factor))


def with_drag(simulation: Simulation, factor: float) -> Simulation:
    """Return the simulation with the water's form drag and skin drag scaled.

    Raises:
        ValueError: there is no water.
    """
    return dataclasses.replace(simulation, world=simulation.world.with_drag(factor))


def shaken(simulation: Simulation, angle: float) -> Simulation:
    """Return the simulation with a slightly different initial pose in every draw.

    Args:
        simulation: simulation to change.
        angle: standard deviation of every joint angle, and of the root's roll and pitch, rad.
    """
    own = simulation.noise
    noise = dataclasses.replace(
        own, joint_angle=max(own.joint_angle, angle), tilt=max(own.tilt, angle)
    )
    return dataclasses.replace(simulation, noise=noise)


def limp(simulation: Simulation) -> Simulation:
    """Return the simulation with motors that exert no torque, and relaxed muscles."""
    tree = simulation.world.tree
    weak = tree.without_motors(np.ones(tree.dof_count, bool))
    return eqx.tree_at(lambda s: s.world.tree, simulation, weak)


def on_engine(simulation: Simulation, engine: Engine) -> Simulation:
    """Return the simulation with another engine."""
    return dataclasses.replace(simulation, engine=engine)


def _program(sims: Sequence[Simulation], owners: np.ndarray) -> Callable[..., Outcome]:
    """Return one program for all rollouts."""
    every = sims[0]
    if len(sims) > 1:
        every = batch(sims[0], sims)
        every = every._replace(values=[jnp.asarray(value[:, owners]) for value in every.values])
    return lambda genes, keys, numbers: rollout(every, genes, keys, numbers)


def _keys(experiment: ExperimentParts, champion: Champion, variation: Variation) -> Array | None:
    """Return raw random keys of all trials: the champion's own, or others for several draws."""
    if variation.simulations[0].noise.silent:
        return None
    if variation.draws == 1:
        keys = champion_keys(experiment, champion)
        assert keys is not None
    else:
        each = jax.random.split(jax.random.key(_SEED), variation.draws * experiment.trials)
        keys = jax.random.key_data(each).T
    # All simulations get equal random keys, so that only the numbers of the simulations differ.
    return jnp.tile(keys, (1, len(variation.simulations)))
