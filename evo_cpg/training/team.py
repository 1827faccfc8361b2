"""The populations of a generation, divided among the workers of a cluster.

Every worker gets a part in proportion to its cores, each generation anew, because workers come and
go. The part of a lost worker goes to the next one that is free. Workers breed their populations
themselves (`evo_cpg.training.replica`), so fitness travels and genomes do not.

`Cluster` is what this needs of an engine. `evo_cpg.api.cluster` makes one of Dask.
"""

import contextlib
import contextvars
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple, Protocol

import jax
import numpy as np
from jaxtyping import Float

from evo_cpg.native.machine_constants import LANES
from evo_cpg.simulation.judge import Outcome
from evo_cpg.training.checkpoint import Checkpoint
from evo_cpg.training.devices import chunk_width
from evo_cpg.training.experiment import Evaluated
from evo_cpg.training.replica import (
    Found,
    Given,
    Judged,
    Piece,
    PopulationCopy,
    Results,
    checksum,
    used_results,
)

if TYPE_CHECKING:
    from evo_cpg.training.train import Running


class Cluster(Protocol):
    """Engine that runs `Replica.evaluate` on workers, which are known by their names."""

    devices: int
    """Number of cores of all workers when the cluster was joined."""

    def begin(self, running: "Sequence[Running]", width: int) -> None:
        """Make a `Replica` of some experiments on every worker, and wait for the first workers."""
        ...

    def workers(self) -> dict[str, int]:
        """Return the number of cores of each worker that is ready. There is at least one."""
        ...

    def send(self, worker: str, pieces: Sequence[Piece]) -> None:
        """Send pieces to a worker that is free."""
        ...

    def receive(self) -> tuple[str, list[Found] | None]:
        """Wait for a worker. Return its results, or None if it was lost."""
        ...


_cluster: contextvars.ContextVar[Cluster | None] = contextvars.ContextVar("cluster", default=None)


@contextlib.contextmanager
def using(cluster: Cluster | None) -> Iterator[None]:
    """Evaluate all populations on a cluster in the ``with`` block, or in this process if None."""
    token = _cluster.set(cluster)
    try:
        yield
    finally:
        _cluster.reset(token)


def current_cluster() -> Cluster | None:
    """Return the cluster in use, if any."""
    return _cluster.get()


def device_count() -> int:
    """Return the number of cores that evaluate a population."""
    cluster = current_cluster()
    return cluster.devices if cluster else jax.local_device_count()


class Portion(NamedTuple):
    """Neighbouring individuals of one run of a running experiment."""

    running: "Running"
    run: int
    first: int
    last: int


