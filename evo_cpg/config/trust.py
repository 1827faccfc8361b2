"""What a configuration or a run folder may reach beyond itself.

It may come from a stranger. Unless the user says that it is theirs, it names no files outside of
its own folder, and no code but what Python finds without it: in the working folder, or installed.
"""

import contextlib
import contextvars
import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from evo_cpg.config.errors import KeyProblem
from evo_cpg.config.files import require_small
from evo_cpg.system import named, resolved, working_folder

# Says in the environment what `--trust` says on the command line; for clusters and scripts.
VARIABLE = "EVO_CPG_TRUST"

_trusted = contextvars.ContextVar("trusted", default=False)
# Where the files that configurations name are noted.
_noted: contextvars.ContextVar[list[Path] | None] = contextvars.ContextVar("noted", default=None)


def trust() -> None:
    """From here on, configurations are the user's own."""
    _trusted.set(True)


@contextlib.contextmanager
def trusting(own: bool = True) -> Iterator[None]:
    """Within it, configurations are the user's own; nothing changes where ``own`` is False."""
    token = _trusted.set(own or _trusted.get())
    try:
        yield
    finally:
        _trusted.reset(token)


@contextlib.contextmanager
def recording_files() -> Iterator[list[Path]]:
    """Within it, the files that configurations name are added to a list, each once."""
    files: list[Path] = []
    token = _noted.set(files)
    try:
        yield files
    finally:
        _noted.reset(token)


def is_trusted() -> bool:
    """Whether configurations are the user's own."""
    return _trusted.get() or os.environ.get(VARIABLE) == "1"


def beside(source: Path, name: str) -> Path:
    """The file of this name, seen from a configuration file.

    Args:
        source: the configuration file.
        name: as it stands there.

    Raises:
        KeyProblem: it lies outside of the configuration's folder, and that is not trusted.
    """
    path = source.parent / named(name)
    noted = _noted.get()
    if noted is not None and path not in noted:
        noted.append(path)
    if is_trusted():
        return path
    try:
        inside = path.resolve().is_relative_to(source.parent.resolve())
    except (OSError, RuntimeError, ValueError):
        # A name that is none, or links that go round in circles.
        inside = True
    if not inside:
        raise KeyProblem(
            (),
            f"{name[:200]!r} lies outside of the configuration's folder; if the configuration is "
            "yours, say so: evo-cpg --trust ...",
        )
    return path


def named_file(source: Path, name: str, suffixes: Sequence[str]) -> Path:
    """Return the file of this name beside a configuration file, if it can be read.

    Args:
        source: the configuration file.
        name: as it stands there.
        suffixes: that are known.

    Raises:
        KeyProblem: the file has another suffix, is missing, too large, a folder or not trusted.
    """
    path = beside(source, name)
    if path.suffix.lower() not in suffixes:
        problem = f"{path.suffix!r} is not known; allowed: {', '.join(suffixes)}"
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
    """In which of some folders a user's own classes are looked for."""
    here = working_folder()
    return [folder for folder in folders if is_trusted() or (here and resolved(folder) == here)]


def distrusted(module: str, folders: Iterable[Path]) -> str:
    """Says that a module is there, but not trusted; empty where it is not there."""
    top = module.partition(".")[0]
    for folder in folders:
        if (folder / f"{top}.py").is_file() or (folder / top).is_dir():
            return (
                f"; it lies in {folder}, and code is run only from the working folder, or with "
                "evo-cpg --trust ..., which says that it is yours"
            )
    return ""
