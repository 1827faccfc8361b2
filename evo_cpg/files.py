"""Files that are written whole or not at all, and .json files that are checked as they are read."""

import contextlib
import csv
import io
import json
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

from evo_cpg.errors import UserError


class OutputError(UserError, OSError):
    """A file or folder that cannot be written where it is wanted."""


def cannot_write(path: Path, error: OSError) -> OutputError:
    """What to raise where the system has refused to write."""
    return OutputError(f"cannot write {path} ({error.strerror or error})")


def require_place(path: Path) -> Path:
    """Check, before any work, that a file can be written here; an existing one may be replaced.

    Raises:
        OutputError: a folder that does not exist, a folder in the file's place, or no permission.
    """
    # Unlike a path's own methods these do not complain of names that no file can have.
    if not os.path.isdir(path.parent):
        raise OutputError(f"cannot write {path}: there is no folder {path.parent}; create it first")
    if os.path.isdir(path):
        raise OutputError(f"cannot write {path}: it is a folder; give the name of a file")
    taken = os.path.exists(path) and not os.access(path, os.W_OK)
    if taken or not os.access(path.parent, os.W_OK):
        raise OutputError(f"cannot write {path}: no permission to write there")
    return path


@contextlib.contextmanager
def in_one_piece(path: Path) -> Iterator[Path]:
    """Write to a neighbour of a file that takes its place at the end, whole or not at all.

    Args:
        path: of the file; one that is there is replaced.

    Yields:
        The neighbour, an empty file with the same suffix.

    Raises:
        OutputError: it cannot be written, for instance because the disk is full.
    """
    try:
        # Two programs that write the same file do not meet.
        handle, name = tempfile.mkstemp(
            dir=path.parent, prefix=f".{path.name}.", suffix=path.suffix.lower()
        )
        os.close(handle)
        partial = Path(name)
        try:
            yield partial
            os.chmod(partial, 0o644)
            os.replace(partial, path)
        finally:
            partial.unlink(missing_ok=True)
    except OutputError:
        raise
    except OSError as error:
        raise cannot_write(path, error) from None


def write_whole(path: Path, write: Callable[[IO[bytes]], object]) -> None:
    """Write a file beside its place, flush it to the disk, and move it there.

    Args:
        path: of the file; one that is there is replaced.
        write: writes its contents to an open file.

    Raises:
        OutputError: it cannot be written.
    """
    with in_one_piece(path) as partial, partial.open("wb") as file:
        write(file)
        file.flush()
        os.fsync(file.fileno())


def write_text(path: Path, text: str) -> None:
    """`write_whole` of a text, in UTF-8; bytes of names that are not UTF-8 stay as they are."""
    write_whole(path, lambda file: file.write(text.encode(errors="surrogateescape")))


def read_json(path: Path, kind: Any) -> Any:
    """Return the contents of a .json file.

    Args:
        path: path of the file.
        kind: the type that the contents must have, for a `pydantic.TypeAdapter`.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is no JSON, or has another type; the message is one line.
    """
    from pydantic import TypeAdapter, ValidationError

    try:
        # Pydantic's own reader refuses file names that are not UTF-8 (`evo_cpg.system.name_of`).
        content = json.loads(path.read_bytes())
        return TypeAdapter(kind).validate_python(content, strict=True)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = "".join(f"{part}: " for part in first["loc"])
        raise ValueError(f"{place}{first['msg']}") from None


def write_table(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write a .csv file whole.

    Args:
        path: of the file.
        rows: cells by the names of their columns, which come in the order in which they are first
            named; a cell that a row lacks is empty.

    Raises:
        OutputError: it cannot be written.
    """
    text = io.StringIO()
    columns = list(dict.fromkeys(column for row in rows for column in row))
    writer = csv.DictWriter(text, columns, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(path, text.getvalue())


def make_folder(path: Path) -> Path:
    """Make a folder, and those above it, where it is not there.

    Raises:
        OutputError: it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise cannot_write(path, error) from None
    return path
