"""The configurations that come with the program, and are known by name.

In a checkout they are the files in ``configs/``. A wheel contains them next to the modules.
"""

import filecmp
import itertools
import os
import re
from pathlib import Path
from typing import NamedTuple

from evo_cpg.errors import question, similar
from evo_cpg.files import make_folder, write_whole
from evo_cpg.io.errors import ConfigError
from evo_cpg.system import resolved

_PACKAGE = Path(__file__).parents[1]

# Matches "Iwadate, Suzuki, Yamamoto and Furukawa 2010" and "Fukui 2003".
_STUDY = re.compile(r"\b([A-Z][a-z]+)(?:, [A-Za-z, ]+)? ((?:19|20)\d\d)\b")


class Shipped(NamedTuple):
    """A configuration that comes with the program.

    Attributes:
        name: name of the configuration.
        path: path of its file.
        about: comment at the top of the file, on one line.
        summary: first sentence of that comment.
        study: study that it repeats or starts from, as "Fukui 2003", or empty if there is none.
    """

    name: str
    path: Path
    about: str
    summary: str
    study: str


def shipped_folder() -> Path | None:
    """Return the folder of the shipped configurations, or None if it is missing."""
    if (_PACKAGE / "configs").is_dir():
        return _PACKAGE / "configs"
    checkout = _PACKAGE.parent
    # A `configs` folder next to an installed package may belong to another program.
    if (checkout / "pyproject.toml").is_file() and (checkout / "configs").is_dir():
        return checkout / "configs"
    return None


def shipped_names() -> list[str]:
    """Return the names of all shipped configurations, sorted."""
    folder = shipped_folder()
    return [] if folder is None else sorted(path.stem for path in folder.glob("*.yaml"))


def shipped(name: str) -> Shipped:
    """Return the shipped configuration with a given name.

    Raises:
        ConfigError: there is no such configuration.
    """
    folder = shipped_folder()
    if folder is None or name not in shipped_names():
        raise ConfigError(
            name, (), f"no configuration of this name comes with evo-cpg{_hint(name)}"
        )
    path = folder / f"{name}.yaml"
    lines = path.read_text(encoding="utf-8").splitlines()
    head = itertools.takewhile(lambda line: line.startswith("# "), lines)
    about = " ".join(line.removeprefix("# ").strip() for line in head)
    summary = re.split(r"(?<=\.) (?=[A-Z])", about, maxsplit=1)[0].removesuffix(".")
    study = _STUDY.search(about)
    return Shipped(name, path, about, summary, " ".join(study.groups()) if study else "")


def find_config(given: Path | str, folders: bool = False) -> Path:
    """Return the file of a configuration: an existing file, or else the shipped one by name.

    If ``folders``, the path may also be a folder, of a run or a sweep.

    Raises:
        ConfigError: a name exists neither in the working folder nor among the shipped names.
    """
    path = Path(given)
    # Unlike the methods of `Path`, these functions accept names that no file can have.
    there = os.path.exists(path)
    if os.path.isfile(path) or (folders and there) or path.suffix or len(path.parts) != 1:
        return path
    name = path.name
    if name in shipped_names():
        return shipped(name).path
    if there:
        return path
    here = f"{name}.yaml"
    hint = f": did you mean {here!r}?" if os.path.isfile(here) else _hint(name)
    raise ConfigError(
        name, (), f"no such file here, and no configuration of this name comes with evo-cpg{hint}"
    )


def shipped_name(source: Path) -> str | None:
    """Return the name of a shipped file, or None if the file is not shipped."""
    folder = shipped_folder()
    own = folder is not None and resolved(source).parent == resolved(folder)
    return source.stem if own and source.stem in shipped_names() else None


def copy_shipped(name: str, folder: Path) -> Path:
    """Copy a configuration with the files that it names, without replacing any file.

    Args:
        name: name of the configuration.
        folder: destination, created if missing.

    Returns:
        Path of the copy. An existing file with the same contents is kept.

    Raises:
        ConfigError: the name does not exist, or an existing file has other contents. Nothing is
            copied then.
        OutputError: a folder or a file cannot be written.
    """
    from evo_cpg.io.load import load_config
    from evo_cpg.io.trust import recording_files

    source = shipped(name).path
    with recording_files() as named:
        load_config(source)
    root = source.parent.resolve()
    parts = {path: path.resolve().relative_to(root) for path in (source, *named)}
    for path, part in parts.items():
        copy = folder / part
        if copy.exists() and not (copy.is_file() and filecmp.cmp(path, copy, shallow=False)):
            raise ConfigError(
                copy,
                (),
                f"already exists and differs from the file of the shipped configuration {name}. "
                "Choose another folder",
            )
    for part in parts.values():
        make_folder((folder / part).parent)
    for path, part in parts.items():
        copy = folder / part
        if not copy.exists():
            contents = path.read_bytes()
            write_whole(copy, lambda file, contents=contents: file.write(contents))
    return folder / parts[source]


def _hint(name: str) -> str:
    """Return a hint for a wrong name: the nearest names, and how to list all of them."""
    near = question(similar(name, shipped_names()))
    return f"{f': {near}' if near else '.'} `evo-cpg configs` lists all names"
