"""Run folders: files are read back, or skipped, after a kill at any moment."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evo_cpg.files import OutputError, read_json
from evo_cpg.simulation.recording import Recording
from evo_cpg.training import run_folder
from evo_cpg.training.checkpoint import Champion, Checkpoint, genes_digest, outcome_digest
from evo_cpg.training.run_folder import RunFolder, RunFolderError

CHAMPION = Champion(
    np.array([0.25, -1.5], np.float32), -0.5, 1, {"distance": 0.75}, {"energy": 3.0}, 0, 3
)

PLACE, DOF = np.ones((2, 1, 3)), np.ones((2, 1))
RECORDING = Recording(
    *(np.arange(2) / 60, PLACE, np.ones((2, 1, 3, 3)), DOF, DOF, DOF, DOF),
    distance=np.ones(2),
    light=np.ones((2, 3)),
    dof_names=("tail.z",),
)


def checkpoint(done: int, *champions: Champion | None) -> Checkpoint:
    """Return a checkpoint after a number of generations."""
    rows = [{"generation": i, "best": -1.0 / (i + 1), "diverged": i} for i in range(done)]
    genes = np.full((2, 4), done, np.float32)
    champions = champions or (CHAMPION,)
    return Checkpoint(done, genes, champions, rows, {"energy": (3.0,) * len(champions)})


def assert_same(given: Checkpoint | None, expected: Checkpoint) -> None:
    """Check that two checkpoints are equal to the last bit and type."""
    assert given is not None
    np.testing.assert_array_equal(given.genes, expected.genes)
    assert given.genes.dtype == expected.genes.dtype
    assert (given.generation, given.history, given.scales) == (
        expected.generation,
        expected.history,
        expected.scales,
    )
    for champion, other in zip(given.champions, expected.champions, strict=True):
        assert (champion is None) == (other is None)
        if champion and other:
            np.testing.assert_array_equal(champion.genes, other.genes)
            assert champion[1:] == other[1:]


def files(folder: RunFolder) -> set[str]:
    """Return the paths of all files of a folder."""
    return {str(p.relative_to(folder.path)) for p in folder.path.rglob("*") if p.is_file()}


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    """Return the folder of a new run."""
    made = RunFolder(tmp_path / "runs" / "a")
    made.create("name: a\n", {"seed": 3})
    return made


def test_a_new_folder_holds_its_config_and_meta(folder):
    assert files(folder) == {"config.yaml", "meta.json"}
    assert folder.config.read_text() == "name: a\n"
    assert folder.read_meta() == {"seed": 3}
    folder.update_meta(devices=2)
    assert json.loads(folder.meta.read_text()) == {"seed": 3, "devices": 2}
    folder.require()
    assert folder.load() is None
    with pytest.raises(RunFolderError, match="no finished generation"):
        folder.history()
    with pytest.raises(RunFolderError, match="no champion yet"):
        folder.load_champion()


@pytest.mark.parametrize("champion", [CHAMPION, None])
def test_checkpoints_are_read_back_exactly(folder, champion):
    for done in (1, 2, 3):
        folder.save(checkpoint(done, champion))
        assert_same(folder.load(), checkpoint(done, champion))
    kept = {"checkpoints/generation_000002.npz", "checkpoints/generation_000003.npz"}
    made = {"champion.npz"} if champion else set()
    assert files(folder) == {"config.yaml", "meta.json", "metrics.csv"} | kept | made
    with folder.metrics.open() as file:
        assert [int(row["generation"]) for row in csv.DictReader(file)] == [0, 1, 2]
    np.testing.assert_array_equal(folder.history()["best"], [-1, -1 / 2, -1 / 3])


def test_metrics_equal_the_history_after_any_earlier_table(folder):
    rows = checkpoint(4).history
    other = [{**row, "diverged": 9} for row in rows]
    for history in (rows[:1], rows[:3], rows, rows[:2], other, other[:1], rows):
        folder.write_metrics(history)
        with folder.metrics.open() as file:
            found = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
        assert found == history


def test_a_column_may_have_any_name(folder):
    folder.write_metrics([{"generation": 0, 'best_"a", b\nc': 1.5}])
    with folder.metrics.open(newline="") as file:
        assert list(csv.DictReader(file)) == [{"generation": "0", 'best_"a", b\nc': "1.5"}]


def test_a_growing_history_is_saved_completely(folder):
    """Known columns are extended, not converted again. Integers may become real numbers."""
    rows = [{"generation": i, "best": i if i < 3 else i + 0.5, "worst": -1.0} for i in range(8)]
    for done in (1, 2, 4, 5, 8):
        given = Checkpoint(done, np.zeros((2, 3)), (None,), rows[:done], {})
        folder.save(given)
        found = folder.load()
        assert found is not None and found.history == rows[:done]
    other = [{"generation": 0, "best": 7.0, "worst": 3.0}]
    folder.save(Checkpoint(9, np.zeros((2, 3)), (None,), other, {}))
    found = folder.load()
    assert found is not None and found.history == other


def test_the_champion_is_the_best_of_all_runs(folder):
    for champions in ((None, None), (CHAMPION, None), (None, CHAMPION)):
        folder.save(checkpoint(2, *champions))
        assert_same(folder.load(), checkpoint(2, *champions))
        assert folder.champion.exists() == any(champions)
    better = CHAMPION._replace(fitness=-0.25, run=2)
    folder.save(checkpoint(2, CHAMPION, None, better, better._replace(run=3)))
    assert folder.load_champion()[0].run == 2


def test_the_champion_is_read_back_with_its_motion_and_digests(folder):
    folder.save_champion(CHAMPION)
    assert folder.load_champion()[1] is None
    folder.save_champion(CHAMPION, RECORDING)
    champion, motion, digests = folder.load_champion()
    np.testing.assert_array_equal(champion.genes, CHAMPION.genes)
    assert champion[1:] == CHAMPION[1:]
    assert motion is not None and motion.dof_names == ("tail.z",)
    for name in set(Recording._fields) - {"dof_names"}:
        np.testing.assert_array_equal(getattr(motion, name), getattr(RECORDING, name))
    assert digests == {
        "config_sha256": folder.config_digest(),
        "genes_sha256": genes_digest(CHAMPION.genes),
        "outcome_sha256": outcome_digest(CHAMPION),
    }


def test_the_digest_covers_all_recorded_results():
    changes = {"fitness": -0.4999, "generation": 2}
    changes |= {"terms": {"distance": 0.7501}, "scales": {"energy": 3.001}}
    for name, value in changes.items():
        assert outcome_digest(CHAMPION) != outcome_digest(CHAMPION._replace(**{name: value}))


def damaged(whole: bytes) -> list[bytes]:
    """Return damaged contents: cut off or with a flipped byte at many places, zeros, and text."""
    places = range(0, len(whole), max(1, len(whole) // 60))
    flipped = [whole[:i] + bytes([whole[i] ^ 0xFF]) + whole[i + 1 :] for i in places]
    return [whole[:i] for i in places] + flipped + [b"\0" * len(whole), b"not an archive"]


def test_the_previous_checkpoint_replaces_a_damaged_one(folder):
    folder.save(checkpoint(1))
    folder.save(checkpoint(2))
    newest = folder.path / "checkpoints" / "generation_000002.npz"
    for content in damaged(newest.read_bytes()):
        newest.write_bytes(content)
        found = folder.load()
        # A flipped byte may be unused. Then the checkpoint is whole.
        assert_same(found, checkpoint(found.generation if found else 1))
    newest.write_bytes(b"")
    assert_same(folder.load(), checkpoint(1))
    folder.save(checkpoint(2))
    assert_same(folder.load(), checkpoint(2))


def test_an_incomplete_list_of_arrays_damages_a_checkpoint(folder):
    """An entry of the archive's list that claims a comment would hide the entries after it."""
    folder.save(checkpoint(1))
    folder.save(checkpoint(2))
    newest = folder.path / "checkpoints" / "generation_000002.npz"
    whole = newest.read_bytes()
    entries = [i for i in range(len(whole)) if whole.startswith(b"PK\1\2", i)]
    assert len(entries) > 10
    # No entry follows the last.
    for entry in entries[:-1]:
        place = entry + 32  # the length of its comment
        newest.write_bytes(whole[:place] + b"\xff" + whole[place + 1 :])
        assert_same(folder.load(), checkpoint(1))


