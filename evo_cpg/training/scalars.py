"""The columns of metrics.csv as scalars for TensorBoard, while they come.

There is one event file for each run, in ``tensorboard/`` of the run folder, or, where runs evolve
side by side, in ``tensorboard/run_0/`` and so on: a resumed run goes on in the same file. What a
kill left of a record is cut off, and generations are neither told twice nor left out: what the
file lacks comes from the checkpoint's table.

The format is that of TFRecord: length, its checksum, an `Event` of protocol buffers, its checksum.
"""

import math
import os
import struct
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import IO, Any, cast

from evo_cpg.files import cannot_write
from evo_cpg.installation import command_for

# Name of the folder; in it of each file, of which TensorBoard looks for the first part.
FOLDER, _FILE = "tensorboard", "events.out.tfevents.evo-cpg"
# Columns that say which generation of which run a row is of.
_PLACE = ("generation", "run")
_HEADER, _CHECKSUM = struct.Struct("<QI"), struct.Struct("<I")
# No event of ours is nearly as long; a longer one is no event.
_LONGEST = 1 << 20


class MissingWriterError(Exception):
    """The package that writes event files is not installed."""


class Scalars:
    """Event files that rows are added to.

    Args:
        path: the run folder.
        history: rows of the generations that are done.

    Raises:
        MissingWriterError: tensorboardX is not installed.
        RunFolderError: a file cannot be written.
    """

    def __init__(self, path: Path, history: Iterable[Mapping[str, float]] = ()):
        require_writer()
        self._folder = path / FOLDER
        self._files: dict[Path, IO[bytes]] = {}
        done = list(history)
        by_file: dict[Path, list[Mapping[str, float]]] = {}
        for row in done:
            by_file.setdefault(self._file_of(row), []).append(row)
        for file, rows in by_file.items():
            last = self._open(file, int(rows[-1]["generation"]))
            self.add([row for row in rows if row["generation"] > last])

    def add(self, rows: Iterable[Mapping[str, float]]) -> None:
        """Add rows of metrics.csv; what is not finite is left out.

        Raises:
            RunFolderError: they cannot be written.
        """
        Event, Summary = _messages()
        for row in rows:
            path = self._file_of(row)
            if path not in self._files:
                self._open(path, -1)
            values = [
                Summary.Value(tag=name, simple_value=value)
                for name, value in row.items()
                if name not in _PLACE and math.isfinite(value)
            ]
            step = int(row["generation"])
            event = Event(wall_time=time.time(), step=step, summary=Summary(value=values))
            self._write(path, event)

    def close(self) -> None:
        """Close the files."""
        for file in self._files.values():
            file.close()
        self._files.clear()

    def _file_of(self, row: Mapping[str, float]) -> Path:
        if "run" in row:
            return self._folder / f"run_{int(row['run'])}" / _FILE
        return self._folder / _FILE

    def _open(self, path: Path, done: int) -> int:
        """Open a file where it may be gone on with.

        Args:
            path: of the file.
            done: last generation that the run has done; later ones in the file are cut off.

        Returns:
            The last generation in it; -1 where there is none.
        """
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()
            file = path.open("r+b")
            end, last = _end(file, done)
            file.truncate(end)
            file.seek(end)
        except OSError as error:
            raise cannot_write(path, error) from None
        self._files[path] = file
        if not end:
            Event, _ = _messages()
            self._write(path, Event(wall_time=time.time(), file_version="brain.Event:2"))
        return last

    def _write(self, path: Path, event: Any) -> None:
        from tensorboardX.record_writer import masked_crc32c

        data = event.SerializeToString()
        length = struct.pack("<Q", len(data))
        record = length + _CHECKSUM.pack(masked_crc32c(length)) + data
        file = self._files[path]
        try:
            file.write(record + _CHECKSUM.pack(masked_crc32c(data)))
            file.flush()
        except OSError as error:
            raise cannot_write(path, error) from None


def require_writer() -> None:
    """Check that event files can be written.

    Raises:
        MissingWriterError: they cannot.
    """
    try:
        import tensorboardX.proto.event_pb2  # noqa: F401
    except ImportError as error:
        raise MissingWriterError(
            f"'tensorboardX' is not installed here ({error}); `{command_for('tensorboard')}` "
            "installs it"
        ) from None


def _messages() -> tuple[Any, Any]:
    """The classes of an event and its summary, which are made as they are imported."""
    from tensorboardX.proto import event_pb2, summary_pb2

    return cast(Any, event_pb2).Event, cast(Any, summary_pb2).Summary


def _end(file: IO[bytes], done: int) -> tuple[int, int]:
    """Where the last whole record ends that is of no later generation than that, and of which."""
    from google.protobuf.message import DecodeError
    from tensorboardX.record_writer import masked_crc32c

    Event, _ = _messages()
    size, end, last = os.fstat(file.fileno()).st_size, 0, -1
    while end + _HEADER.size <= size:
        file.seek(end)
        header = file.read(_HEADER.size)
        length, checksum = _HEADER.unpack(header)
        after = end + _HEADER.size + length + _CHECKSUM.size
        if checksum != masked_crc32c(header[:8]) or length > _LONGEST or after > size:
            break
        data = file.read(length)
        if _CHECKSUM.unpack(file.read(_CHECKSUM.size))[0] != masked_crc32c(data):
            break
        try:
            event = Event.FromString(data)
        except DecodeError:
            break
        if event.HasField("summary"):
            if event.step > done:
                break
            last = event.step
        end = after
    return end, last
