"""`evo-cpg render --story`: a film, and populations that are made anew."""

import shutil
import subprocess

import imageio_ffmpeg
import numpy as np
import pytest

import evo_cpg as evo
from evo_cpg.api.story import generations_of
from evo_cpg.errors import Advice
from evo_cpg.io.run import open_run
from evo_cpg.training.crowd import compile_crowd_motion, populations_at
from evo_cpg.training.run_folder import RunFolderError
from tiny_run import CONFIG, PAIR


@pytest.fixture(scope="module")
def run(cli, tmp_path_factory):
    folder = tmp_path_factory.mktemp("told") / "run"
    overrides = (*PAIR, "evolution.generations=6", "simulation.seconds=1")
    cli.passes("train", CONFIG, *overrides, "--out", folder, "--cores", 2)
    return folder


def decoded(path):
    """Return all bytes of the frames of a film."""
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-i", str(path)]
    command += ["-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    return np.frombuffer(subprocess.run(command, capture_output=True, check=True).stdout, np.uint8)


@pytest.mark.parametrize(
    ("done", "champion", "shown"),
    [(50, 37, [0, 2, 7]), (50, 7, [0, 2]), (3, 2, [0, 1]), (1, 0, [0]), (1000, 900, [0, 5, 31])],
)
def test_a_story_shows_early_generations(done, champion, shown):
    assert generations_of(done, champion) == shown


@pytest.mark.slow
def test_a_story_is_a_film(cli, run, tmp_path):
    film = tmp_path / "a.mp4"
    code, out, err = cli("render", run, "--story", "--size", "160x90", "-o", film)
    assert (code, out, err) == (0, f"{film}\n", "")
    frames = decoded(film).reshape(-1, 90, 160, 3).astype(int)
    assert len(frames) == 15 * 30
    # The takes show different pictures.
    for one, two in ((100, 300), (300, 440)):
        assert np.abs(frames[one] - frames[two]).max() > 40


@pytest.mark.slow
def test_a_crowd_is_filmed(cli, run, tmp_path):
    place = tmp_path / "a.png"
    size = "--size", "96x54"
    code, out, err = cli("render", run, "--crowd", 3, *size, "-o", place)
    assert (code, out, err) == (0, f"{place}\n", "")
    assert "has 6 generations" in cli.refuses("render", run, "--crowd", 7, *size, "-o", place)


@pytest.mark.slow
def test_a_story_without_crowds_says_so(run, tmp_path):
    """The recorded results are not those of the configuration."""
    other = shutil.copytree(run, tmp_path / "other")
    text = (other / "config.yaml").read_text()
    (other / "config.yaml").write_text(text.replace("seed: 0", "seed: 1", 1))
    film = tmp_path / "a.mp4"
    with pytest.warns(Advice, match="cannot be made anew"):
        assert evo.story(other, film, (96, 54)) == film


@pytest.mark.slow
def test_a_population_is_made_anew_from_the_seed(run):
    opened = open_run(run)
    experiment, folder = opened.experiment, opened.folder
    fifth, sixth = populations_at(experiment, folder, [5, 6])
    kept = folder.load()
    assert kept is not None
    np.testing.assert_array_equal(sixth, kept.genes)
    with np.load(folder.path / "checkpoints" / "generation_000005.npz") as earlier:
        np.testing.assert_array_equal(fifth, earlier["genes"])
    (first,) = populations_at(experiment, folder, [0])
    (best, *_) = folder.load_lineage()
    assert best.generation == 0 and (first[:, best.index] == best.genes).all()
    other = experiment._replace(seed=1)
    with pytest.raises(RunFolderError, match="cannot be made anew"):
        populations_at(other, folder, [0, 1])


@pytest.mark.slow
def test_an_animal_of_a_crowd_moves_as_when_it_is_replayed(run):
    opened = open_run(run)
    champion = opened.folder.load_lineage()[0]
    (replay,) = opened.replay([champion], 0)
    (genes,) = populations_at(opened.experiment, opened.folder, [0])
    rate = opened.experiment.simulation.control_rate
    crowd = compile_crowd_motion(opened.experiment, 0.8, rate)(genes, 0)
    motion, instants = replay.recording, len(crowd.time)
    np.testing.assert_allclose(crowd.time, motion.time[:instants])
    np.testing.assert_allclose(
        crowd.position[:, champion.index], motion.position[:instants], atol=1e-4
    )
    np.testing.assert_array_equal(crowd.goal, motion.goal)