def test_a_run_without_readable_checkpoints_does_not_restart(folder):
    folder.save(checkpoint(1))
    folder.save(checkpoint(2))
    older, newest = sorted((folder.path / "checkpoints").iterdir())
    newest.unlink()
    newest.mkdir()
    whole = older.read_bytes()
    older.write_bytes(whole[:100])
    with pytest.raises(RunFolderError, match=r"2\.npz: Is a dir.*1\.npz: "):
        folder.load()
    older.write_bytes(whole)
    assert_same(folder.load(), checkpoint(1))


def test_a_checkpoint_deleted_meanwhile_is_not_damaged(folder):
    folder.save(checkpoint(1))
    (path,) = (folder.path / "checkpoints").iterdir()
    path.unlink()
    path.symlink_to("gone")
    assert folder.load() is None


def test_generations_of_seven_digits_come_after_those_of_six(folder):
    for done in (999_998, 999_999, 1_000_000):
        folder.save(checkpoint(2)._replace(generation=done))
        found = folder.load()
        assert found is not None and found.generation == folder.newest == done
    kept = sorted(path.name for path in (folder.path / "checkpoints").iterdir())
    assert kept == ["generation_1000000.npz", "generation_999999.npz"]


def test_a_damaged_champion_is_named_with_the_remedy(folder):
    folder.save_champion(CHAMPION)
    for content in damaged(folder.champion.read_bytes()):
        folder.champion.write_bytes(content)
        try:
            champion, _, _ = folder.load_champion()
        except RunFolderError as error:
            assert "champion.npz is damaged" in str(error) and "resume" in str(error)
        else:
            assert champion[1:] == CHAMPION[1:]


