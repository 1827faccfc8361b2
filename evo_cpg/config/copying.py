"""Copies of the configurations that come with the program, for a user to change."""

import filecmp
import shutil
from pathlib import Path

from evo_cpg.config.errors import ConfigError
from evo_cpg.config.load import load_config
from evo_cpg.config.shipped import shipped
from evo_cpg.config.trust import noting


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
        OSError: a file cannot be written.
    """
    source = shipped(name).path
    with noting() as named:
        load_config(source)
    root = source.parent.resolve()
    parts = {path: path.resolve().relative_to(root) for path in (source, *named)}
    for path, part in parts.items():
        copy = folder / part
        if copy.exists() and not (copy.is_file() and filecmp.cmp(path, copy, shallow=False)):
            raise ConfigError(
                copy, (), f"exists already, and is not that of {name}; name another folder"
            )
    for path, part in parts.items():
        copy = folder / part
        if not copy.exists():
            copy.parent.mkdir(parents=True, exist_ok=True)
            _copy_whole(path, copy)
    return folder / parts[source]


def _copy_whole(path: Path, copy: Path) -> None:
    """Copy a file so that it is there as a whole or not at all."""
    partial = copy.with_name(f".{copy.name}.partial")
    try:
        shutil.copyfile(path, partial)
        partial.replace(copy)
    finally:
        partial.unlink(missing_ok=True)
