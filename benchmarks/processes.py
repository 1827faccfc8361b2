"""Cost of evolution by several processes, and a prediction for many hosts.

    python -m benchmarks.processes

Processes of this machine exchange the results of a generation (`Team.gather`). An individual has 13
bytes, as with the swimmer: three terms, and whether it is valid. Nothing is simulated. The first
tenth of the rounds is left out. The program prints the median and the tenth percentile of the other
rounds. Other work on the machine disturbs the tenth percentile least, so the model is fitted to it:

    t(P, B) = a + b (P - 1) + c (P - 1) B

with P processes and B bytes in all, which the lead (process 0) sends to every other process. N
individuals per host, with trials of T seconds, then have an efficiency of

    T / (T + t(P, B) + d N P)

where d is the cost of the population's digest and of breeding, for each individual. It is measured
here in one process, because every process does this work for all individuals.

Assumptions: the lead sends as fast to other hosts as to processes of this machine. `--latency` and
`--bandwidth` of a network add to this. The slowest host sets the pace, but here all hosts are
equally fast and undisturbed. Every process has memory for all genomes.
"""

import argparse
import hashlib
import json
import socket
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np

from benchmarks.plan import experiment_of, random_genes
from evo_cpg.training.devices import use_cores
from evo_cpg.training.processes import ALONE, join
from evo_cpg.training.roll_call import Place

_PROCESSES = (1, 2, 3, 4)
_POPULATIONS = (200, 4096)
_HOSTS = (16, 64, 256)
_BYTES = 13

# The digest is measured separately, so the gathered data have hardly any genes.
_FEW_GENES = 1

_SIZES, _REPEATS = (4096, 32768), 12


class Exchange(NamedTuple):
    """Measurement of an exchange of a population's results among some processes.

    Attributes:
        processes: number of processes.
        population: number of individuals.
        size: bytes in all.
        median: median time of a round, s.
        tenth: tenth percentile of the time of a round, s.
    """

    processes: int
    population: int
    size: int
    median: float
    tenth: float


def main() -> None:
    """Measure, fit and predict, and print the tables. A worker only measures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=1000, help="exchanges in each measurement")
    parser.add_argument("--seconds", type=float, default=1.0, help="T: time of a host's trials, s")
    parser.add_argument("--individuals", type=int, default=200, help="N: individuals on each host")
    parser.add_argument("--latency", type=float, default=0.0, help="latency of the network, s")
    parser.add_argument(
        "--bandwidth", type=float, default=1e9, help="bandwidth of the network, bit/s"
    )
    parser.add_argument("--worker", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        index, count, port = map(int, options.worker)
        _work(index, count, port, options.rounds)
        return
    heads = ("processes", "population", "bytes", "median ms", "tenth ms")
    print(_columns(*heads))
    exchanges = []
    for count in _PROCESSES:
        for one in _measure(count, options.rounds):
            exchanges.append(one)
            times = f"{one.median * 1e3:.3f}", f"{one.tenth * 1e3:.3f}"
            print(_columns(count, one.population, one.size, *times))
    a, b, c = _fit([one for one in exchanges if one.processes > 1])
    b, c = b + options.latency, c + 8 / options.bandwidth
    genes, digest, breeding = _of_each()
    print(f"t = {a * 1e3:.3f} ms + {b * 1e3:.3f} ms (P - 1) + {c * 1e9:.2f} ns (P - 1) B")
    print(f"per individual ({genes} genes): ", end="")
    print(f"digest {digest * 1e6:.2f} us, breeding {breeding * 1e6:.2f} us")
    heads = ("hosts", "population", "gather ms", "digest ms", "breed ms", "efficiency", "genomes")
    print(_columns(*heads))
    for hosts in _HOSTS:
        population = hosts * options.individuals
        parts = (
            a + (hosts - 1) * (b + c * population * _BYTES),
            digest * population,
            breeding * population,
        )
        fraction = options.seconds / (options.seconds + sum(parts))
        memory = f"{population * genes * 4 / 2**20:.0f} MiB"
        times = (f"{part * 1e3:.1f}" for part in parts)
        print(_columns(hosts, population, *times, f"{fraction:.1%}", memory))


def _columns(*words: object) -> str:
    return " ".join(f"{word!s:>10}" for word in words)


def _fit(exchanges: list[Exchange]) -> tuple[float, float, float]:
    """Return the model's coefficients a (s), b (s) and c (s/byte), none of them negative."""
    from scipy.optimize import nnls

    rows = [(1.0, one.processes - 1, (one.processes - 1) * one.size) for one in exchanges]
    times = np.array([one.tenth for one in exchanges])
    # Fit relative errors, because absolute ones would count only the largest times.
    found, _ = nnls(np.array(rows) / times[:, None], np.ones(len(times)))
    return tuple(found.tolist())


def _measure(count: int, rounds: int) -> list[Exchange]:
    """Return the exchange of each population among new processes, as measured by the lead."""
    with socket.create_server(("", 0)) as server:
        port = server.getsockname()[1]
    command = [sys.executable, "-m", "benchmarks.processes", "--rounds", str(rounds), "--worker"]
    started = [
        subprocess.Popen(
            [*command, *map(str, (index, count, port))], stdout=subprocess.PIPE, text=True
        )
        for index in range(count)
    ]
    said = [process.communicate()[0] for process in started]
    return [Exchange(*row) for row in json.loads(said[0].splitlines()[-1])]


def _work(index: int, count: int, port: int, rounds: int) -> None:
    use_cores(1)
    place = Place(index, count, "localhost", port)
    team = join(place, {}, 60.0) if count > 1 else ALONE
    rows = []
    for population in _POPULATIONS:
        genes = np.ones((_FEW_GENES, population), np.float32)
        fraction = team.part(population)
        part = {name: np.zeros(fraction.stop - fraction.start, np.float32) for name in "abc"}
        part["alive"] = np.ones(fraction.stop - fraction.start, bool)
        times = []
        for generation in range(rounds):
            start = time.perf_counter()
            team.gather(part, genes, generation)
            times.append(time.perf_counter() - start)
        times = np.array(times[rounds // 10 :])
        median, tenth = np.quantile(times, (0.5, 0.1)).tolist()
        rows.append(Exchange(count, population, population * _BYTES + 8 * count, median, tenth))
    team.leave()
    print(json.dumps(rows), flush=True)


def _of_each() -> tuple[int, float, float]:
    """Return an individual's number of genes, and its costs of digest and breeding, s.

    The costs are the difference between two sizes of the population, per individual.
    """
    digests, breedings, count = [], [], 0
    for size in _SIZES:
        experiment = experiment_of("iwadate2010_swimmer", f"evolution.population={size}")
        genes = random_genes(experiment.simulation, size)
        count = len(genes)
        fitness = np.random.default_rng(0).random(size, np.float32)
        breed = jax.jit(experiment.strategy.next_generation)
        key = jax.random.key(0)
        breedings.append(_seconds(lambda: jax.device_get(breed(key, genes, fitness))))  # noqa: B023
        digests.append(_seconds(lambda: hashlib.sha256(genes.data).digest()))  # noqa: B023
    spread = _SIZES[1] - _SIZES[0]
    return count, (digests[1] - digests[0]) / spread, (breedings[1] - breedings[0]) / spread


def _seconds(work: Callable[[], object]) -> float:
    times = []
    for _ in range(_REPEATS):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return statistics.median(times[1:])


if __name__ == "__main__":
    main()
