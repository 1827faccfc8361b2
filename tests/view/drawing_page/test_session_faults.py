"""What a session answers to senseless requests, other pages, full disks and missing files."""

import errno
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import trimesh

from evo_cpg.files import write_text
from evo_cpg.view.drawing_page import runs
from evo_cpg.view.drawing_page.document import Document, EditError
from evo_cpg.view.drawing_page.runs import TrainingRun
from evo_cpg.view.drawing_page.session import DrawingSession

PART = {"parent": "body", "place": [-0.1, 0, 0], "normal": [-1, 0, 0], "name": "tail"}
ADD = {"command": "add_part", "given": PART}


@pytest.fixture
def session(tmp_path) -> DrawingSession:
    made = DrawingSession(Document.new(tmp_path / "animal.yaml"))
    made.answer("open", {})
    return made


@pytest.mark.parametrize(
    ("request_", "given", "words"),
    [
        ("edit", {"command": "add_part", "given": "x"}, "edit: given: 'x': must be a section"),
        ("edit", {"command": [], "given": {}}, "edit: command: .*: must be text"),
        ("edit", {"given": {}}, "edit: command: is missing"),
        ("undo", {"wing": 1}, "undo: wing: unknown key"),
        ("train", {"generations": "many"}, "train: generations: 'many': must be a whole number"),
        ("train", {"generations": float("nan")}, "train: generations: nan"),
        ("try", {"how": "fly"}, "try: how: 'fly': must be 'rest' or 'drive'"),
        ("save", {"name": "a" * 300 + ".yaml"}, "must be the name of a .yaml file"),
        ("save", {"name": "a\0.yaml"}, "must be the name of a .yaml file"),
        ("save", {"name": "a\ud800.yaml"}, "must be the name of a .yaml file"),
    ],
)
def test_a_senseless_request_is_refused_in_words(session, request_, given, words):
    texts = session.document.texts
    answer = session.answer(request_, given)
    with pytest.raises(ValueError, match=words):
        raise ValueError(answer["error"])
    assert session.document.texts == texts and answer["scene"]


def test_a_value_nested_deeper_than_python_reaches_is_refused(session, capsys):
    deep = json.loads("[" * 900 + "]" * 900)
    given = {"command": "set_value", "given": {"key": ["seed"], "value": deep}}
    answer = session.answer("edit", given)
    assert "error" in answer and answer["scene"] and not session.document.can_undo
    assert "Traceback" not in capsys.readouterr().err


def test_a_page_that_shows_a_former_state_is_refused(session):
    first = session.answer("open", {})
    second = session.answer("open", {})
    # The second page has changed nothing yet.
    assert "error" not in session.answer("edit", ADD | {"seen": first["revision"]})
    second = session.answer("undo", {})
    made = session.answer("edit", ADD | {"seen": second["revision"]})
    assert "error" not in made
    remove = {"command": "remove_part", "given": {"name": "tail"}, "seen": first["revision"]}
    late = session.answer("edit", remove)
    assert "another page or window" in late["error"] and len(late["scene"]["bodies"]) == 2
    # The page of the former state receives all shapes that it lacks.
    meshes = [body["mesh"] for body in late["scene"]["bodies"]]
    needed = {key for mesh in meshes for name, key in mesh.items() if name != "color"}
    assert needed <= late["scene"]["arrays"].keys()
    again = session.answer("edit", remove | {"seen": late["revision"]})
    assert "error" not in again and len(again["scene"]["bodies"]) == 1
    assert "error" not in session.answer("stop", {"seen": first["revision"]})


def test_a_full_disk_is_told_and_loses_nothing(session, monkeypatch):
    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    answer = session.answer("edit", ADD)
    assert "No space left on device" in answer["unsafe"] and answer["new"] == "tail"
    assert "No space left" in session.answer("save", {})["error"]
    assert list(session.document.path.parent.iterdir()) == []
    monkeypatch.undo()
    answer = session.answer("save", {})
    assert answer["unsafe"] is None and "tail" in session.document.path.read_text()


def test_a_file_that_was_deleted_is_written_again(session):
    session.answer("save", {})
    session.document.path.unlink()
    session.answer("edit", ADD)
    assert "error" not in session.answer("save", {})
    assert Document.open(session.document.path).texts == session.document.texts


