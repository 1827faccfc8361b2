"""Map of bodies, and searches on it. `Valley` stands for the trials of the bodies."""

import numpy as np
import pytest

from evo_cpg.cli.repeat import make
from evo_cpg.io.build import build_experiment
from evo_cpg.studies import provenance
from evo_cpg.studies.bodies import STUDY, peaks
from evo_cpg.studies.body_map import RHYTHM, Family, grid, made_map
from evo_cpg.studies.body_searches import SCHEMES, Population, final_bodies, survivors
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.evaluate import compile_trials
from evo_cpg.training.run_folder import RunFolderError


class Valley(Family):
    """Bodies whose best rhythm has all genes equal to the body's first gene."""

    def __init__(self, cells=5):
        self.cells, self.genes, self.settings = cells, grid(cells), f"valley {cells}"

    def fitness(self, bodies, rhythms):
        genes = self.genes[bodies]
        missed = ((rhythms - genes[:, None, :1]) ** 2).mean(-1)
        return 1 - ((genes - 0.75) ** 2).sum(-1)[:, None] - missed


@pytest.fixture(scope="module")
def family():
    return Family(2, 1.0)


def ignore(*reached):
    """Ignore progress."""


@pytest.mark.slow
def test_fitness_of_a_body_is_that_alone(family):
    """The body alone is a creature of its own, with a program of its own."""
    rhythms = np.random.default_rng(0).random((8, 3, RHYTHM))
    together = family.fitness(np.arange(8), rhythms)
    alone = [family.fitness(np.array([i]), rhythms[i : i + 1])[0] for i in range(8)]
    np.testing.assert_array_equal(alone, together)
    body, number = np.unravel_index(together.argmax(), together.shape)
    layout = family.plans.layout
    graph = layout.unpack(family.genomes[:, body])
    control = np.broadcast_to(2 * rhythms[body, number] - 1, graph.control.shape)
    config, genes = family.plans.alone(np.asarray(layout.pack(graph._replace(control=control))))
    short = config.simulation.model_copy(update={"seconds": 1.0})
    config = config.model_copy(update={"simulation": short})
    simulation = build_experiment(config, "x.yaml").simulation
    outcome = compile_trials(simulation, population_mesh(1))(genes[:, None].astype(np.float32))
    np.testing.assert_allclose(outcome.terms["distance"], together.max(), rtol=1e-3)


@pytest.mark.slow
def test_quick_study_makes_picture_and_tables(tmp_path):
    make(STUDY, list(STUDY.parts), tmp_path, True, False, 2)
    assert (tmp_path / "map.png").is_file() and provenance.problems(tmp_path) == []
    assert "| bodies | 27 |" in (tmp_path / "map.md").read_text()
    assert "| random search | " in (tmp_path / "searches.md").read_text()


def test_interrupted_map_continues_to_the_same_file(tmp_path):
    def stop(done, total):
        if done > total / 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        made_map(tmp_path / "a.npz", Valley(), 4, stop)
    with np.load(tmp_path / "a.npz") as half:
        assert np.isnan(half["fitness"]).sum() == 50
    reached = []
    found = made_map(tmp_path / "a.npz", Valley(), 4, lambda *done: reached.append(done))
    assert reached[0] == (25, 125) and reached[-1] == (125, 125)
    made_map(tmp_path / "b.npz", Valley(), 4, ignore)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    assert Valley().genes[found.fitness.argmax()].tolist() == [0.75] * 3
    with pytest.raises(RunFolderError, match="other settings"):
        made_map(tmp_path / "a.npz", Valley(), 5, ignore)


def test_nearest_body_has_the_nearest_genes():
    family, genes = Valley(), np.random.default_rng(0).random((50, 3))
    apart = np.linalg.norm(family.genes[None] - genes[:, None], axis=-1)
    np.testing.assert_array_equal(family.nearest(genes), apart.argmin(1))


@pytest.mark.parametrize("scheme", SCHEMES[:-1], ids=lambda scheme: scheme.name)
def test_evolving_searches_end_at_the_best_body(scheme):
    body, fitness = final_bodies(Valley(), scheme, 6, 20, 2000, 0)
    hits = np.linalg.norm(Valley().genes[body] - 0.75, axis=-1) < 0.1
    assert hits.all() and (fitness > 0.95).all()


def test_protection_keeps_the_best_of_each_age():
    fitness, age = np.array([[3.0, 2.0, 1.0, 2.5, 3.0]]), np.array([[5, 3, 0, 3, 6]])
    genes = np.arange(5.0)[None, :, None]
    both = Population(genes, genes, fitness, age)
    assert survivors(both, 3, True).body[0, :, 0].tolist() == [0, 3, 2]
    assert survivors(both, 3, False).body[0, :, 0].tolist() == [0, 4, 3]


def test_peaks_are_better_than_all_neighbours():
    fitness = np.zeros((3, 3, 3))
    fitness[0, 0, 0], fitness[1, 1, 1], fitness[1, 1, 2] = 1, 2, 3
    assert peaks(fitness) == 2
