"""Digests of the configuration and code of a run, and their changes."""

import ast
import hashlib
import json
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

from evo_cpg.config.former import without_former_values
from evo_cpg.config.own_classes import own_parts
from evo_cpg.config.schema.choice import CustomConfig
from evo_cpg.config.schema.experiment import ExperimentConfig

_SOURCE = "the source of "
# First words of changes that leave every individual's fitness as it is. `changes_of_fitness` lists
# the exceptions.
_HARMLESS = (
    *("name", "seed", "runs", "creature.name", "evolution.", "audit.", "measures", "engine"),
    *("instruction_set", _SOURCE),
)


def fingerprint(config: ExperimentConfig) -> dict[str, dict[str, str]]:
    """Return SHA-256 digests of a configuration and of the user's own code, after its import.

    Returns:
        ``config``, by keys of one or two parts (``seed``, ``evolution.population``), and ``code``,
        by module.
    """
    parts = {
        key: hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()
        for key, value in _by_key(without_former_values(config.model_dump(mode="json")))
    }
    return {"config": parts, "code": _code_digests(own_parts(config).values())}


def changes_since(before: Any, config: ExperimentConfig) -> list[str]:
    """Return the differences between an earlier fingerprint and a configuration.

    A key that the earlier version lacked is unchanged at its default.

    Args:
        before: earlier fingerprint, perhaps of an earlier version.
        config: the present configuration.
    """
    now = fingerprint(config)
    known = before.get("config") if isinstance(before, dict) else None
    given = {key for key, _ in _by_key(config.model_dump(exclude_defaults=True))}
    new = now["config"].keys() - (known if isinstance(known, dict) else {}) - given
    return [each for each in changes(before, now) if each not in new]


def changes_of_fitness(before: Any, config: ExperimentConfig) -> list[str]:
    """Return the changes that may change fitness, or an elite's place on its map."""
    parts = [part for key, part in own_parts(config).items() if key != ("evolution",)]
    harmful = ["evolution.axes", *(_SOURCE + module for module in _code_digests(parts))]
    harmful += [f"audit.{name}" for name in ("disqualify", *config.audit.disqualify)]
    if not config.noise.silent:
        # The seed determines the noise with which an individual was evaluated.
        harmful.append("seed")
    found = changes_since(before, config)
    return [each for each in found if each in harmful or not each.startswith(_HARMLESS)]


def changes(before: Any, now: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Return the differences between two fingerprints: configuration keys, then modules.

    Args:
        before: earlier fingerprint, in which missing kinds are ignored.
        now: current fingerprint.
    """
    found = []
    for kind, form in (("config", "{}"), ("code", _SOURCE + "{}")):
        old = before.get(kind) if isinstance(before, dict) else None
        if not isinstance(old, dict):
            continue
        names = {*old, *now[kind]}
        found += [
            form.format(name).replace("simulation.steps", "simulation.seconds")
            for name in sorted(names)
            if old.get(name) != now[kind].get(name)
        ]
    return found


def _by_key(sections: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield the values of a configuration by keys of one or two parts."""
    for name, section in sections.items():
        inner = section if isinstance(section, dict) else {"": section}
        for key, value in inner.items():
            yield f"{name}.{key}".rstrip("."), value


def _code_digests(parts: Iterable[CustomConfig]) -> dict[str, str]:
    """Return SHA-256 digests of the source of the user's own classes, by imported module.

    Imported modules are included if they are in the same folder or below it.
    """
    digests: dict[str, str] = {}
    for part in parts:
        module = sys.modules[part.type.partition(":")[0]]
        path = _source_of(module)
        if path is not None:
            _digest(module, path, path.parent, digests)
    return digests


def _digest(module: ModuleType, path: Path, folder: Path, digests: dict[str, str]) -> None:
    """Add the digests of a module and of the modules that it imports from a folder."""
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
    """Yield the names that a module's source imports, including some that are not modules."""
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
