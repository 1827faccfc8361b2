"""Limits on the files and code that a configuration or a run folder may use.

A configuration may come from a stranger. Files must not exceed a size. Unless the user trusts the
configuration, they must lie in its own folder, and code must be installed or lie in the working
folder.
"""

import contextlib
import contextvars
import importlib.util
import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from evo_cpg.io.errors import Key, KeyProblem
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.io.schema.section import CustomConfig
from evo_cpg.system import resolved, working_folder

# Largest file that is read. The finest mesh of a body has a tenth of this size.
LARGEST = 32 * 2**20

# Environment variable with the effect of `--trust`, for clusters and scripts.
VARIABLE = "EVO_CPG_TRUST"

_trusted = contextvars.ContextVar("trusted", default=False)
# List that gets the files that configurations name in `recording_files`.
_noted: contextvars.ContextVar[list[Path] | None] = contextvars.ContextVar("noted", default=None)


def trust() -> None:
    """Trust all configurations from now on."""
    _trusted.set(True)


@contextlib.contextmanager
def trusting(own: bool = True) -> Iterator[None]:
    """Trust configurations in the ``with`` block. If ``own`` is False, change nothing."""
    token = _trusted.set(own or _trusted.get())
    try:
        yield
    finally:
        _trusted.reset(token)


@contextlib.contextmanager
def recording_files() -> Iterator[list[Path]]:
    """Yield a list that gets each file that configurations name in the ``with`` block, once."""
    files: list[Path] = []
    token = _noted.set(files)
    try:
        yield files
    finally:
        _noted.reset(token)


def is_trusted() -> bool:
    """Return whether configurations are trusted."""
    return _trusted.get() or os.environ.get(VARIABLE) == "1"


def beside(source: Path, name: str) -> Path:
    """Return the path of a file that a configuration names.

    Raises:
        KeyProblem: the file lies outside the configuration's folder, and is not trusted.
    """
    path = source.parent / name
    noted = _noted.get()
    if noted is not None and path not in noted:
        noted.append(path)
    if is_trusted():
        return path
    try:
        inside = path.resolve().is_relative_to(source.parent.resolve())
    except (OSError, RuntimeError, ValueError):
        # The name is invalid, or its links form a cycle. Reading the file reports the error.
        inside = True
    if not inside:
        raise KeyProblem(
            (),
            f"{name[:200]!r} lies outside of the configuration's folder. If you trust the "
            "configuration, run evo-cpg --trust ...",
        )
    return path


def named_file(source: Path, name: str, suffixes: Sequence[str]) -> Path:
    """Return the path of a file that a configuration names, if it can be read.

    Raises:
        KeyProblem: the file has another suffix, is missing, too large, a folder or not trusted.
    """
    path = beside(source, name)
    if path.suffix.lower() not in suffixes:
        problem = f"{path.suffix!r} is not known. Allowed: {', '.join(suffixes)}"
        raise KeyProblem((), f"{name}: {problem}")
    try:
        require_small(path)
    except FileNotFoundError:
        raise KeyProblem((), f"{name}: no such file") from None
    except (OSError, ValueError) as error:
        problem = getattr(error, "strerror", None) or error
        raise KeyProblem((), f"{name[:60]}: cannot be read ({problem})") from None
    if path.is_dir():
        raise KeyProblem((), f"{name}: is a folder")
    return path


def require_small(path: Path) -> None:
    """Check that a file does not exceed the size limit.

    Raises:
        OSError: the file is larger, or its size cannot be read.
    """
    size = path.stat().st_size
    if size > LARGEST:
        raise OSError(
            None, f"{size / 2**20:.0f} MiB, more than the limit of {LARGEST // 2**20} MiB"
        )


def read_small(path: Path) -> str:
    """Return the text of a file that does not exceed the size limit.

    Raises:
        OSError: it is larger, or cannot be read.
        UnicodeDecodeError: it is not UTF-8.
    """
    require_small(path)
    if not (path.is_file() or path.is_dir()):
        # A pipe or a device may be endless.
        raise OSError(None, "is not a regular file")
    return path.read_text(encoding="utf-8")


def code_folders(folders: Iterable[Path]) -> list[Path]:
    """Return the folders that are searched for a user's own classes, with the working folder."""
    here = working_folder()
    found = [folder for folder in folders if is_trusted() or (here and resolved(folder) == here)]
    return [*found, here] if here else found


def own_parts(config: ExperimentConfig) -> dict[Key, CustomConfig]:
    """Return the parts of a configuration that are the user's own classes, by their keys."""
    parts: dict[Key, Any] = {
        **{("creature", "sensors", i): part for i, part in enumerate(config.creature.sensors)},
        **{("world", "forces", i): part for i, part in enumerate(config.world.forces)},
        **{(name,): getattr(config, name) for name in ("controller", "task", "evolution")},
    }
    return {key: part for key, part in parts.items() if isinstance(part, CustomConfig)}


def require_code(config: ExperimentConfig, folders: Iterable[Path]) -> None:
    """Check that the modules of a user's own classes can be found, without importing them.

    The folders are searched only if they are trusted.

    Raises:
        KeyProblem: a module cannot be found, or another module of its name would be imported.
    """
    folders = tuple(folders)
    for key, part in own_parts(config).items():
        place, top = (*key, "type"), part.type.partition(":")[0].partition(".")[0]
        if not top:
            # The name of the module is relative, but there is no package. The import reports the
            # error.
            continue
        try:
            spec = importlib.util.find_spec(top)
        except ValueError:
            # The module is loaded, without a record of its origin.
            continue
        if spec is None:
            problem = f"{part.type!r} cannot be imported (no module {top!r})"
            for folder in folders:
                if (folder / f"{top}.py").is_file() or (folder / top).is_dir():
                    problem = (
                        f"{problem}. It lies in {folder}, but code is run only from the working "
                        "folder. If you trust the code, run evo-cpg --trust ..."
                    )
                    break
            raise KeyProblem(place, problem)
        found = Path(spec.origin).resolve() if spec.origin else None
        files = (
            folder / name
            for folder in code_folders(folders)
            for name in (f"{top}/__init__.py", f"{top}.py")
        )
        own = next((file.resolve() for file in files if file.is_file()), None)
        if None not in (own, found) and own != found:
            raise KeyProblem(
                place, f"{part.type!r} would import {found} instead of {own}. Rename one of the two"
            )
