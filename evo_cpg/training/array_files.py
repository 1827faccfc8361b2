"""Reading of .npz files that may be damaged or malicious.

A file from elsewhere must neither run code nor fill all memory. So this module refuses pickles, and
arrays that claim to be larger than their part of the file.
"""

import math
import os
import struct
import zipfile
from pathlib import Path
from typing import IO

import numpy as np

DAMAGED = (
    EOFError,
    KeyError,
    NotImplementedError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
    struct.error,
    zipfile.BadZipFile,
)
"""Errors that were observed when truncated or overwritten .npz files were read."""

# Last record of a zip archive without a comment: signature, two disk numbers, number of entries (on
# this disk and in all), size and offset of the central directory, length of the comment.
_END = struct.Struct("<4s4H2LH")


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Return the arrays of a file by name. Any error of `DAMAGED` means a damaged file."""
    # Given a path, np.load would leave a damaged file open.
    with path.open("rb") as file:
        _require_honest(file)
        with np.load(file, allow_pickle=False) as arrays:
            return dict(arrays)


def _require_honest(file: IO[bytes]) -> None:
    """Check that an .npz file is uncompressed and holds all entries and bytes that it lists.

    Raises:
        ValueError: a check fails. Other errors of `DAMAGED`: the file is no .npz file.
    """
    with zipfile.ZipFile(file) as archive:
        # A flipped byte may let one entry swallow later ones. The module zipfile does not notice.
        file.seek(-_END.size, os.SEEK_END)
        mark, *_, entries, _, _, _ = _END.unpack(file.read(_END.size))
        if mark != b"PK\5\6" or entries != len(archive.infolist()):
            raise ValueError("the list of its arrays is incomplete")
        for member in archive.infolist():
            # The package writes uncompressed files.
            if member.compress_type != zipfile.ZIP_STORED:
                raise ValueError(
                    f"{member.filename} is compressed and may need more than the file holds"
                )
            with archive.open(member) as array:
                version = np.lib.format.read_magic(array)
                if version == (1, 0):
                    shape, _, kind = np.lib.format.read_array_header_1_0(array)
                else:
                    shape, _, kind = np.lib.format.read_array_header_2_0(array)
            if math.prod(shape) * kind.itemsize > member.file_size:
                raise ValueError(f"{member.filename} declares more than the file holds")
    file.seek(0)
