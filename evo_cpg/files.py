"""Write files whole or not at all, and check .json files while reading them."""

import contextlib
import csv
import io
import json
import os
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

from evo_cpg.errors import UserError
from evo_cpg.system import resolved


class OutputError(UserError, OSError):
    """File or folder that cannot be written at the requested place."""


def cannot_write(path: Path, error: OSError) -> OutputError:
    """Return the error to raise if the system refused to write."""
    return OutputError(f"cannot write {path} ({error.strerror or error})")


def require_place(path: Path) -> Path:
    """Check, before any work, that a file can be written or replaced, and return its path.

    Raises:
        OutputError: the parent folder does not exist, the path is a folder, or permission is
            missing.
    """
    # Unlike methods of Path, these functions raise no error for names that no file can have.
    if not os.path.isdir(path.parent):
        raise OutputError(f"cannot write {path}: there is no folder {path.parent}. Create it first")
    if os.path.isdir(path):
        raise OutputError(f"cannot write {path}: it is a folder. Give the name of a file")
    taken = os.path.exists(path) and not os.access(path, os.W_OK)
    if taken or not os.access(path.parent, os.W_OK):
        raise OutputError(f"cannot write {path}: no permission to write there")
    return path


@contextlib.contextmanager
def beside(path: Path, folder: bool = False) -> Iterator[Path]:
    """Yield an empty temporary file or folder beside a path, and delete it after the block.

    Its name is unique, because several programs may write the same file. A killed process leaves
    it behind.
    """
    prefix, suffix = f".{path.name}.part-", path.suffix.lower()
    if folder:
        partial = Path(tempfile.mkdtemp(dir=path.parent, prefix=prefix))
    else:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=prefix, suffix=suffix)
        os.close(handle)
        partial = Path(name)
    try:
        yield partial
    finally:
        if folder:
            shutil.rmtree(partial, ignore_errors=True)
        else:
            partial.unlink(missing_ok=True)


@contextlib.contextmanager
def in_one_piece(path: Path) -> Iterator[Path]:
    """Yield a temporary file in the same folder, which replaces the file after the ``with`` block.

    An existing file is replaced, and its permissions stay. If the path is a link, the file that it
    leads to is replaced. The temporary file is empty and has the same suffix.

    Raises:
        OutputError: the file cannot be written, for instance because the disk is full.
    """
    if os.path.islink(path):
        path = resolved(path)
    try:
        with beside(path) as partial:
            yield partial
            mode = 0o644
            with contextlib.suppress(OSError):
                mode = stat.S_IMODE(os.stat(path).st_mode)
            os.chmod(partial, mode)
            os.replace(partial, path)
    except OutputError:
        raise
    except OSError as error:
        raise cannot_write(path, error) from None


def write_whole(path: Path, write: Callable[[IO[bytes]], object]) -> None:
    """Write a temporary file, flush it to the disk, and move it to its place.

    Raises:
        OutputError: the file cannot be written.
    """
    with in_one_piece(path) as partial, partial.open("wb") as file:
        write(file)
        file.flush()
        os.fsync(file.fileno())


def write_text(path: Path, text: str) -> None:
    """Write a text whole, in UTF-8. Bytes of file names that are not UTF-8 stay unchanged."""
    write_whole(path, lambda file: file.write(text.encode(errors="surrogateescape")))


def read_json(path: Path, kind: Any) -> Any:
    """Return the contents of a .json file.

    Args:
        path: path of the file.
        kind: required type of the contents, for a `pydantic.TypeAdapter`.

    Raises:
        OSError: the file cannot be read.
        ValueError: the contents are not JSON or have another type. The message is one line.
    """
    from pydantic import TypeAdapter, ValidationError

    try:
        # Pydantic's own reader refuses file names that are not UTF-8.
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
        path: path of the file.
        rows: cells by column name. The columns keep the order of their first appearance. A cell
            that a row lacks is empty.

    Raises:
        OutputError: the file cannot be written.
    """
    text = io.StringIO()
    columns = list(dict.fromkeys(column for row in rows for column in row))
    writer = csv.DictWriter(text, columns, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(path, text.getvalue())


def make_folder(path: Path) -> Path:
    """Make a folder and its missing parents, and return its path.

    Raises:
        OutputError: the folder cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise cannot_write(path, error) from None
    return path