def emptied(path, name):
    """Rewrite a file with one of its arrays empty."""
    with np.load(path) as arrays:
        told = dict(arrays)
    told[name] = np.zeros((0,) * max(1, told[name].ndim), told[name].dtype)
    np.savez(path, **told)


def test_an_empty_array_damages_a_checkpoint(folder):
    folder.save(checkpoint(2))
    (path,) = (folder.path / "checkpoints").iterdir()
    whole = path.read_bytes()
    with np.load(path) as arrays:
        names = [name for name in arrays if name == "genes" or name.startswith("history.")]
    assert len(names) > 2
    words = dict.fromkeys(names, ".*table of generations")
    words |= {"genes": "it is not a checkpoint", "champion0.genes": "it holds no genome"}
    for name, problem in words.items():
        path.write_bytes(whole)
        emptied(path, name)
        with pytest.raises(RunFolderError, match=rf"no checkpoint can be read \(.*: {problem}"):
            folder.load()
    path.write_bytes(whole)
    for name in ("generation", "best", "diverged"):
        emptied(path, f"history.{name}")
    with pytest.raises(RunFolderError, match="table of generations"):
        folder.load()


def test_a_champion_with_other_genes_damages_a_checkpoint(folder):
    folder.save(checkpoint(2, CHAMPION._replace(genes=np.ones(3, np.float32))))
    with pytest.raises(RunFolderError, match="number of genes"):
        folder.load()


def test_the_lock_of_a_killed_process_is_ignored(tmp_path):
    (tmp_path / ".lock").write_text("{}")
    made = RunFolder(tmp_path)
    with made.locked(new=True):
        made.create("name: a\n", {})
    assert files(made) == {"config.yaml", "meta.json"}
    other = RunFolder(tmp_path / "other")
    with pytest.raises(RunFolderError, match="is not a run folder"), other.locked():
        pass


def test_a_file_of_another_kind_counts_as_damaged(folder):
    folder.save(checkpoint(1))
    folder.save_lineage([CHAMPION])
    (newest,) = folder.path.glob("checkpoints/*.npz")
    champion = folder.champion.read_bytes()
    folder.champion.write_bytes(folder.lineage.read_bytes())
    with pytest.raises(RunFolderError, match=r"champion\.npz is damaged"):
        folder.load_champion()
    newest.write_bytes(champion)
    with pytest.raises(RunFolderError, match="no checkpoint can be read"):
        folder.load()


def test_numbers_that_are_not_finite_become_null(folder):
    folder.write_json("x.json", {"a": [1.5, float("nan")], "b": {"c": -float("inf")}, "d": "nan"})
    told = json.loads((folder.path / "x.json").read_text())
    assert told == {"a": [1.5, None], "b": {"c": None}, "d": "nan"}


@pytest.mark.parametrize("text", ["", "{", "[1, 2]", "\xff"])
def test_a_damaged_meta_counts_as_empty(folder, text):
    folder.meta.write_text(text, encoding="latin-1")
    assert folder.read_meta() == {}
    folder.update_meta(devices=1)
    assert folder.read_meta() == {"devices": 1}


@pytest.mark.parametrize(
    ("text", "words"),
    [("[1,", "^Expecting value"), ('{"a": [1, "2"]}', "^a: 1: Input should be a valid integer$")],
)
def test_json_of_another_type_is_named(tmp_path, text, words):
    path = tmp_path / "x.json"
    path.write_text('{"a": [1, 2]}')
    assert read_json(path, dict[str, list[int]]) == {"a": [1, 2]}
    # This is the name of a file that is not UTF-8.
    path.write_text('{"a": "\\udcff"}')
    assert read_json(path, dict[str, Any]) == {"a": "\udcff"}
    path.write_text(text)
    with pytest.raises(ValueError, match=words):
        read_json(path, dict[str, list[int]])


