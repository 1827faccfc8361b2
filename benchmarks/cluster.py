"""Measure what a cluster costs in a generation: time, and bytes on the network.

    python -m benchmarks.cluster [workers ...]

The workers are threads of this process. They return results without any trials and without JAX, so
the time is that of dividing, sending, checking and joining. All connections use TLS.
"""

import contextlib
import pickle
import statistics
import sys
import time
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np

from evo_cpg.api import cluster
from evo_cpg.evolution.strategy import Evaluation
from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import load_config
from evo_cpg.io.shipped import find_config
from evo_cpg.training.checkpoint import Checkpoint
from evo_cpg.training.experiment import placeholder_scales
from evo_cpg.training.replica import Found, Judged, Piece, PopulationCopy, checksum, used_results
from evo_cpg.training.team import Team

GENERATIONS = 20
EACH = 48  # individuals of a worker


class Idle:
    """Worker's end that answers at once: every individual has the fitness 1."""

    def __init__(self, job: cluster.Job) -> None:
        # The job of `IdleCluster.begin`.
        self._arrays, self._digest = job.width, 0

    def evaluate(self, pieces: list[Piece]) -> list[Found]:
        """Return results as long as real ones."""
        found = []
        for piece in pieces:
            if isinstance(piece.news, PopulationCopy):
                self._digest = checksum(piece.news.genes)
            count = piece.last - piece.first
            worth = [np.ones(count, np.float32), *[None] * (self._arrays - 1)]
            alive = np.packbits(np.ones(count, bool))
            found.append(Found(self._digest, Judged(worth, alive, 0, {})))
        return found

    def described(self) -> dict[str, str]:
        """Return no processor."""
        return {}


class IdleCluster(cluster.DaskCluster):
    """Cluster whose workers are idle. It counts the bytes of pieces and results."""

    sent = received = 0

    def send(self, worker: str, pieces: Sequence[Piece]) -> None:
        """Count the bytes, and send."""
        self.sent += len(pickle.dumps(pieces, -1))
        super().send(worker, pieces)

    def receive(self) -> tuple[str, list[Found] | None]:
        """Count the bytes of what arrives."""
        worker, found = super().receive()
        self.received += len(pickle.dumps(found, -1))
        return worker, found

    def begin(self, running: Sequence, width: int) -> None:
        """Start the idle workers."""
        del width
        worth, _ = used_results(running[0].experiment)
        self._start(cluster.Job((), (), (), False, len(jax.tree.leaves(worth)), (), ""))


def measure(workers: int) -> tuple[float, float, float]:
    """Return the seconds of a generation, and the bytes of an individual that a worker sends and
    receives.
    """
    source = find_config("iwadate2010_swimmer")
    config = load_config(source, [f"evolution.population={EACH * workers}"])
    experiment = build_experiment(config, source)
    population = experiment.strategy.population
    genes = np.zeros((experiment.simulation.genome.count, population), np.float32)
    scales = placeholder_scales(experiment)
    fitness = np.ones((1, population), np.float32)
    with contextlib.ExitStack() as stack:
        local = stack.enter_context(cluster._local(workers))
        idle = IdleCluster(stack.enter_context(cluster._joined(local)), f"{workers}")
        stack.callback(idle.close)
        running: Any = SimpleNamespace(
            experiment=experiment,
            checkpoint=Checkpoint(0, genes, (None,), [], scales),
            state=(),
            worth=None,
            choosing=False,
            trials=lambda: None,
        )
        team = Team(idle, [running])
        like, _ = used_results(experiment)
        times = []
        for generation in range(1, GENERATIONS + 2):
            running.checkpoint = running.checkpoint._replace(generation=generation)
            started = time.perf_counter()
            team.evaluate([running])
            times.append(time.perf_counter() - started)
            if generation == 1:
                idle.sent = idle.received = 0
            terms = {name: fitness for name in like.terms}
            each = {name: fitness for name in like.descriptors}
            running.worth = Evaluation(fitness, terms, each, fitness[:, None])
        count = GENERATIONS * population
        return (statistics.median(times[1:]), idle.received / count, idle.sent / count / workers)


def main() -> None:
    """Print a row for each number of workers."""
    import distributed

    distributed.Nanny = distributed.Worker
    cluster.Evaluator = Idle
    print("| workers | ms | bytes sent | bytes received by each worker |")
    for workers in map(int, sys.argv[1:] or ("4", "16", "64")):
        seconds, sent, received = measure(workers)
        print(f"| {workers} | {1e3 * seconds:.0f} | {sent:.1f} | {received:.1f} |", flush=True)


if __name__ == "__main__":
    main()
