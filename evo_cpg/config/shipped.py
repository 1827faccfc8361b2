"""The configurations that come with the program, which go by their names.

In a checkout they are the files of its ``configs/``; a wheel holds these beside the modules.
"""

import filecmp
import os
import re
from pathlib import Path
from typing import NamedTuple

from evo_cpg.config.errors import ConfigError, nearest
from evo_cpg.files import write_whole
from evo_cpg.system import resolved

_PACKAGE = Path(__file__).parents[1]

# "Iwadate, Suzuki, Yamamoto and Furukawa 2010", "Fukui 2003".
_STUDY = re.compile(r"\b([A-Z][a-z]+)(?:, [A-Za-z, ]+)? ((?:19|20)\d\d)\b")


class Shipped(NamedTuple):
    """A configuration that comes with the program.

    Attributes:
        name: that it goes by.
        path: its file.
        about: the comment at the top of the file, on one line.
        summary: what it is, the first sentence of that.
        study: that it repeats or starts from, as "Fukui 2003"; empty where it is ours alone.
    """

    name: str
    path: Path
    about: str
    summary: str
    study: str


def shipped_folder() -> Path | None:
    """Where they lie; None where a part of the program is missing."""
    if (_PACKAGE / "configs").is_dir():
        return _PACKAGE / "configs"
    checkout = _PACKAGE.parent
    # Beside an installed package may lie anybody's `configs`.
    if (checkout / "pyproject.toml").is_file() and (checkout / "configs").is_dir():
        return checkout / "configs"
    return None


def shipped_names() -> list[str]:
    """The names of all, in the order of the alphabet."""
    folder = shipped_folder()
    return [] if folder is None else sorted(path.stem for path in folder.glob("*.yaml"))


def shipped(name: str) -> Shipped:
    """The one of a name.

    Raises:
        ConfigError: there is none.
    """
    folder = shipped_folder()
    if folder is None or name not in shipped_names():
        raise ConfigError(
            name,
            (),
            f"no configuration of this name comes with evo-cpg; {nearest(name, shipped_names())}",
        )
    path = folder / f"{name}.yaml"
    about = _head(path.read_text(encoding="utf-8"))
    summary = re.split(r"(?<=\.) (?=[A-Z])", about, maxsplit=1)[0].removesuffix(".")
    study = _STUDY.search(about)
    return Shipped(name, path, about, summary, " ".join(study.groups()) if study else "")


def find_config(given: Path | str, folders: bool = False) -> Path:
    """The file of a configuration: one that is there, or else the shipped one of that name.

    Args:
        given: a path, or a name without a folder and a suffix.
        folders: whether a folder is meant as well, a run or a sweep.

    Raises:
        ConfigError: it is a name, of nothing in the working folder and of none that is shipped.
    """
    path = Path(given)
    # Unlike a path's own methods these do not complain of names that no file can have.
    there = os.path.exists(path)
    if os.path.isfile(path) or (folders and there) or path.suffix or len(path.parts) != 1:
        return path
    name = path.name
    if name in shipped_names():
        return shipped(name).path
    if there:
        return path
    hint = f"did you mean '{name}.yaml'? " if os.path.isfile(f"{name}.yaml") else ""
    raise ConfigError(
        name,
        (),
        "no such file here, and no configuration of this name comes with evo-cpg; "
        f"{hint}{nearest(name, shipped_names())}",
    )


def shipped_name(source: Path) -> str | None:
    """The name that a file goes by; None where it is none of those that come with the program."""
    folder = shipped_folder()
    own = folder is not None and resolved(source).parent == resolved(folder)
    return source.stem if own and source.stem in shipped_names() else None


def copy_shipped(name: str, folder: Path) -> Path:
    """Copy a configuration, with the files that it names, and replace nothing.

    Args:
        name: of the configuration.
        folder: where to; it is made where it is missing.

    Returns:
        The copy. A file that is there already and has the same contents stays as it is.

    Raises:
        ConfigError: there is none of this name, or a file that is there already has other contents;
            then nothing was copied.
        OSError: a folder cannot be made.
        RunFolderError: a file cannot be written.
    """
    from evo_cpg.config.load import load_config
    from evo_cpg.config.trust import recording_files

    source = shipped(name).path
    with recording_files() as named:
        load_config(source)
    root = source.parent.resolve()
    parts = {path: path.resolve().relative_to(root) for path in (source, *named)}
    for path, part in parts.items():
        copy = folder / part
        if copy.exists() and not (copy.is_file() and filecmp.cmp(path, copy, shallow=False)):
            raise ConfigError(
                copy, (), f"exists already, and is not that of {name}; name another folder"
            )
    for part in parts.values():
        (folder / part).parent.mkdir(parents=True, exist_ok=True)
    for path, part in parts.items():
        copy = folder / part
        if not copy.exists():
            contents = path.read_bytes()
            write_whole(copy, lambda file, contents=contents: file.write(contents))
    return folder / parts[source]


def _head(text: str) -> str:
    """The comment that a file begins with, up to its first empty line, on one line."""
    words: list[str] = []
    for line in text.splitlines():
        if not line.startswith("# "):
            break
        words.append(line.removeprefix("# ").strip())
    return " ".join(words)
