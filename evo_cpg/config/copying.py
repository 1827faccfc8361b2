"""Copies of the configurations that come with the program, for a user to change."""

import filecmp
from pathlib import Path

from evo_cpg.config.errors import ConfigError
from evo_cpg.config.load import load_config
from evo_cpg.config.shipped import shipped
from evo_cpg.config.trust import noting
from evo_cpg.files import write_whole


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
    for part in parts.values():
        (folder / part).parent.mkdir(parents=True, exist_ok=True)
    for path, part in parts.items():
        copy = folder / part
        if not copy.exists():
            contents = path.read_bytes()
            write_whole(copy, lambda file, contents=contents: file.write(contents))
    return folder / parts[source]
