"""The user's own classes in a configuration, and the files of their code."""

import importlib.util
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from evo_cpg.io.errors import Key, KeyProblem
from evo_cpg.io.schema.choice import CustomConfig
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.io.trust import code_folders, distrusted
from evo_cpg.system import with_working_folder


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

    Args:
        config: configuration that names the classes.
        folders: folders that may contain the modules, searched only if they are trusted.

    Raises:
        KeyProblem: a module cannot be found, or another module of its name would be imported.
    """
    folders = tuple(folders)
    for key, part in own_parts(config).items():
        module = part.type.partition(":")[0]
        top = module.partition(".")[0]
        if not top:
            # The name of the module is relative, but there is no package. The import reports the
            # error.
            continue
        there, found = _found(top)
        if not there:
            problem = f"cannot be imported (no module {top!r}){distrusted(module, folders)}"
            raise KeyProblem((*key, "type"), f"{part.type!r} {problem}")
        own = _file_in(with_working_folder(code_folders(folders)), top)
        if None not in (own, found) and own != found:
            raise KeyProblem(
                (*key, "type"),
                f"{part.type!r} would import {found} instead of {own}. Rename one of the two "
                "modules, or use a process for each",
            )


def _found(top: str) -> tuple[bool, Path | None]:
    """Return whether a module or package exists, and the file that its import uses, if any."""
    try:
        spec = importlib.util.find_spec(top)
    except ValueError:
        # The module is loaded, without a record of its origin.
        return True, None
    file = None if spec is None else spec.origin
    return spec is not None, Path(file).resolve() if file else None


def _file_in(folders: Iterable[Path], top: str) -> Path | None:
    """Return the file of a module or package in the first folder that contains it."""
    for folder in folders:
        for file in (folder / top / "__init__.py", folder / f"{top}.py"):
            if file.is_file():
                return file.resolve()
    return None
