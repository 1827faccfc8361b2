"""Digests of the configuration and code of a run, and their changes."""

import hashlib
import json
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.io.schema.section import CustomConfig
from evo_cpg.io.trust import own_parts

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
        for key, value in _by_key(config.model_dump(mode="json"))
    }
    return {"config": parts, "code": _code_digests(own_parts(config).values())}


def changes_of_fitness(before: Any, config: ExperimentConfig) -> list[str]:
    """Return the changes that may change fitness, or an elite's place on its map."""
    parts = [part for key, part in own_parts(config).items() if key != ("evolution",)]
    harmful = ["evolution.axes", *(_SOURCE + module for module in _code_digests(parts))]
    harmful += [f"audit.{name}" for name in ("disqualify", *config.audit.disqualify)]
    if not config.noise.silent:
        # The seed determines the noise with which an individual was evaluated.
        harmful.append("seed")
    found = changes(before, fingerprint(config))
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
            form.format(name) for name in sorted(names) if old.get(name) != now[kind].get(name)
        ]
    return found


def _by_key(sections: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield the values of a configuration by keys of one or two parts."""
    for name, section in sections.items():
        inner = section if isinstance(section, dict) else {"": section}
        for key, value in inner.items():
            yield f"{name}.{key}".rstrip("."), value


def _code_digests(parts: Iterable[CustomConfig]) -> dict[str, str]:
    """Return SHA-256 digests of the files of the user's own classes, by module."""
    digests = {}
    for part in parts:
        name = part.type.partition(":")[0]
        file = getattr(sys.modules[name], "__file__", None)
        if file and file.endswith(".py") and Path(file).is_file():
            digests[name] = hashlib.sha256(Path(file).read_bytes()).hexdigest()
    return digests
