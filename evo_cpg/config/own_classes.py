"""Code of a user's own classes: where it is found, and digests of its source."""

import ast
import hashlib
import importlib.util
import sys
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType
from typing import Any

from evo_cpg.config.errors import Key, KeyProblem
from evo_cpg.config.schema.choice import CustomConfig
from evo_cpg.config.schema.experiment import ExperimentConfig
from evo_cpg.config.trust import code_folders, distrusted
from evo_cpg.system import with_working_folder


def own_parts(config: ExperimentConfig) -> dict[Key, CustomConfig]:
    """The parts of a configuration that are classes of the user's own, by their keys."""
    parts: dict[Key, Any] = {
        **{("creature", "sensors", i): part for i, part in enumerate(config.creature.sensors)},
        **{("world", "forces", i): part for i, part in enumerate(config.world.forces)},
        **{(name,): getattr(config, name) for name in ("controller", "task", "evolution")},
    }
    return {key: part for key, part in parts.items() if isinstance(part, CustomConfig)}


def require_code(config: ExperimentConfig, folders: Iterable[Path]) -> None:
    """Check that the modules of a user's own classes can be found; none is imported.

    Args:
        config: which names them.
        folders: where they may lie, but are not looked for unless they are trusted.

    Raises:
        KeyProblem: one cannot, or another one of its name would be taken.
    """
    folders = tuple(folders)
    for key, part in own_parts(config).items():
        module = part.type.partition(":")[0]
        top = module.partition(".")[0]
        if not top:
            # One of a package that there is none of, as importing it says.
            continue
        there, found = _found(top)
        if not there:
            problem = f"cannot be imported (no module {top!r}{distrusted(module, folders)})"
            raise KeyProblem((*key, "type"), f"{part.type!r} {problem}")
        own = _file_in(with_working_folder(code_folders(folders)), top)
        if None not in (own, found) and own != found:
            raise KeyProblem(
                (*key, "type"),
                f"{part.type!r} would be that of {found}, which has the name of {own}; rename one "
                "of the two, or use a process for each",
            )


def code_digests(config: ExperimentConfig) -> dict[str, str]:
    """SHA-256 of the source of the user's own classes, by module, once they are built.

    Modules that these import count as well where they lie in the same folder or below it.
    """
    digests: dict[str, str] = {}
    for part in own_parts(config).values():
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
