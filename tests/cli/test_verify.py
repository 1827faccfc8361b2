"""`evo-cpg verify`: it accepts an unchanged run, and names every change."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from evo_cpg.io import run
from evo_cpg.training import evaluate, train
from evo_cpg.training.checkpoint import Checkpoint, genes_digest, outcome_digest
from evo_cpg.training.run_folder import RunFolder
from tiny_run import GENERATIONS


@pytest.fixture
def copied_run(finished_run, tmp_path) -> RunFolder:
    """Return a copy of a finished run."""
    return RunFolder(shutil.copytree(finished_run, tmp_path / "run"))


@pytest.fixture
def without_replay(finished_run, monkeypatch):
    """Make each replay return the record of the unchanged run, for tests without a replay."""
    champion, motion, _ = RunFolder(finished_run).load_champion()
    replay = evaluate.Replay(champion.fitness, champion.terms, {}, motion)
    monkeypatch.setattr(run, "compile_replay", lambda *_: lambda _: replay)


def alter(folder: RunFolder, **arrays: object) -> None:
    """Overwrite arrays of champion.npz."""
    with np.load(folder.champion) as file:
        kept = dict(file)
    np.savez(folder.champion, **kept | arrays)


def complaints(err: str, folder: Path) -> list[str]:
    """Check that each difference is one line with the run, and return the differences."""
    lines = err.splitlines()
    start = f"evo-cpg: {folder}: "
    assert all(line.startswith(start) for line in lines)
    return [line.removeprefix(start) for line in lines]


def test_an_unchanged_run_is_verified_exactly(finished_run, cli):
    champion, _, _ = RunFolder(finished_run).load_champion()
    code, out, err = cli("verify", finished_run)
    assert (code, err) == (0, "")
    assert out == (
        f"{finished_run}: the champion's fitness {champion.fitness:.6f} is as recorded (exactly)\n"
    )


def test_a_changed_config_is_found_by_digest_and_by_replay(copied_run, cli):
    config = yaml.safe_load(copied_run.config.read_text())
    config["world"]["water"]["density"] *= 0.8
    copied_run.config.write_text(yaml.safe_dump(config))
    code, out, err = cli("verify", copied_run.path)
    assert (code, out) == (3, "")
    found = complaints(err, copied_run.path)
    assert found[0] == "config.yaml has changed since the champion evolved"
    assert any(line.startswith("energy: recorded 0.") and "replayed 0." in line for line in found)


def test_genes_changed_with_all_digests_are_found_by_replay(copied_run, cli):
    champion, _, _ = copied_run.load_champion()
    genes = -champion.genes
    alter(copied_run, genes=genes, genes_sha256=genes_digest(genes))
    shutil.rmtree(copied_run.path / "checkpoints")
    code, out, err = cli("verify", copied_run.path)
    assert (code, out) == (3, "")
    found = complaints(err, copied_run.path)
    assert found[0].startswith("fitness: recorded ")
    assert not any("champion.npz" in line for line in found)


def test_one_changed_gene_is_found(copied_run, cli, without_replay):
    champion, _, _ = copied_run.load_champion()
    genes = champion.genes.copy()
    genes[3] = np.nextafter(genes[3], np.float32(9))
    alter(copied_run, genes=genes)
    code, _, err = cli("verify", copied_run.path)
    assert code == 3
    assert complaints(err, copied_run.path) == [
        "champion.npz: the genome differs from the evolved genome",
        "champion.npz: the genome differs from the newest checkpoint",
    ]
    alter(copied_run, genes_sha256=genes_digest(genes))
    code, _, err = cli("verify", copied_run.path)
    assert code == 3
    assert complaints(err, copied_run.path) == [
        "champion.npz: the genome differs from the newest checkpoint"
    ]


@pytest.mark.parametrize("name", ["fitness", "term.energy", "term.distance"])
@pytest.mark.parametrize("digest", [False, True])
def test_changed_fitness_and_terms_are_found(copied_run, cli, without_replay, name, digest):
    champion, _, _ = copied_run.load_champion()
    value = {"fitness": champion.fitness, **champion.terms}[name.removeprefix("term.")]
    alter(copied_run, **{name: 0.9 * value})
    if digest:
        alter(copied_run, outcome_sha256=outcome_digest(copied_run.load_champion()[0]))
    code, _, err = cli("verify", copied_run.path)
    assert code == 3
    found = complaints(err, copied_run.path)
    assert ("fitness or terms differ from the recorded values" in found[0]) == (not digest)
    assert "champion.npz: fitness or terms differ from the newest checkpoint" in found
    short = name.removeprefix("term.")
    assert found[-1] == f"{short}: recorded {0.9 * value:.6g}, replayed {value:.6g}"


def test_a_genome_of_another_size_cannot_be_replayed(copied_run, cli):
    alter(copied_run, genes=np.zeros(3, np.float32))
    code, _, err = cli("verify", copied_run.path)
    assert code == 3
    assert "the genome has 3 genes" in complaints(err, copied_run.path)[-1]
    assert "the genome has 3 genes" in cli.refuses("render", copied_run.path)


def test_a_run_without_finite_fitness_is_an_error(copied_run, cli, monkeypatch):
    dead = Checkpoint(20, np.zeros((1, 8), np.float32), (None,), [], {})
    monkeypatch.setattr(train, "train", lambda *_, **__: dead)
    err = cli.refuses("resume", copied_run.path, "--generations", GENERATIONS + 1)
    assert err.count("\n") == 1
    assert "every individual of every generation diverged, so there is no champion. Try" in err
    row = {"generation": 0, "diverged": 7}
    monkeypatch.setattr(train, "train", lambda *_, **__: dead._replace(history=[row]))
    err = cli.refuses("resume", copied_run.path, "--generations", GENERATIONS + 2)
    assert err.count("\n") == 1
    assert "no individual has a finite fitness, so there is no champion. Check" in err
