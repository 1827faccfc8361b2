"""Refinement of a champion by gradient ascent on its fitness.

In every round, all cores together move some individuals, called lanes, by gradient steps. Every
lane has its own settings of the ascent (see `evo_cpg.training.ascent`). It starts from one of the
best individuals so far. Half of the lanes start with a random kick. The shortest horizons double
from round to round. After a round the best are evaluated in chunks as wide as in training. So a
refined champion is evaluated, and replays, exactly like an evolved champion.
"""

import time
from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Float

from evo_cpg.native.machine_constants import LANES
from evo_cpg.training.ascent import Free, compile_ascent, draw_settings, log_uniform, reach
from evo_cpg.training.checkpoint import Champion
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.evaluate import compile_evaluation
from evo_cpg.training.experiment import ExperimentParts, champion_keys

# Number of individuals from which the lanes of the next round start.
_PARENTS = 4
# Range of a kick's standard deviation in water, in units of genes, and fraction of kicked lanes.
_KICKS = 1e-2, 1e-1
_KICKED = 0.5


class Refinement(NamedTuple):
    """Settings of a refinement.

    Attributes:
        rounds: number of rounds of ascent and selection.
        steps: number of moves of each lane in a round.
        lanes: number of simultaneous individuals, or None for a full vector of trials per core.
        seed: seed of the lanes' draws.
    """

    rounds: int = 5
    steps: int = 20
    lanes: int | None = None
    seed: int = 0


class Round(NamedTuple):
    """Results of one round.

    Attributes:
        number: number of the round, from 0.
        initial_fitness: fitness before the first round.
        champion: best individual so far.
        values: free numbers of the champion.
        gain: fitness gain of the round.
        gradients: number of gradients that were computed.
        finite: number of finite gradients. Other gradients count as zero.
        seconds: duration of the round, s.
    """

    number: int
    initial_fitness: float
    champion: Champion
    values: Float[np.ndarray, " k"]
    gain: float
    gradients: int
    finite: int
    seconds: float


class _Parent(NamedTuple):
    """Individual from which lanes may start, with its free numbers.

    Attributes:
        champion: the individual.
        shifts: shifts of the free numbers.
    """

    champion: Champion
    shifts: Float[np.ndarray, " k"]


def compile_refinement(
    experiment: ExperimentParts,
    settings: Refinement,
    mesh: Mesh | None = None,
    devices: int | None = None,
    free: Free | None = None,
) -> Callable[..., Champion]:
    """Return a function that refines any champion of an experiment.

    Args:
        experiment: experiment in which the champion evolved.
        settings: settings of the refinement.
        mesh: devices to use, or None for all.
        devices: number of devices in training, or None for the number used here.
        free: numbers of the experiment that are refined as well. The chosen individual is evaluated
            in an experiment that is rebuilt with them.

    Returns:
        A function of a champion and of a callback for the `Round` after every round, compiled at
        its first call. The result is the refined champion or, if nothing better was found, the
        original. Fitness is compared in this experiment. The recorded fitness is ignored.
    """
    mesh = mesh or population_mesh()
    lanes = settings.lanes or mesh.size * max(1, LANES // experiment.trials)
    climb = compile_ascent(experiment, mesh, settings.steps, free)
    devices = devices or mesh.size
    evaluate = _compile_judging(experiment, mesh, devices)
    count = 0 if free is None else len(free.values)

    def try_out(found: Float[np.ndarray, "p n"], champion: Champion) -> list[_Parent]:
        if free is None:
            nothing = np.zeros(0, np.float32)
            return [_Parent(one, nothing) for one in evaluate(found, champion)]
        # Each individual has its own free numbers, so its experiment must be built and compiled.
        # Evaluate only the fittest whose experiment can be built.
        for genes, shifts in zip(found[:-count].T, found[-count:].T, strict=True):
            world = free.rebuild(np.asarray(free.at(shifts), float))
            if world is not None:
                tried = _compile_judging(world, mesh, devices)(genes[:, None], champion)
                return [_Parent(one, shifts) for one in tried]
        return []

    def refine(
        champion: Champion, on_round: Callable[[Round], None] = lambda done: None
    ) -> Champion:
        keys = jax.device_get(champion_keys(experiment, champion))
        if keys is not None:
            # All lanes have equal keys: words of a key, trials, and lanes.
            keys = np.repeat(keys[..., None], lanes, -1)
        scales = {name: np.full(lanes, x, np.float32) for name, x in champion.scales.items()}
        alive = evaluate(champion.genes[:, None], champion)
        champion = alive[0] if alive else champion._replace(fitness=-np.inf)
        initial_fitness = champion.fitness
        parents = [_Parent(champion, np.zeros(count, np.float32))]
        for number in range(settings.rounds):
            start = time.perf_counter()
            rng = np.random.default_rng((settings.seed, number))
            starts = _starts(parents, rng, lanes, reach(experiment.simulation))
            climbs = draw_settings(rng, experiment.simulation, lanes, 2.0**number)
            climbed = climb(starts, climbs, scales, keys)
            chosen = np.argsort(-climbed.fitness)[: 2 * _PARENTS]
            chosen = chosen[np.isfinite(climbed.fitness[chosen])]
            found = try_out(climbed.genes[:, chosen], champion) if len(chosen) else []
            # Of equally fit individuals, the earlier one comes first.
            ranked = sorted([*parents, *found], key=lambda one: -one.champion.fitness)
            gain = ranked[0].champion.fitness - parents[0].champion.fitness
            parents = ranked[:_PARENTS]
            values = np.asarray(free.at(parents[0].shifts), float) if free else np.zeros(0)
            seconds = time.perf_counter() - start
            gradients, finite = lanes * (settings.steps + 1), int(climbed.finite.sum())
            best = parents[0].champion
            on_round(Round(number, initial_fitness, best, values, gain, gradients, finite, seconds))
        return parents[0].champion

    return refine


def _compile_judging(
    experiment: ExperimentParts, mesh: Mesh, devices: int
) -> Callable[[Float[np.ndarray, "g n"], Champion], list[Champion]]:
    """Return `compile_evaluation` with individuals as results, if their fitness is finite."""
    evaluate = compile_evaluation(experiment, mesh, devices)

    def judged(genes: Float[np.ndarray, "g n"], champion: Champion) -> list[Champion]:
        fitness, mean, _ = evaluate(genes, champion)
        return [
            champion._replace(
                genes=np.ascontiguousarray(genes[:, i]),
                fitness=float(fitness[i]),
                terms={name: float(values[i]) for name, values in mean.terms.items()},
                lives=0,
                expected=None,
                ended_early=0,
            )
            for i in np.flatnonzero(np.isfinite(fitness))
        ]

    return judged


def _starts(
    parents: list[_Parent], rng: np.random.Generator, count: int, scale: float
) -> Float[np.ndarray, "p n"]:
    """Return the genes and shifts from which the lanes of a round start.

    The first lane starts from the best individual without a kick.
    """
    # Better parents are drawn more often.
    drawn = np.minimum(rng.exponential(1.0, count).astype(int), len(parents) - 1)
    kicked = rng.random(count) < _KICKED
    drawn[0], kicked[0] = 0, False
    genes = np.stack(
        [np.concatenate([parents[i].champion.genes, parents[i].shifts]) for i in drawn], 1
    )
    kick = scale * kicked * log_uniform(rng, *_KICKS, count)
    return (genes + kick * rng.standard_normal(genes.shape)).astype(np.float32)
