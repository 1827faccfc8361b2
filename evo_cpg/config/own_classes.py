"""Classes of a user's own: found by ``module:Class``, built with options, known by their source."""

import ast
import hashlib
import importlib
import importlib.util
import inspect
import sys
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType
from typing import Any

from evo_cpg.config.errors import ConfigError, Key
from evo_cpg.config.schema.choice import CustomConfig
from evo_cpg.config.schema.experiment import ExperimentConfig
from evo_cpg.config.trust import code_folders, distrusted
from evo_cpg.system import with_working_folder


def own_parts(config: ExperimentConfig) -> list[tuple[tuple[str | int, ...], CustomConfig]]:
    """The parts of a configuration that are classes of the user's own, and their keys."""
    sensors, forces = enumerate(config.creature.sensors), enumerate(config.world.forces)
    parts: list[tuple[tuple[str | int, ...], Any]] = [
        *((("creature", "sensors", i), sensor) for i, sensor in sensors),
        *((("world", "forces", i), force) for i, force in forces),
        (("controller",), config.controller),
        (("task",), config.task),
        (("evolution",), config.evolution),
    ]
    return [(key, part) for key, part in parts if isinstance(part, CustomConfig)]


def build_own(given: CustomConfig, kind: type, key: Key, source: Path | str, **extra: Any) -> Any:
    """Build a user's own class, from its options and what it takes of ``extra``.

    Args:
        given: what the configuration says.
        kind: the class that it must derive from.
        key: of the section, for messages.
        source: file it came from, for messages.
        extra: keyword arguments for whoever takes them.

    Raises:
        ConfigError: there is no such class, or it cannot be built.
    """
    module_name, _, class_name = given.type.partition(":")
    try:
        made = getattr(importlib.import_module(module_name), class_name)
    except Exception as error:
        # Whatever the user's module raises is about the user's module.
        raise ConfigError(
            source,
            (*key, "type"),
            f"{given.type!r} cannot be imported ({type(error).__name__}: {error})",
        ) from None
    if not (isinstance(made, type) and issubclass(made, kind)):
        raise ConfigError(
            source,
            (*key, "type"),
            f"{given.type!r} is not a subclass of {kind.__module__}:{kind.__name__}",
        )
    taken = inspect.signature(made).parameters
    try:
        return made(**given.options, **{name: extra[name] for name in extra if name in taken})
    except Exception as error:
        # Whatever the user's class raises is about the user's class; some messages are but a key.
        known = isinstance(error, (TypeError, ValueError))
        words = f"{error}" if known else f"{type(error).__name__}: {error}"
        problem = f"{given.type} cannot be built with them ({words})"
        raise ConfigError(source, (*key, "options"), problem) from None


def require_code(config: ExperimentConfig, source: Path | str, folders: Iterable[Path]) -> None:
    """Check that the modules of a user's own classes can be found; none is imported.

    Args:
        config: which names them.
        source: file it came from, for messages.
        folders: where they may lie, but are not looked for unless they are trusted.

    Raises:
        ConfigError: one cannot, or another one of its name would be taken.
    """
    folders = tuple(folders)
    for key, part in own_parts(config):
        module = part.type.partition(":")[0]
        top = module.partition(".")[0]
        if not top:
            # One of a package that there is none of, as importing it says.
            continue
        there, found = _found(top)
        if not there:
            raise ConfigError(
                source,
                (*key, "type"),
                f"{part.type!r} cannot be imported (no module {top!r}"
                f"{distrusted(module, folders)})",
            )
        own = _file_in(with_working_folder(code_folders(folders)), top)
        if None not in (own, found) and own != found:
            raise ConfigError(
                source,
                (*key, "type"),
                f"{part.type!r} would be that of {found}, which has the name of {own}; rename one "
                "of the two, or use a process for each",
            )


def code_digests(config: ExperimentConfig) -> dict[str, str]:
    """SHA-256 of the source of the user's own classes, by module, once they are built.

    Modules that these import count as well where they lie in the same folder or below it.
    """
    digests: dict[str, str] = {}
    for _, part in own_parts(config):
        module = sys.modules[part.type.partition(":")[0]]
        path = _source_of(module)
        if path is not None:
            _digest(module, path, path.parent, digests)
    return digests


def _found(top: str) -> tuple[bool, Path | None]:
    """Whether there is such a module or package, and the file that importing it takes, if any."""
    try:
        spec = importlib.util.find_spec(top)
    except ValueError:
        # Loaded, by something that does not say from where.
        return True, None
    file = None if spec is None else spec.origin
    return spec is not None, Path(file).resolve() if file else None


def _file_in(folders: Iterable[Path], top: str) -> Path | None:
    """The file of a module or package in the first folder that has one."""
    for folder in folders:
        for file in (folder / top / "__init__.py", folder / f"{top}.py"):
            if file.is_file():
                return file.resolve()
    return None


def _digest(module: ModuleType, path: Path, folder: Path, digests: dict[str, str]) -> None:
    """Add the digests of a module and of what it imports from a folder."""
    if module.__name__ in digests:
        return
    text = path.read_bytes()
    digests[module.__name__] = hashlib.sha256(text).hexdigest()
    for name in _imported(ast.parse(text), module):
        other = sys.modules.get(name)
        found = None if other is None else _source_of(other)
        if other is not None and found is not None and folder in found.parents:
            _digest(other, found, folder, digests)


def _imported(tree: ast.AST, module: ModuleType) -> Iterable[str]:
    """Names of the modules that a module's source imports, and some that are none."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            name = node.module or ""
            if node.level:
                package = module.__package__ or ""
                base = package.rsplit(".", node.level - 1)[0] if node.level > 1 else package
                name = f"{base}.{name}".strip(".")
            yield name
            yield from (f"{name}.{alias.name}" for alias in node.names)


def _source_of(module: ModuleType) -> Path | None:
    file = getattr(module, "__file__", None)
    path = Path(file).resolve() if file else None
    return path if path is not None and path.suffix == ".py" and path.is_file() else None
