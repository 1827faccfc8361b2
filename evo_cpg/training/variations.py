"""One individual under circumstances that it did not evolve in: how much of its way does it keep?

A gait that a little more friction, half the step or a hair's breadth at the start undoes is a trick
of one simulation, and no way to move.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from evo_cpg.fusion.engine import Engine
from evo_cpg.simulation.batched import batch
from evo_cpg.simulation.judge import Outcome
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.simulation.way import WAY, with_way
from evo_cpg.training.checkpoint import Champion
from evo_cpg.training.experiment import Experiment, champion_keys, judge, situation_numbers

# Of the random numbers that draws of the pose come from.
_SEED = 20


class Variation(NamedTuple):
    """Circumstances of one kind.

    Attributes:
        name: for tables.
        simulations: one or several that differ in numbers alone.
        draws: of chance, in each of them.
        double: in float64.
    """

    name: str
    simulations: tuple[Simulation, ...]
    draws: int = 1
    double: bool = False


class Kept(NamedTuple):
    """What became of an individual; an element for each of the simulations and draws.

    Attributes:
        way: mean over its trials, m; NaN where it diverged.
        fitness: likewise; -inf where it diverged.
        alive: False where it diverged in any trial.
        terms: the task's terms and the measures, means likewise.
    """

    way: Float[np.ndarray, " n"]
    fitness: Float[np.ndarray, " n"]
    alive: Bool[np.ndarray, " n"]
    terms: dict[str, Float[np.ndarray, " n"]]

    def mean_ways(self, variation: Variation) -> Float[np.ndarray, " simulations"]:
        """Means over the draws of chance, m; a life that diverged made none."""
        ways = np.where(self.alive, np.nan_to_num(self.way), 0.0)
        return ways.reshape(len(variation.simulations), variation.draws).mean(1)


def live(experiment: Experiment, champion: Champion, variation: Variation) -> Kept:
    """Let an individual live through its trials.

    Args:
        experiment: that it was evolved in.
        champion: the individual.
        variation: where it lives now.
    """
    return compile_lives(experiment, variation)(champion)


def compile_lives(experiment: Experiment, variation: Variation) -> Callable[[Champion], Kept]:
    """Compile `live` before there is a champion."""
    trials, sims = experiment.trials, tuple(map(with_way, variation.simulations))
    lives = len(sims) * variation.draws
    numbers = situation_numbers(experiment)
    numbers = None if numbers is None else np.tile(numbers, lives)
    # Lives are neighbours, trial by trial; so are their simulations.
    owners = np.repeat(np.arange(len(sims)), variation.draws * trials)
    dtype = np.float64 if variation.double else np.float32
    gene_count = experiment.simulation.genome.count
    nobody = Champion(np.zeros(gene_count), 0.0, 0, {}, {}, 0, 0)
    with jax.enable_x64(variation.double):
        keys = jax.eval_shape(lambda: _keys(experiment, nobody, variation))
        crowd = jax.ShapeDtypeStruct((gene_count, lives * trials), dtype)
        program = jax.jit(_program(sims, owners)).lower(crowd, keys, numbers).compile()

    def of(champion: Champion) -> Kept:
        with jax.enable_x64(variation.double):
            genes = np.asarray(champion.genes, dtype)[:, None].repeat(lives * trials, 1)
            outcome = program(genes, _keys(experiment, champion, variation), numbers)
            shaped = jax.tree.map(lambda x: x.reshape(lives, trials), outcome)
            scales = {name: jnp.asarray(value, dtype) for name, value in champion.scales.items()}
            fitness, mean = jax.device_get(judge(sims[0].task, shaped, scales))
        way = np.where(mean.alive, mean.terms[WAY], np.nan)
        terms = {name: np.asarray(x, float) for name, x in mean.terms.items() if name != WAY}
        return Kept(way.astype(float), fitness.astype(float), np.asarray(mean.alive), terms)

    return of


def finer(simulation: Simulation, times: int) -> Simulation:
    """The same with each physics step divided into several."""
    return dataclasses.replace(simulation, substeps=times * simulation.substeps)


def with_friction(simulation: Simulation, factor: float) -> Simulation:
    """The same on ground with more or less friction, static and dynamic.

    Raises:
        ValueError: there is no ground.
    """
    return dataclasses.replace(simulation, world=simulation.world.with_friction(factor))


def with_drag(simulation: Simulation, factor: float) -> Simulation:
    """The same in water with more or less drag of both kinds.

    Raises:
        ValueError: there is no water.
    """
    return dataclasses.replace(simulation, world=simulation.world.with_drag(factor))


def shaken(simulation: Simulation, angle: float) -> Simulation:
    """The same, starting from a pose that is a little different in every draw.

    Args:
        simulation: the trial.
        angle: standard deviation of every joint angle, and of the root's roll and pitch, rad.
    """
    own = simulation.noise
    noise = dataclasses.replace(
        own, joint_angle=max(own.joint_angle, angle), tilt=max(own.tilt, angle)
    )
    return dataclasses.replace(simulation, noise=noise)


def limp(simulation: Simulation) -> Simulation:
    """The same with motors that do nothing."""
    tree = simulation.world.tree
    weak = dataclasses.replace(
        tree,
        servo_gain=np.zeros_like(tree.servo_gain),
        servo_stiffness=np.zeros_like(tree.servo_stiffness),
    )
    return eqx.tree_at(lambda s: s.world.tree, simulation, weak)


def on_engine(simulation: Simulation, engine: Engine) -> Simulation:
    """The same, computed by something else."""
    return dataclasses.replace(simulation, engine=engine)


def _program(sims: Sequence[Simulation], owners: np.ndarray) -> Callable[..., Outcome]:
    """All lives in one program."""
    every = sims[0]
    if len(sims) > 1:
        every = batch(sims[0], sims)
        every = every._replace(values=[jnp.asarray(value[:, owners]) for value in every.values])
    return lambda genes, keys, numbers: rollout(every, genes, keys, numbers)


def _keys(experiment: Experiment, champion: Champion, variation: Variation) -> Array | None:
    """Raw keys of all lives' trials: those that it had, unless chance is drawn anew."""
    if variation.simulations[0].noise.silent:
        return None
    if variation.draws == 1:
        keys = champion_keys(experiment, champion)
        assert keys is not None
    else:
        each = jax.random.split(jax.random.key(_SEED), variation.draws * experiment.trials)
        keys = jax.random.key_data(each).T
    # The same in all simulations: only what they differ in makes a difference.
    return jnp.tile(keys, (1, len(variation.simulations)))
