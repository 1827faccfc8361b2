"""Scalars for TensorBoard: columns of metrics.csv, written while a run evolves.

There is one event file for each run, in ``tensorboard/`` of the run folder, or with several runs in
``tensorboard/run_0/`` and so on. A resumed run rewrites its file from the checkpoint's table. So no
generation is missing or duplicated after a kill. The column ``seconds`` gives the distances in time
between the rewritten events. A rewritten record is as long as before, so a TensorBoard that reads
the file meanwhile is not disturbed.
"""

import math
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, cast

from evo_cpg.files import cannot_write
from evo_cpg.installation import command_for

# Names of the folder and of each file. TensorBoard searches for file names with ``tfevents``.
FOLDER, _FILE = "tensorboard", "events.out.tfevents.evo-cpg"
# Columns with the generation and run of a row.
_PLACE = ("generation", "run")

Rows = Iterable[Mapping[str, float]]


class MissingWriterError(Exception):
    """Error for a missing package that writes event files."""


class Scalars:
    """TensorBoard event files of a run folder, to which rows of metrics.csv are added.

    Args:
        path: path of the run folder.
        history: rows of the finished generations.

    Raises:
        MissingWriterError: tensorboardX is not installed.
        OutputError: a file cannot be written.
    """

    def __init__(self, path: Path, history: Rows = ()):
        require_writer()
        self._folder = path / FOLDER
        self._files: dict[Path, Any] = {}
        done = list(history)
        took = {row["generation"]: row.get("seconds", 0.0) for row in done}
        start = time.time() - sum(took.values())
        ends = {}
        for generation, seconds in took.items():
            start += seconds
            ends[generation] = start
        self._add(done, ends)

    def add(self, rows: Rows) -> None:
        """Add rows of metrics.csv, without values that are not finite.

        Raises:
            OutputError: a file cannot be written.
        """
        self._add(rows, {})

    def close(self) -> None:
        """Close the files."""
        for file in self._files.values():
            file.close()
        self._files.clear()

    def _add(self, rows: Rows, ends: Mapping[float, float]) -> None:
        from tensorboardX.proto import event_pb2, summary_pb2

        # Members of these modules are created at import, so type checkers miss them.
        Event, Summary = cast(Any, event_pb2).Event, cast(Any, summary_pb2).Summary
        try:
            for row in rows:
                values = [
                    Summary.Value(tag=name, simple_value=value)
                    for name, value in row.items()
                    if name not in _PLACE and math.isfinite(value)
                ]
                event = Event(
                    wall_time=ends.get(row["generation"], time.time()),
                    step=int(row["generation"]),
                    summary=Summary(value=values),
                )
                file = self._file_of(row)
                if file not in self._files:
                    first = Event(wall_time=event.wall_time, file_version="brain.Event:2")
                    self._open(file).write(first.SerializeToString())
                self._files[file].write(event.SerializeToString())
            for file in self._files.values():
                file.flush()
        except OSError as error:
            raise cannot_write(self._folder, error) from None

    def _file_of(self, row: Mapping[str, float]) -> Path:
        folder = self._folder / f"run_{int(row['run'])}" if "run" in row else self._folder
        return folder / _FILE

    def _open(self, path: Path) -> Any:
        from tensorboardX.record_writer import RecordWriter

        path.parent.mkdir(parents=True, exist_ok=True)
        self._files[path] = RecordWriter(str(path))
        return self._files[path]


def require_writer() -> None:
    """Check that event files can be written.

    Raises:
        MissingWriterError: tensorboardX is not installed.
    """
    try:
        import tensorboardX.proto.event_pb2  # noqa: F401
    except ImportError as error:
        raise MissingWriterError(
            f"'tensorboardX' is not installed here ({error}). Install it: "
            f"`{command_for('tensorboard')}`"
        ) from None
