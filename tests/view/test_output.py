"""A picture on a full disk."""

import errno
import os

import pytest

from evo_cpg.files import OutputError, in_one_piece


def test_a_full_disk_is_reported_and_keeps_the_old_file(tmp_path):
    path = tmp_path / "plot.png"
    path.write_bytes(b"as it was")
    words = r"cannot write .*plot\.png \(No space left on device\)"
    with pytest.raises(OutputError, match=words), in_one_piece(path) as partial:
        partial.write_bytes(b"half")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert [each.read_bytes() for each in tmp_path.iterdir()] == [b"as it was"]
