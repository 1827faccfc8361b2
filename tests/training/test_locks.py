"""One process at a time changes a folder. A refused process names the other."""

import os
import platform
import subprocess
import sys

import pytest

from evo_cpg import locks
from evo_cpg.files import OutputError
from evo_cpg.locks import LockedError, locked
from tiny_run import REPOSITORY

HOLD = """
import sys, time
from pathlib import Path
from evo_cpg.locks import locked
with locked(Path(sys.argv[1])):
    print("locked", flush=True)
    time.sleep(600)
"""


def hold(folder):
    """Start a process that locks a folder and keeps it locked."""
    started = subprocess.Popen(
        [sys.executable, "-c", HOLD, folder],
        stdout=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": str(REPOSITORY)},
        text=True,
    )
    assert started.stdout is not None and started.stdout.readline() == "locked\n"
    return started


def test_the_second_process_names_the_holder_of_the_lock(tmp_path):
    with hold(tmp_path) as holder:
        try:
            words = rf"is in use by process {holder.pid} on {platform.node()} \(`-c {tmp_path}`, "
            with pytest.raises(LockedError, match=words) as refused, locked(tmp_path):
                pass
            assert "\n" not in str(refused.value)
            assert str(refused.value).endswith(". Wait until that process ends, or end it")
        finally:
            holder.kill()


def test_the_lock_of_a_killed_process_is_released(tmp_path):
    with hold(tmp_path) as holder:
        holder.kill()
        holder.wait()
    assert (tmp_path / locks.FILE).exists()
    with locked(tmp_path):
        assert f"process {os.getpid()} on " in (tmp_path / locks.FILE).read_text()
    assert not (tmp_path / locks.FILE).exists()


def test_a_folder_is_locked_once_and_freed(tmp_path):
    with locked(tmp_path):
        assert locks.holds(tmp_path)
        with pytest.raises(LockedError, match="is in use by process"), locked(tmp_path):
            pass
    assert not locks.holds(tmp_path) and not list(tmp_path.iterdir())
    with locked(tmp_path):
        pass


def test_a_file_that_its_holder_deleted_locks_nothing(tmp_path, monkeypatch):
    """A process deletes its lock while another has the file open. The other makes a new file."""
    path, opened = tmp_path / locks.FILE, locks._open

    def slow(place):
        descriptor = opened(place)
        monkeypatch.undo()
        path.unlink()
        return descriptor

    monkeypatch.setattr(locks, "_open", slow)
    with locked(tmp_path):
        assert path.exists()
        with pytest.raises(LockedError, match="is in use"), locked(tmp_path):
            pass


def test_an_empty_folder_made_for_a_lock_is_deleted(tmp_path):
    with locked(tmp_path / "runs" / "one", make=True):
        assert (tmp_path / "runs" / "one" / locks.FILE).exists()
    assert not (tmp_path / "runs").exists()
    with locked(tmp_path / "runs" / "two", make=True):
        (tmp_path / "runs" / "two" / "config.yaml").touch()
    assert [path.name for path in (tmp_path / "runs").rglob("*")] == ["two", "config.yaml"]


def test_a_path_that_cannot_hold_a_lock_is_refused(tmp_path):
    (tmp_path / "file").touch()
    for name, make, words in (("file", True, "is a file"), ("missing", False, "No such file")):
        with pytest.raises(OutputError, match=words), locked(tmp_path / name, make=make):
            pass


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "another process"),
        ("\xff", "\N{REPLACEMENT CHARACTER}"),
        ("a\x1b[2J\nb", r"a\?\[2J\?b"),
    ],
)
def test_text_from_the_lock_file_is_printable(tmp_path, text, words):
    with locked(tmp_path):
        (tmp_path / locks.FILE).write_text(text, encoding="latin-1")
        with pytest.raises(LockedError, match=f"is in use by {words}"), locked(tmp_path):
            pass


def test_text_from_the_lock_file_stays_short(tmp_path):
    with locked(tmp_path):
        (tmp_path / locks.FILE).write_text("c" * 5000)
        with pytest.raises(LockedError) as refused, locked(tmp_path):
            pass
    assert len(str(refused.value)) < 600


@pytest.mark.skipif(sys.platform == "win32", reason="locks of POSIX systems")
def test_systems_without_locks_refuse_no_process(tmp_path, monkeypatch):
    def unknown(descriptor, kind):
        raise OSError(38, "Function not implemented")

    monkeypatch.setattr(locks.fcntl, "flock", unknown)
    with locked(tmp_path), locked(tmp_path):
        pass
    assert not list(tmp_path.iterdir())
