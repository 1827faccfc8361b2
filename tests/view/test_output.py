"""A picture on a full disk, and files of killed processes."""

import errno
import os
import subprocess
import sys

import pytest

from evo_cpg.files import OutputError, in_one_piece, write_text


def test_a_full_disk_is_reported_and_keeps_the_old_file(tmp_path):
    path = tmp_path / "plot.png"
    path.write_bytes(b"as it was")
    words = r"cannot write .*plot\.png \(No space left on device\)"
    with pytest.raises(OutputError, match=words), in_one_piece(path) as partial:
        partial.write_bytes(b"half")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert [each.read_bytes() for each in tmp_path.iterdir()] == [b"as it was"]


RENDER = """
import sys, time
from pathlib import Path
from evo_cpg.files import beside, in_one_piece
with in_one_piece(Path("film.mp4")), beside(Path("frames"), folder=True) as frames:
    (frames / "0.png").touch()
    print("begun", flush=True)
    time.sleep(60)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows cannot tell which files are in use")
def test_files_of_killed_processes_are_deleted(tmp_path):
    (tmp_path / ".mine.part-1").touch()
    with subprocess.Popen(
        [sys.executable, "-c", RENDER], cwd=tmp_path, stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None and process.stdout.readline() == b"begun\n"
        left = set(tmp_path.iterdir())
        assert len(left) == 3
        write_text(tmp_path / "notes.txt", "")
        # They are still in use.
        assert left < set(tmp_path.iterdir())
        process.kill()
    write_text(tmp_path / "notes.txt", "")
    assert {path.name for path in tmp_path.iterdir()} == {".mine.part-1", "notes.txt"}