def test_a_file_that_became_unreadable_is_not_overwritten(session):
    session.answer("save", {})
    session.answer("edit", ADD)
    for content in (b"\xff\xfe\x00", b"name: [", b"name: other\n"):
        session.document.path.write_bytes(content)
        assert str(session.document.path) in session.answer("save", {})["error"]
        assert session.document.path.read_bytes() == content
    session.document.path.unlink()
    session.document.path.mkdir()
    assert "it is a folder" in session.answer("save", {})["error"]
    assert "saved" in session.answer("save", {"name": "other.yaml"})


def test_a_link_stays_a_link_and_permissions_stay(tmp_path):
    (tmp_path / "real").mkdir()
    real, link = tmp_path / "real/fish.yaml", tmp_path / "fish.yaml"
    Document.new(real).save()
    real.chmod(0o600)
    link.symlink_to(real)
    document = Document.open(link)
    document.apply(lambda data: data.update(seed=7))
    document.save()
    assert link.is_symlink() and "seed: 7" in real.read_text()
    assert real.stat().st_mode & 0o777 == 0o600
    write_text(tmp_path / "new.txt", "")
    assert (tmp_path / "new.txt").stat().st_mode & 0o777 == 0o644


@pytest.mark.parametrize(
    ("name", "kept"),
    [
        ("形.stl", "形.stl"),
        ("körper.STL", "körper.STL"),
        ("ko\u0308rper.stl", "körper.stl"),
        ("形" * 200 + ".stl", "形" * 33 + ".stl"),
        ("a" * 400 + ".stl", "a" * 100 + ".stl"),
        ("!!!.stl", "mesh.stl"),
        (".stl", "mesh.stl"),
    ],
)
def test_a_mesh_keeps_the_letters_of_its_name(session, tmp_path, name, kept):
    good = bytes(trimesh.creation.box((0.2, 0.1, 0.1)).export(file_type="stl"))
    assert session.upload(name, good) == {"file": kept}
    assert (tmp_path / kept).read_bytes() == good


RUN = """
import os, signal, sys, time
from pathlib import Path
from evo_cpg.view.drawing_page.runs import TrainingRun
run = TrainingRun(Path(sys.argv[1]), "killed")
print(run._process.pid, flush=True)
while not run.state()["curves"].get("best"):
    time.sleep(0.2)
os.kill(os.getpid(), signal.SIGKILL)
"""


def _trained(folder: Path) -> Path:
    document = Document.new(folder / "animal.yaml")
    session = DrawingSession(document)
    session.answer("edit", ADD)
    eye = {"part": "body", "place": [0.1, 0, 0], "axis": [1, 0, 0]}
    session.answer("edit", {"command": "add_eye", "given": eye})
    for key, value in {
        ("evolution", "generations"): 100_000,
        ("simulation", "seconds"): 0.333,
    }.items():
        given = {"key": list(key), "value": value}
        session.answer("edit", {"command": "set_value", "given": given})
    session.answer("save", {})
    return document.path


def _ends(pid: int, seconds: float) -> bool:
    """Return whether a process ends in time."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        except OSError:
            return True
        if state == "Z":
            return True
        time.sleep(0.1)
    return False


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs /proc")
def test_a_run_ends_when_the_program_of_the_page_is_killed(tmp_path):
    path = _trained(tmp_path)
    with subprocess.Popen(
        [sys.executable, "-c", RUN, str(path)], stdout=subprocess.PIPE, text=True
    ) as program:
        assert program.stdout is not None
        pid = int(program.stdout.readline())
    assert _ends(pid, 300)
    assert (tmp_path / "runs/killed/metrics.csv").exists()


@pytest.mark.slow
def test_a_stop_is_answered_at_once_and_keeps_the_generations(tmp_path, monkeypatch):
    monkeypatch.setattr(runs, "_PATIENCE", 120.0)
    # A program in the background of a shell ignores interrupts, and so do the programs it starts.
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    run = TrainingRun(_trained(tmp_path), "stopped")
    signal.signal(signal.SIGINT, before)
    while not run.state()["curves"].get("best"):
        assert run.is_running, run.state()["output"]
        time.sleep(0.2)
    start = time.monotonic()
    run.stop()
    assert time.monotonic() - start < 0.5 and run.state()["stopping"]
    run.close()
    # It was not killed.
    assert run.state()["code"] not in (None, -signal.SIGKILL)
    assert len(run.state()["curves"]["best"]) > 0
    with pytest.raises(EditError, match="before the motion of its champion was recorded"):
        run.champion()