class Team:
    """Coordinator of a cluster's workers. It knows what each of them holds.

    Args:
        cluster: the cluster.
        running: experiments with equal trials, of which some may be evaluated together.
    """

    def __init__(self, cluster: Cluster, running: "Sequence[Running]") -> None:
        self._cluster, self._running = cluster, list(running)
        # Generation of each population that a worker holds.
        self._held: dict[str, dict[tuple[int, int], int]] = {}
        # Workers whose processor rounds otherwise.
        self._foreign: set[str] = set()
        sizes = [each.checkpoint.genes.shape[1] * each.experiment.trials for each in running]
        self._used = [used_results(each.experiment) for each in running]
        cluster.begin(running, chunk_width(sum(sizes), cluster.devices))

    def evaluate(self, behind: "Sequence[Running]") -> list[Evaluated]:
        """Evaluate the next generation or round of some experiments."""
        self._numbers = {id(each): self._running.index(each) for each in behind}
        self._trials = {id(each): each.trials() for each in behind}
        self._digests = {
            (self._numbers[id(each)], run): checksum(population(each.checkpoint, run))
            for each in behind
            for run in range(each.experiment.runs)
        }
        workers = self._cluster.workers()
        self._held = {name: held for name, held in self._held.items() if name in workers}
        waiting = divided(behind, list(workers.values()))
        free, busy, done = list(workers), {}, []
        while waiting or busy:
            while free and waiting:
                worker, parts = free.pop(0), waiting.pop(0)
                self._cluster.send(worker, [self._piece(worker, part) for part in parts])
                busy[worker] = parts
            worker, found = self._cluster.receive()
            parts = busy.pop(worker, None)
            if parts is None:
                continue
            if found is None:
                waiting.append(parts)
                self._held.pop(worker, None)
                free = free or [name for name in self._cluster.workers() if name not in busy]
                continue
            free.append(worker)
            wrong = self._noted(worker, parts, found)
            done += [pair for pair in zip(parts, found, strict=True) if pair[0] not in wrong]
            if wrong:
                waiting.append(wrong)
        return [self._joined(each, done) for each in behind]

    def _piece(self, worker: str, part: Portion) -> Piece:
        """Return a part with all that a worker lacks."""
        running, run, first, last = part
        number = self._numbers[id(running)]
        checkpoint, experiment = running.checkpoint, running.experiment
        generation, news = checkpoint.generation, None
        held = self._held.get(worker, {}).get((number, run))
        own = slice(run, run + 1)
        scales = {name: np.array(each[own], np.float32) for name, each in checkpoint.scales.items()}
        if running.choosing:
            genes, keys, _ = self._trials[id(running)]
            start, trials = run * experiment.strategy.population, experiment.trials
            own = slice(start + first, start + last)
            keys = None if keys is None else keys[:, trials * own.start : trials * own.stop]
            news = Given(genes[:, own], keys)
        elif held == generation - 1 and running.worth and worker not in self._foreign:
            leaves = jax.tree.leaves(running.worth)
            _, used = self._used[number]
            news = Results(
                [leaf[run] if each else None for leaf, each in zip(leaves, used, strict=True)],
                scales,
            )
        elif held != generation:
            state = [np.asarray(leaf)[own] for leaf in jax.tree.leaves(running.state)]
            news = PopulationCopy(population(checkpoint, run), state, scales)
        judged = generation > 0 and not running.choosing
        return Piece(number, run, first, last, generation, judged, news)

    def _noted(self, worker: str, parts: list[Portion], found: list[Found]) -> list[Portion]:
        """Note what a worker holds now, and return the parts whose populations it bred otherwise.

        A processor of another kind may round otherwise. Such a worker gets whole populations.
        """
        held, wrong = self._held.setdefault(worker, {}), []
        for part, each in zip(parts, found, strict=True):
            place = self._numbers[id(part.running)], part.run
            if each.digest is None:
                continue
            if each.digest == self._digests[place]:
                held[place] = part.running.checkpoint.generation
            else:
                held.pop(place, None)
                self._foreign.add(worker)
                wrong.append(part)
        return wrong

    def _joined(self, running: "Running", done: list[tuple[Portion, Found]]) -> Evaluated:
        """Return the results of one experiment from those of its parts."""
        own = sorted(
            ((part, each.results) for part, each in done if part.running is running),
            key=lambda pair: pair[0][1:],
        )
        outcomes = [each for _, each in own if isinstance(each, Outcome)]
        if outcomes:
            return running.evaluated(
                jax.tree.map(lambda *arrays: np.concatenate(arrays, axis=-1), *outcomes)
            )
        like, _ = self._used[self._numbers[id(running)]]
        worth = jax.tree.map(lambda x: np.full(x.shape, np.nan, x.dtype), like)
        alive = np.ones(worth.fitness.shape, bool)
        for (_, run, first, last), results in own:
            assert isinstance(results, Judged)
            for leaf, given in zip(jax.tree.leaves(worth), results.worth, strict=True):
                if given is not None:
                    leaf[run, ..., first:last] = given
            for name, value in results.terms.items():
                worth.terms[name][run, first + results.best] = value
            alive[run, first:last] = np.unpackbits(results.alive, count=last - first)
        scales = running.checkpoint.scales
        scales = {name: np.array(each, np.float32) for name, each in scales.items()}
        return Evaluated(worth, alive, scales)


def population(checkpoint: Checkpoint, run: int) -> Float[np.ndarray, "g n"]:
    """Return the population of one run."""
    return np.split(checkpoint.genes, len(checkpoint.records), axis=1)[run]


def divided(behind: "Sequence[Running]", cores: Sequence[int]) -> list[list[Portion]]:
    """Return the parts of each worker, in proportion to the workers' cores.

    Parts end at whole vectors, because half a vector takes as long as a full vector.
    """
    sizes = [
        (each, run, each.experiment.strategy.population)
        for each in behind
        for run in range(each.experiment.runs)
    ]
    total = sum(size for _, _, size in sizes)
    ends = np.cumsum(cores) / sum(cores) * total
    ends = np.minimum(np.ceil(ends / LANES).astype(int) * LANES, total)
    parts: list[list[Portion]] = [[] for _ in cores]
    for number, (low, high) in enumerate(zip([0, *ends[:-1]], ends, strict=True)):
        before = 0
        for running, run, size in sizes:
            first, last = max(low - before, 0), min(high - before, size)
            if first < last:
                parts[number].append(Portion(running, run, int(first), int(last)))
            before += size
    return [each for each in parts if each]
