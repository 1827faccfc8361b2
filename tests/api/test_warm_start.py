"""A run can begin where another run ended."""

import json
import shutil

import numpy as np
import pytest

import evo_cpg as evo
from evo_cpg.api.run_start import begin_run, warm_start
from evo_cpg.io.run import Run
from evo_cpg.training.run_folder import RunFolder, RunFolderError
from tiny_run import CONFIG, PAIR

SHORT = (*PAIR, "simulation.seconds=0.3333", "evolution.generations=2", "runs=2")


@pytest.fixture(scope="module")
def earlier(tmp_path_factory):
    """Return two evolved runs, with a population of eight each."""
    folder = tmp_path_factory.mktemp("earlier") / "run"
    return evo.train(evo.load(CONFIG, SHORT), folder)


def start(earlier, what, *settings):
    experiment = evo.load(CONFIG, (*SHORT, *settings)).parts
    return experiment, warm_start(experiment, earlier.folder, what)


def checkpoint_of(earlier):
    found = RunFolder(earlier.folder).load()
    assert found is not None
    return found


@pytest.mark.slow
def test_each_run_begins_with_its_own_champion(earlier):
    _, (genes, provenance) = start(earlier, "champion", "seed=7", "world.water.density=900")
    assert genes.shape == (evo.load(CONFIG, SHORT).gene_count, 16)
    for run, champion in enumerate(checkpoint_of(earlier).champions):
        own = genes[:, 8 * run : 8 * run + 8]
        np.testing.assert_array_equal(own[:, 0], champion.genes)
        changed = (own[:, 1:] != champion.genes[:, None]).mean()
        # The fraction of changed genes fits the mutation rate.
        assert 0.02 < changed < 0.2
    assert provenance["from"] == str(earlier.folder.resolve())
    assert provenance["what"] == "champion" and provenance["fitness"] == earlier.fitness


@pytest.mark.slow
@pytest.mark.parametrize("size", [4, 8, 12])
def test_a_population_is_cut_or_filled(earlier, size):
    _, (genes, provenance) = start(earlier, "population", f"evolution.population={size}")
    done = checkpoint_of(earlier)
    kept = min(size, 8)
    for run in range(2):
        own, before = genes[:, size * run :][:, :size], done.genes[:, 8 * run : 8 * run + 8]
        np.testing.assert_array_equal(own[:, :kept], before[:, :kept])
        assert np.isfinite(own).all()
    assert provenance["generation"] == 2


@pytest.mark.slow
def test_more_runs_all_begin_with_the_best_champion(earlier):
    _, (genes, _) = start(earlier, "champion", "runs=3")
    for run in range(3):
        np.testing.assert_array_equal(genes[:, 8 * run], earlier.genome)


@pytest.mark.slow
def test_the_start_is_the_first_population_even_after_a_kill(earlier, tmp_path):
    """The run may be killed before its first generation is done."""
    experiment, given = start(earlier, "population", "seed=3")
    folder = RunFolder(tmp_path / "run")
    config = evo.load(CONFIG, (*SHORT, "seed=3"))
    begin_run(Run(folder, config.config, experiment), 2, CONFIG, given)
    assert json.loads(folder.meta.read_text())["start"] == given.provenance
    np.testing.assert_array_equal(RunFolder(folder.path).load_start(), given.genes)
    from evo_cpg.training.train import train

    train(experiment._replace(generations=1), RunFolder(folder.path))
    resumed = train(experiment, RunFolder(folder.path))
    made = evo.train(config, tmp_path / "again", start=given.genes.T)
    np.testing.assert_array_equal(resumed.champion.genes, made.genome)
    # The population has the elites, so the first generation is as good as the last.
    first = max(row["best"] for row in made.history[:2])
    assert first == pytest.approx(earlier.fitness, rel=0.2)


def test_another_plan_is_refused(earlier, tmp_path):
    other = evo.load(CONFIG, (*SHORT, "creature.bodies.1.repeat=2")).parts
    with pytest.raises(RunFolderError, match=r"animals of another plan\. Its bodies"):
        warm_start(other, earlier.folder, "champion")
    other = evo.load(CONFIG, (*SHORT, "controller.brain.hidden=[5]")).parts
    with pytest.raises(RunFolderError, match=r"Its genes: \d+\. Requested: \d+"):
        warm_start(other, earlier.folder, "champion")
    with pytest.raises(RunFolderError, match="is not a run folder"):
        warm_start(other, tmp_path, "champion")


def test_a_run_without_a_champion_is_refused(earlier, tmp_path):
    started = shutil.copytree(earlier.folder, tmp_path / "started")
    shutil.rmtree(started / "checkpoints")
    (started / "checkpoints").mkdir()
    with pytest.raises(RunFolderError, match="has no champion yet"):
        warm_start(evo.load(CONFIG, SHORT).parts, started, "champion")


def test_genomes_that_do_not_fit_are_refused(tmp_path):
    experiment = evo.load(CONFIG, SHORT)
    genes = experiment.gene_count
    with pytest.raises(ValueError, match=rf"start must have the shape \(16, {genes}\), a row"):
        evo.train(experiment, tmp_path / "a", start=np.zeros((8, genes)))
    with pytest.raises(ValueError, match="start must be finite"):
        evo.train(experiment, tmp_path / "b", start=np.full((16, genes), np.nan))
    assert not (tmp_path / "a").exists()


def test_a_damaged_or_missing_start_is_named(earlier, tmp_path):
    _, given = start(earlier, "champion")
    folder = RunFolder(tmp_path / "run")
    folder.create("", {"start": "from the champion of x"}, given.genes)
    folder.start.write_bytes(folder.start.read_bytes()[:100])
    with pytest.raises(RunFolderError, match=r"start\.npz is damaged .*\. Start a new run"):
        folder.load_start()
    for wrong in (given.genes[0], np.full_like(given.genes, np.nan)):
        np.savez(folder.start, genes=wrong)
        with pytest.raises(RunFolderError, match=r"start\.npz is damaged \(it holds no genomes\)"):
            folder.load_start()
    folder.start.unlink()
    with pytest.raises(RunFolderError, match=r"start\.npz is missing\..* \(from the champion"):
        folder.load_start()