def test_files_of_a_killed_write_are_harmless(folder):
    folder.save(checkpoint(1))
    for name in (".champion.npz.x1", "checkpoints/.generation_000009.npz.x2", ".config.yaml.x3"):
        (folder.path / name).write_bytes(b"half a fi")
    assert_same(folder.load(), checkpoint(1))
    folder.save(checkpoint(2))
    assert_same(folder.load(), checkpoint(2))


class Killed(BaseException):
    """Exception in place of the end of the process."""


def killing_at(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Raise `Killed` just before the n-th file is moved to its place."""
    replace, calls = run_folder.os.replace, iter(range(count + 1))

    def replace_or_die(source, target):
        if next(calls) == count:
            raise Killed
        replace(source, target)

    monkeypatch.setattr(run_folder.os, "replace", replace_or_die)


def test_a_kill_in_a_new_folder_allows_a_start_or_resume(tmp_path, monkeypatch):
    path = tmp_path / "a"
    folder = RunFolder(path)
    with monkeypatch.context() as patch:
        killing_at(0, patch)
        with pytest.raises(Killed):
            folder.create("name: a\n", {})
    # There is no config.yaml yet, so the command may be repeated.
    (path / ".config.yaml.x").write_bytes(b"na")
    with monkeypatch.context() as patch:
        killing_at(1, patch)
        with pytest.raises(Killed):
            folder.create("name: a\n", {})
    folder.require()
    assert folder.load() is None
    folder.reopen("name: a\n")
    folder.save(checkpoint(1))
    assert_same(folder.load(), checkpoint(1))


@pytest.mark.parametrize("writes", range(3))
def test_a_kill_while_saving_leaves_the_old_state_or_the_new(folder, monkeypatch, writes):
    folder.save(checkpoint(1))
    newer = CHAMPION._replace(generation=1, fitness=-0.25)
    with monkeypatch.context() as patch:
        killing_at(writes, patch)
        with pytest.raises(Killed):
            folder.save(checkpoint(2, newer))
    # The order of files is champion.npz, the checkpoint, metrics.csv.
    expected = checkpoint(1) if writes < 2 else checkpoint(2, newer)
    assert_same(folder.load(), expected)
    folder.load_champion()
    assert not [name for name in files(folder) if "/." in f"/{name}"]


@pytest.mark.parametrize("writes", range(7))
def test_a_kill_while_replacing_a_champion_leaves_all_files_or_none(folder, monkeypatch, writes):
    folder.save(checkpoint(1, CHAMPION))
    better = CHAMPION._replace(fitness=CHAMPION.fitness + 0.5)
    with monkeypatch.context() as patch:
        killing_at(writes, patch)
        with pytest.raises(Killed):
            folder.replace_champion(better, "name: b\n")
    # The next command opens the folder. Three files are written, renamed together, then moved.
    folder = RunFolder(folder.path)
    folder.require()
    expected, config = (CHAMPION, "name: a\n") if writes < 4 else (better, "name: b\n")
    champion, _, digests = folder.load_champion()
    assert champion.fitness == folder.load().champion.fitness == expected.fitness
    assert folder.config.read_text() == config
    assert digests["config_sha256"] == folder.config_digest()
    # Files of the killed attempt do not disturb the next.
    folder.replace_champion(better, "name: b\n")
    assert folder.load_champion()[0].fitness == better.fitness
    assert not [name for name in files(folder) if "/." in f"/{name}"]


def test_used_and_unusable_places_are_refused(folder, tmp_path):
    before = files(folder)
    note = tmp_path / "note.txt"
    note.write_text("mine")
    for path, kind, words in (
        (folder.path, RunFolderError, "already holds a run"),
        (tmp_path, RunFolderError, "is not empty"),
        (note, RunFolderError, "is a file"),
        (note / "run", OutputError, "cannot write"),
        ("/proc/run", OutputError, "cannot write"),
        (tmp_path / ("x" * 300), OutputError, "cannot write"),
    ):
        with pytest.raises(kind, match=words):
            RunFolder(path).create("name: b\n", {})
    assert files(folder) == before and folder.config.read_text() == "name: a\n"
    assert note.read_text() == "mine"
    with pytest.raises(RunFolderError, match="is not a run folder"):
        RunFolder(tmp_path).require()


def test_a_folder_that_can_no_longer_be_written_is_named(folder):
    (folder.path / "checkpoints").rmdir()
    (folder.path / "checkpoints").write_text("in the way")
    with pytest.raises(OutputError, match=r"cannot write .*generation_000001.npz \(Not a dir"):
        folder.save(checkpoint(1))
    with pytest.raises(OutputError, match=r"cannot write .* \(File exists\)"):
        folder.reopen("name: a\n")
