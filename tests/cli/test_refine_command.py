"""`evo-cpg refine`: the champion is better and can be verified."""

import csv
import shutil

import numpy as np
import pytest
import yaml

import evo_cpg as evo
from evo_cpg.api.refine import _rebuilt
from evo_cpg.io.load import load_config
from evo_cpg.io.parameters import parametrise
from evo_cpg.physics.water.fluid import Drag
from evo_cpg.training.run_folder import RunFolder, refinements
from tiny_run import CONFIG, REPOSITORY, TINY

QUICK = "--rounds", 1, "--steps", 3


@pytest.fixture(scope="module")
def refined(finished_run, cli, tmp_path_factory):
    folder = shutil.copytree(finished_run, tmp_path_factory.mktemp("refined") / "run")
    out, err = cli.passes("refine", folder, *QUICK, "--cores", 2)
    assert out == f"{folder}\n"
    return RunFolder(folder), err


@pytest.mark.slow
def test_the_champion_is_better_and_verified(refined, finished_run, cli):
    folder, err = refined
    before, after = (RunFolder(path).load_champion()[0] for path in (finished_run, folder.path))
    assert after.fitness > before.fitness
    assert f"fitness {before.fitness:.4f} -> {after.fitness:.4f}" in err
    assert "   1/1 rounds  fitness" in err
    code, out, err = cli("verify", folder.path)
    assert (code, err) == (0, "")
    assert out.endswith("is as recorded (exactly)\n")


@pytest.mark.slow
def test_the_folder_records_the_gain_and_keeps_the_earlier_champion(refined, finished_run):
    folder, _ = refined
    with (folder.path / "refine.csv").open() as file:
        (row,) = csv.DictReader(file)
    champion, motion, _ = folder.load_champion()
    assert float(row["fitness"]) == champion.fitness
    assert float(row["gain"]) > 0
    assert motion is not None
    before = folder.path / "champion_before.npz"
    with np.load(before) as kept, np.load(finished_run / "champion.npz") as began:
        assert set(kept) == set(began)
        for name in kept:
            np.testing.assert_array_equal(kept[name], began[name])
    (done,) = refinements(folder.read_meta())
    began = RunFolder(finished_run).load_champion()[0]
    assert (done["from"], done["to"]) == (pytest.approx(began.fitness), champion.fitness)
    assert done["command"][0] == "refine" and str(folder.path) in done["command"]


@pytest.mark.slow
def test_evolution_continues_from_the_refined_champion(refined, cli, tmp_path):
    folder = RunFolder(shutil.copytree(refined[0].path, tmp_path / "run"))
    done = folder.load()
    assert done is not None
    cli.passes("resume", folder.path, "--generations", done.generation + 1)
    last = folder.history()["best"][-1]
    np.testing.assert_allclose(last, done.champion.fitness, rtol=1e-4)


@pytest.mark.slow
def test_numbers_of_the_configuration_are_refined_with_the_genes(finished_run, cli, tmp_path):
    folder = RunFolder(shutil.copytree(finished_run, tmp_path / "run"))
    keys = "controller.cpg.time_scale", "creature.bodies.1.shape.size.0"
    before, first = yaml.safe_load(folder.config.read_text()), folder.load_champion()[0]
    found = evo.refine(folder.path, keys, rounds=1, steps=3, cores=2)
    assert found.gained and found.fitness > found.before
    after = yaml.safe_load(folder.config.read_text())
    scales = [made["controller"]["cpg"].pop("time_scale") for made in (before, after)]
    sizes = [made["creature"]["bodies"][1]["shape"]["size"] for made in (before, after)]
    assert scales[0] != scales[1] and sizes[0][0] != sizes[1][0]
    for key, value in zip(keys, (scales[1], sizes[1][0]), strict=True):
        assert found.numbers[key] == pytest.approx(value)
    # Nothing else of the configuration changed.
    sizes[1][0] = sizes[0][0]
    assert before == after
    kept = folder.path / "config_before.yaml"
    assert kept.read_bytes() == (finished_run / "config.yaml").read_bytes()
    assert folder.load_champion()[0].fitness > first.fitness
    code, out, err = cli("verify", folder.path)
    assert (code, err) == (0, "")
    assert out.endswith("(exactly)\n")


def test_a_forbidden_number_gives_no_experiment():
    key = "world.water.form_drag"
    config = load_config(CONFIG, TINY)
    parameters = parametrise(config, CONFIG, [key])
    assert _rebuilt(parameters, np.array([-0.1])) is None
    rebuilt = _rebuilt(parameters, np.array([0.7]))
    assert rebuilt is not None
    assert rebuilt.simulation.world.law(Drag).form_drag == 0.7


def test_an_unknown_number_is_named(finished_run, cli):
    assert "time_scale" in cli.refuses("refine", finished_run, "controller.cpg.time_scal")


@pytest.mark.slow  # 4 min: the backward pass of a walker on the ground
def test_refined_postures_stay_graded(cli, tmp_path):
    folder = RunFolder(tmp_path / "run")
    config = REPOSITORY / "configs" / "fukui2003_model1.yaml"
    settings = "simulation.seconds=2", "evolution.generations=3"
    cli.passes("train", config, *settings, "--out", folder.path)
    _, err = cli.passes("refine", folder.path, *QUICK)
    assert "the genes count as graded" in err
    genes = folder.load_champion()[0].genes
    assert ((genes > 0) & (genes < 1)).any()
    assert "graded: true" in folder.config.read_text()
    code, out, err = cli("verify", folder.path)
    assert (code, err) == (0, "")
    assert out.endswith("(exactly)\n")
