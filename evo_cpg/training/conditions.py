"""Tests of an individual in conditions that it did not evolve in: other situations, other physics.

A gait that fails with slightly more friction, half the step or a slightly different start exploits
one simulation.
"""

import dataclasses
from collections.abc import Callable, Iterable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from evo_cpg.simulation.batched import batch
from evo_cpg.simulation.judge import JUDGE
from evo_cpg.simulation.measures import DISPLACEMENT
from evo_cpg.simulation.noise import Noise, raw_keys
from evo_cpg.simulation.recording import Recorder
from evo_cpg.simulation.simulation import Simulation, with_displacement
from evo_cpg.simulation.situation import Situation
from evo_cpg.simulation.tasks import ReachLight
from evo_cpg.training.checkpoint import Champion
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.evaluate import compile_trials
from evo_cpg.training.experiment import ExperimentParts, champion_keys, judge, situation_numbers

# An animal that keeps at least this fraction of its displacement to the lights when blinded counts
# as not using its eyes. A blinded animal that swims straight ahead keeps 87 % of it to a light 30
# degrees aside, the default. It keeps less than this fraction only if the light is farther aside.
UNSEEING = 0.8

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

    Returns:
        A function of the champion.
    """
    trials, sims = experiment.trials, tuple(map(with_displacement, variation.simulations))
    rollouts = len(sims) * variation.draws
    numbers = situation_numbers(experiment)
    numbers = None if numbers is None else np.tile(numbers, rollouts)
    common, inputs, values = sims[0], None, None
    if len(sims) > 1:
        _, inputs, own = batch(common, sims)
        # Individuals are ordered by simulation, then by draw.
        values = tuple(np.repeat(value, variation.draws, 1) for value in own)
    dtype = np.float64 if variation.double else np.float32

    def arguments(champion: Champion) -> tuple:
        genes = np.asarray(champion.genes, dtype)[:, None].repeat(rollouts, 1)
        keys = None
        if not variation.simulations[0].silent:
            if variation.draws == 1:
                keys = champion_keys(experiment, champion)
                assert keys is not None
            else:
                split = jax.random.split(jax.random.key(_SEED), variation.draws * trials)
                keys = raw_keys(split)
            # All simulations get equal keys, so that only the numbers of the simulations differ.
            keys = jax.device_get(jnp.tile(keys, (1, len(variation.simulations))))
        return genes, keys, numbers, trials, values

    placeholder = Champion(np.zeros(experiment.simulation.genome.count), 0.0, 0, {}, {}, 0, 0)
    with jax.enable_x64(variation.double):
        width, mesh, given = rollouts * trials, population_mesh(1), arguments(placeholder)
        live = compile_trials(common, mesh, width, inputs, ahead=given)

    def of(champion: Champion) -> Varied:
        with jax.enable_x64(variation.double):
            outcome = live(*arguments(champion))
            shaped = jax.tree.map(lambda x: jnp.asarray(x.reshape(rollouts, trials)), outcome)
            scales = {name: jnp.asarray(value, dtype) for name, value in champion.scales.items()}
            judged = judge(common.task, shaped, scales, experiment.quantile)
            fitness, mean = jax.device_get(judged)
        displacement = np.where(mean.alive, mean.terms[DISPLACEMENT], np.nan).astype(float)
        terms = {k: np.asarray(x, float) for k, x in mean.terms.items() if k != DISPLACEMENT}
        return Varied(displacement, fitness.astype(float), np.asarray(mean.alive), terms)

    return of


def limp(simulation: Simulation) -> Simulation:
    """Return the simulation with motors that exert no torque, and relaxed muscles."""
    tree = simulation.world.tree
    weak = tree.without_motors(np.ones(tree.dof_count, bool))
    return eqx.tree_at(lambda s: s.world.tree, simulation, weak)


class Probe(NamedTuple):
    """Results of one animal in several situations. Arrays have a row for each situation.

    Attributes:
        situations: initial situations, all with a light.
        start_distance: initial distance from the light, m.
        distance: final distance as a fraction of the initial one, or NaN if the animal diverged.
        light: reading of the eye that sees most, 0 to 1, mean over the trial. NaN if diverged.
        alive: False if the animal diverged.
        paths: positions of the root's centre, m, once per control step.
    """

    situations: tuple[Situation, ...]
    start_distance: Float[np.ndarray, " n"]
    distance: Float[np.ndarray, " n"]
    light: Float[np.ndarray, " n"]
    alive: Bool[np.ndarray, " n"]
    paths: Float[np.ndarray, "n t 3"]

    def reached(self, fraction: float) -> Bool[np.ndarray, " n"]:
        """Return whether at most this fraction of the initial distance was left, by situation."""
        return self.alive & (self.distance <= fraction)

    @property
    def displacement(self) -> float:
        """Sum over all situations of the decrease in distance to the light, m."""
        return float(np.nansum(self.start_distance * (1.0 - self.distance)))


def probe(
    simulation: Simulation, genes: Float[np.ndarray, " g"], situations: tuple[Situation, ...]
) -> Probe:
    """Simulate one animal in several situations at once, without noise.

    The task `ReachLight` measures the distance, even if the animal evolved for another task.
    """
    final_steps = simulation.task.final_control_steps(simulation.control_rate)
    task = ReachLight(_light(situations[0]), final_steps=final_steps)
    simulation = dataclasses.replace(simulation, task=task, situations=situations, noise=Noise())
    count, observers = len(situations), (JUDGE, Recorder(count=None, names=("position",)))
    live = compile_trials(simulation, population_mesh(), observers=observers)
    outcome, frames = live(genes[:, None], None, np.arange(count), count)
    starts = np.array([situation.start_position for situation in situations])
    lights = np.array([_light(situation) for situation in situations])
    terms = {name: np.where(outcome.alive, x, np.nan) for name, x in outcome.terms.items()}
    return Probe(
        situations,
        np.linalg.norm(lights - starts, axis=1),
        terms["distance"],
        terms["light"],
        np.asarray(outcome.alive),
        # In the recorded positions, body 0 is the root.
        np.moveaxis(frames["position"][:, :, 0], -1, 0),
    )


def blinded(simulation: Simulation) -> Simulation:
    """Return the simulation with light sensors that return 0."""
    sensors = simulation.sensors._replace(blind=True)
    return dataclasses.replace(simulation, sensors=sensors)


def around(
    situation: Situation, bearings: Iterable[float], distances: Iterable[float] = ()
) -> tuple[Situation, ...]:
    """Return copies of a situation with the light at other bearings, and at the same elevation.

    Args:
        situation: situation with a light.
        bearings: bearings of the light, to the left of straight ahead, rad.
        distances: distances of the light from the start, m. If empty, the present distance.
    """
    x, y, z = situation.start_position
    distance, _, elevation = seen_from_start(situation)
    return tuple(
        situation._replace(
            light=(
                x + away * float(np.cos(elevation) * np.cos(situation.start_heading + bearing)),
                y + away * float(np.cos(elevation) * np.sin(situation.start_heading + bearing)),
                z + away * float(np.sin(elevation)),
            )
        )
        for away in (tuple(distances) or (distance,))
        for bearing in bearings
    )


def seen_from_start(situation: Situation) -> tuple[float, float, float]:
    """Return the light's distance (m), bearing to the left and elevation (rad) at the start."""
    away = np.subtract(_light(situation), situation.start_position)
    level = float(np.hypot(away[0], away[1]))
    bearing = float(np.arctan2(away[1], away[0])) - situation.start_heading
    turned = float(np.arctan2(np.sin(bearing), np.cos(bearing)))
    return float(np.linalg.norm(away)), turned, float(np.arctan2(away[2], level))


def _light(situation: Situation) -> tuple[float, float, float]:
    assert situation.light is not None
    return situation.light
