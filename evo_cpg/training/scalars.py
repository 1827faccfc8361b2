"""Scalars for TensorBoard: the columns of metrics.csv, written while a run evolves.

There is one event file for each run, in ``tensorboard/`` of the run folder, or, where runs evolve
side by side, in ``tensorboard/run_0/`` and so on. A resumed run writes its file anew from the
checkpoint's table, so no generation is missing or there twice, whatever a kill left. Rows before
keep their distance in time, by the column ``seconds``. Records of equal rows are equally long, so
a TensorBoard that reads the file meanwhile is not disturbed.
"""

import math
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, cast

from evo_cpg.files import cannot_write
from evo_cpg.installation import command_for

# Name of the folder; in it of each file, of which TensorBoard looks for the first part.
FOLDER, _FILE = "tensorboard", "events.out.tfevents.evo-cpg"
# Columns that say which generation of which run a row is of.
_PLACE = ("generation", "run")

Rows = Iterable[Mapping[str, float]]


class MissingWriterError(Exception):
    """The package that writes event files is not installed."""


class Scalars:
    """Event files that rows are added to.

    Args:
        path: the run folder.
        history: rows of the generations that are done.

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
        """Add rows of metrics.csv. Values that are not finite are left out.

        Raises:
            OutputError: they cannot be written.
        """
        self._add(rows, {})

    def close(self) -> None:
        """Close the files."""
        for file in self._files.values():
            file.close()
        self._files.clear()

    def _add(self, rows: Rows, ends: Mapping[float, float]) -> None:
        from tensorboardX.proto import event_pb2, summary_pb2

        # Their members are made as they are imported.
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
        MissingWriterError: they cannot.
    """
    try:
        import tensorboardX.proto.event_pb2  # noqa: F401
    except ImportError as error:
        raise MissingWriterError(
            f"'tensorboardX' is not installed here ({error}); `{command_for('tensorboard')}` "
            "installs it"
        ) from None
