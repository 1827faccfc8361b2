"""Workers that each breed and evaluate a part give the bits of one process, whatever happens."""

import dataclasses
import pickle

import numpy as np
import pytest

from evo_cpg.evolution.genetics import RealGenetics
from evo_cpg.evolution.map_elites import AlongTheLine, MapElites
from evo_cpg.evolution.strategy import Axis
from evo_cpg.simulation.noise import Noise
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.experiment import Learning
from evo_cpg.training.replica import Judged, PopulationCopy, Replica, Results
from evo_cpg.training.team import using
from evo_cpg.training.train import train_together
from trials import evolve, experiment, folder_at, untimed

SIZE, GENERATIONS = 40, 4
GENETICS = RealGenetics(SIZE, 4, 0.5, 0.2, 0.5, 0.5, 8.0)
MADE = experiment(20, SIZE)._replace(strategy=GENETICS, generations=GENERATIONS)
LEXICASE = dataclasses.replace(GENETICS, selection="lexicase")
MAP = MapElites(SIZE, (Axis("distance", 1.0, 1.0004, 5),), AlongTheLine(0.3))
NOISY = dataclasses.replace(MADE.simulation, noise=Noise(joint_angle=0.1, push=0.2))
KINDS = {
    "three runs": MADE._replace(runs=3),
    "noise": MADE._replace(simulation=NOISY, runs=2, trials=2, generations=2),
    "map": MADE._replace(strategy=MAP),
    "lexicase": MADE._replace(strategy=LEXICASE, simulation=NOISY, trials=2, generations=2),
    "learning": MADE._replace(learning=Learning(2, 2, 2)),
}


class Workers:
    """Cluster of workers in this process, which computes when a result is received.

    Attributes:
        lost: names of workers that are lost at their next piece.
        pieces: every piece that was sent, with its worker.
    """

    devices = 2

    def __init__(self, *names: str) -> None:
        self.names, self.lost, self.pieces, self.sent = list(names), set(), [], []
        self.running = []

    def begin(self, running, width):
        self.running: list = list(running)
        made = [each.experiment for each in running]
        self.replicas = {name: Replica(made, width, population_mesh(1)) for name in self.names}

    def workers(self) -> dict[str, int]:
        return dict.fromkeys(self.names, 1)

    def send(self, worker, pieces):
        self.pieces += [(worker, piece) for piece in pieces]
        self.sent.append((worker, pieces))

    def receive(self):
        worker, pieces = self.sent.pop(0)
        if worker in self.lost:
            self.lost.remove(worker)
            self.names.remove(worker)
            return worker, None
        return worker, self.replicas[worker].evaluate(pieces)


def require_equal(one, other):
    np.testing.assert_array_equal(one.genes, other.genes)
    assert str(untimed(one.history)) == str(untimed(other.history))
    for mine, theirs in zip(one.champions, other.champions, strict=True):
        np.testing.assert_array_equal(mine.genes, theirs.genes)
        assert mine is not None and theirs is not None
        assert mine._replace(genes=None) == theirs._replace(genes=None)


SLOW = "map", "lexicase", "learning", "noise"


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[pytest.mark.slow] * (kind in SLOW)) for kind in KINDS]
)
@pytest.mark.slow
def test_a_team_has_the_bits_of_one_process(kind, tmp_path):
    _, alone = evolve(KINDS[kind], tmp_path / "alone")
    with using(Workers("a", "b", "c")):
        _, together = evolve(KINDS[kind], tmp_path / "together")
    require_equal(alone, together)


@pytest.mark.slow
def test_genomes_travel_once_and_fitness_is_small(tmp_path):
    workers = Workers("a", "b")
    with using(workers):
        evolve(MADE._replace(generations=9), tmp_path / "run")
    news = [type(piece.news) for _, piece in workers.pieces]
    assert news == [PopulationCopy] * 2 + [Results] * 16
    results = [piece for _, piece in workers.pieces[2:]]
    bare = results[0]._replace(news=results[0].news._replace(worth=[]))
    longest = max(len(pickle.dumps(piece)) for piece in results) - len(pickle.dumps(bare))
    # The fitness of a generation, and the few bytes that pickle adds to an array.
    assert longest <= 4 * SIZE + 200
    (found,) = workers.replicas["a"].evaluate([workers.pieces[-2][1]._replace(news=None)])
    judged = found.results
    assert isinstance(judged, Judged)
    assert sum(x.nbytes for x in judged.worth if x is not None) + judged.alive.nbytes <= 5 * SIZE


@pytest.mark.slow
def test_changing_workers_change_nothing(tmp_path):
    several = KINDS["three runs"]._replace(generations=6)
    _, alone = evolve(several, tmp_path / "alone")

    class Eventful(Workers):
        def send(self, worker, pieces):
            generation = pieces[0].generation
            if generation == 1 and worker == "a":
                self.lost.add(worker)
            if generation == 3 and "d" not in self.names:
                self.names.append("d")
                made = [each.experiment for each in self.running]
                self.replicas["d"] = Replica(made, 16, population_mesh(1))
            super().send(worker, pieces)

        def receive(self):
            worker, pieces = self.sent[0]
            worker, found = super().receive()
            if found and worker == "b" and isinstance(pieces[0].news, Results):
                found = [each._replace(digest=0, results=None) for each in found]
            return worker, found

    workers = Eventful("a", "b", "c")
    with using(workers):
        _, together = evolve(several, tmp_path / "together")
    require_equal(alone, together)
    of = {
        name: [piece for worker, piece in workers.pieces if worker == name]
        for name in workers.replicas
    }
    assert max(piece.generation for piece in of["a"]) == 1
    assert min(piece.generation for piece in of["d"]) == 4
    # The worker that rounds otherwise bred once. Since then it gets whole populations.
    assert 1 <= [type(piece.news) for piece in of["b"]].count(Results) <= 2


@pytest.mark.slow
def test_experiments_of_a_sweep_share_a_team(tmp_path):
    several = [MADE._replace(strategy=dataclasses.replace(GENETICS, elites=n)) for n in (1, 2, 3)]
    folders = [[folder_at(tmp_path / f"{name}{i}") for i in range(3)] for name in ("alone", "team")]
    alone = train_together(several, folders[0])
    with using(Workers("a", "b")):
        together = train_together(several, folders[1])
    for one, other in zip(alone, together, strict=True):
        require_equal(one, other)
