"""`evo-cpg render`: cameras, signals, the lineage of a run, and runs side by side."""

import shutil

import numpy as np
import pytest
from PIL import Image

from evo_cpg.training.run_folder import RunFolder
from tiny_run import CONFIG, PAIR

SMALL = ("--size", "96x54", "--seconds", "0.2")


@pytest.fixture(scope="module")
def film(cli, tmp_path_factory):
    """Return a function that makes a picture and returns its size and the messages."""
    place = tmp_path_factory.mktemp("pictures") / "a.png"

    def made(*arguments):
        code, out, err = cli("render", *SMALL, *arguments, "-o", place)
        assert (code, out) == (0, f"{place}\n"), err
        with Image.open(place) as picture:
            return picture.size, err

    return made


@pytest.fixture(scope="module")
def two_runs(cli, tmp_path_factory):
    folder = tmp_path_factory.mktemp("two") / "run"
    overrides = (*PAIR, "runs=2", "evolution.generations=5", "simulation.seconds=0.5")
    cli.passes("train", CONFIG, *overrides, "--out", folder, "--cores", 2)
    return folder


def test_the_lineage_of_a_run_is_in_its_folder(two_runs):
    folder = RunFolder(two_runs)
    lineage, checkpoint = folder.load_lineage(), folder.load()
    assert {each.run for each in lineage} == {0, 1}
    for run in (0, 1):
        own = [each for each in lineage if each.run == run]
        rows = [row for row in checkpoint.history if row["run"] == run]
        assert own[0].generation == 0
        # The lineage has one champion for each generation that found a better one.
        best = [row["champion"] for row in rows]
        better = [0] + [g for g in range(1, len(best)) if best[g] > best[g - 1]]
        assert [each.generation for each in own] == better
        assert [each.fitness for each in own] == [best[g] for g in better]
        np.testing.assert_array_equal(own[-1].genes, checkpoint.champions[run].genes)


@pytest.mark.slow
def test_a_lineage_is_shown_side_by_side(film, two_runs):
    lineage = RunFolder(two_runs).load_lineage()
    count = {run: sum(each.run == run for each in lineage) for run in (0, 1)}
    size, err = film(two_runs, "--lineage", "0", "--run", 1)
    assert size == (96, 54) and err == ""
    best = RunFolder(two_runs).load().champion.run
    size, err = film(two_runs, "--lineage", "auto")
    columns = {1: 1, 2: 2, 3: 3}.get(count[best], 2)
    assert size[0] == 100 * columns - 4 and err == ""
    # No champion is shown twice.
    last = [each.generation for each in lineage if each.run == best][-1]
    size, _ = film(two_runs, "--lineage", f"{last},{last},4", "--signals", "--size", "160x110")
    assert size == (160, 110)


@pytest.mark.slow
def test_lineage_selects_generations_by_number(film, two_runs):
    lineage = RunFolder(two_runs).load_lineage()
    own = {run: [each.generation for each in lineage if each.run == run] for run in (0, 1)}
    run, found = max(own.items(), key=lambda item: len(item[1]))
    assert len(found) > 1
    size, _ = film(two_runs, "--lineage", f"{found[0]},{found[1]}", "--run", run)
    assert size == (196, 54)


@pytest.mark.slow
def test_several_runs_are_shown_side_by_side(film, two_runs, finished_run):
    size, _ = film(two_runs, "--beside", finished_run, "--beside", two_runs, "--camera", "orbit")
    assert size == (296, 54)
    named, _ = film(two_runs, "--beside", finished_run, "--title", "small", "--title", "long")
    assert named == (196, 54)


@pytest.mark.slow
def test_the_name_of_a_film_contains_its_options(cli, finished_run, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(finished_run, run)
    for options, name in (
        (("--signals", "--size", "160x110"), "champion_signals.mp4"),
        (("--lineage", "0", "--camera", "orbit"), "lineage_orbit.mp4"),
        (("--beside", finished_run), "champion_beside_others.mp4"),
    ):
        code, out, err = cli("render", run, *SMALL, *options, "--fps", 5)
        assert (code, out) == (0, f"{run / 'videos' / name}\n"), err


@pytest.mark.slow
def test_a_replay_with_another_fitness_is_a_warning(film, two_runs, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(two_runs, run)
    lineage = RunFolder(run).load_lineage()
    RunFolder(run).save_lineage([each._replace(fitness=each.fitness + 1) for each in lineage])
    _, err = film(run, "--lineage", "0")
    assert "the champion of generation 0 replays with" in err and "as recorded" in err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--lineage", "first"), "neither auto, ancestors nor a list"),
        (("--lineage", "0,1,2,3,4,5,6,7,8,9"), "10 generations are too many"),
        (("--lineage", "auto", "--cell", "0"), "--lineage and --cell exclude"),
        (("--lineage", "auto", "--beside"), "--lineage and --beside exclude"),
        (("--lineage", "auto", "--title", "a"), "--lineage and --title exclude"),
        (("--lineage", "5"), "The last is 4"),
        (("--title", "a", "--title", "b"), "Give one for each"),
        (("--beside",) * 10, "11 runs are too many"),
        (("--signals", "--size", "100x90"), "160 x 110"),
    ],
)
def test_wrong_options_are_refused(cli, two_runs, options, words):
    given = [each for word in options for each in (word, two_runs)[: 1 + (word == "--beside")]]
    assert words in cli.refuses("render", two_runs, *given)


def test_a_damaged_lineage_is_refused(cli, two_runs, tmp_path):
    folder = RunFolder(shutil.copytree(two_runs, tmp_path / "run"))
    run, lineage = folder.path, folder.load_lineage()
    folder.save_lineage([each._replace(generation=3) for each in lineage[:1]])
    assert "is from generation 3" in cli.refuses("render", run, "--lineage", "2", "--run", 0)
    assert "has no champion of run 1" in cli.refuses("render", run, "--lineage", "auto", "--run", 1)
    other = lineage[0]._replace(genes=lineage[0].genes[1:])
    folder.save_lineage([other])
    err = cli.refuses("render", run, "--lineage", "0", "--run", 0)
    assert "lineage.npz: generation 0: the genome has" in err
