"""Limits on the files and code that a configuration or a run folder may use.

A configuration may come from a stranger. Unless the user trusts it, files must lie in its own
folder. Code must be installed or lie in the working folder.
"""

import contextlib
import contextvars
import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from evo_cpg.io.errors import KeyProblem
from evo_cpg.io.files import require_small
from evo_cpg.system import resolved, working_folder

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

    Args:
        source: the configuration file.
        name: name of the file in the configuration.

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

    Args:
        source: the configuration file.
        name: name of the file in the configuration.
        suffixes: allowed suffixes.

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


def code_folders(folders: Iterable[Path]) -> list[Path]:
    """Return the folders that are searched for a user's own classes."""
    here = working_folder()
    return [folder for folder in folders if is_trusted() or (here and resolved(folder) == here)]


def distrusted(module: str, folders: Iterable[Path]) -> str:
    """Return a note that a module exists but is not trusted, or empty if it does not exist."""
    top = module.partition(".")[0]
    for folder in folders:
        if (folder / f"{top}.py").is_file() or (folder / top).is_dir():
            return (
                f". It lies in {folder}, but code is run only from the working folder. If you "
                "trust the code, run evo-cpg --trust ..."
            )
    return ""
