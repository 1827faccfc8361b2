"""`refine` leaves a run whose champion is better and verified like any other."""

import csv
import shutil

import numpy as np
import pytest

from evo_cpg.training.run_folder import RunFolder
from tiny_run import REPOSITORY

QUICK = "--rounds", 1, "--steps", 3


@pytest.fixture(scope="module")
def refined(finished_run, finish, tmp_path_factory):
    folder = shutil.copytree(finished_run, tmp_path_factory.mktemp("refined") / "run")
    code, out, err = finish("refine", folder, *QUICK, "--cores", 2)
    assert code == 0, err
    assert out == f"{folder}\n"
    return RunFolder(folder), err


def test_the_champion_is_better_and_verified(refined, finished_run, finish):
    folder, err = refined
    before, after = (RunFolder(path).load_champion()[0] for path in (finished_run, folder.path))
    assert after.fitness > before.fitness
    assert f"fitness {before.fitness:.4f} -> {after.fitness:.4f}" in err
    assert "round   1/1" in err
    code, out, err = finish("verify", folder.path)
    assert (code, err) == (0, "")
    assert out.endswith("comes out as recorded (exactly)\n")


def test_the_folder_tells_what_was_gained_and_what_was_there_before(refined, finished_run):
    folder, _ = refined
    with (folder.path / "refine.csv").open() as file:
        (row,) = csv.DictReader(file)
    champion, motion, _ = folder.load_champion()
    assert float(row["fitness"]) == champion.fitness
    assert float(row["gain"]) > 0
    assert motion is not None
    before = folder.path / "champion_before.npz"
    assert before.read_bytes() == (finished_run / "champion.npz").read_bytes()
    assert folder.read_meta()["refined"]


def test_evolution_goes_on_from_it(refined, finish, tmp_path):
    folder = RunFolder(shutil.copytree(refined[0].path, tmp_path / "run"))
    done = folder.load()
    assert done is not None
    code, _, err = finish("resume", folder.path, "--generations", done.generation + 1)
    assert code == 0, err
    last = folder.history()["best"][-1]
    np.testing.assert_allclose(last, done.champion.fitness, rtol=1e-4)


def test_what_is_no_run_is_refused(cli, tmp_path):
    code, out, err = cli("refine", tmp_path)
    assert (code, out) == (2, "")
    assert "is not a run folder" in err and "Traceback" not in err


@pytest.mark.slow  # 4 min: the backward pass of a walker on the ground
def test_postures_are_graded_from_then_on(finish, tmp_path):
    folder = RunFolder(tmp_path / "run")
    config = REPOSITORY / "configs" / "fukui2003_model1.yaml"
    settings = "simulation.steps=120", "evolution.generations=3"
    code, _, err = finish("train", config, *settings, "--out", folder.path)
    assert code == 0, err
    code, _, err = finish("refine", folder.path, *QUICK)
    assert code == 0, err
    assert "the genes are graded from now on" in err
    genes = folder.load_champion()[0].genes
    assert ((genes > 0) & (genes < 1)).any()
    assert "graded: true" in folder.config.read_text()
    code, out, err = finish("verify", folder.path)
    assert (code, err) == (0, "")
    assert out.endswith("(exactly)\n")
