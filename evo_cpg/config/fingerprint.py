"""What a run was made with, in digests, and what has changed since."""

import hashlib
import json
from collections.abc import Mapping
from typing import Any

from evo_cpg.config.own_classes import code_digests
from evo_cpg.config.schema.experiment import ExperimentConfig


def fingerprint(config: ExperimentConfig) -> dict[str, dict[str, str]]:
    """SHA-256 of every part of a configuration, and of the user's own code, once it is built.

    Returns:
        ``config``, by keys of one or two parts (``seed``, ``evolution.population``), and ``code``,
        by module.
    """
    parts: dict[str, str] = {}
    for name, section in config.model_dump(mode="json").items():
        inner = section if isinstance(section, dict) else {"": section}
        for key, value in inner.items():
            text = json.dumps(value, sort_keys=True).encode()
            parts[f"{name}.{key}".rstrip(".")] = hashlib.sha256(text).hexdigest()
    return {"config": parts, "code": code_digests(config)}


def changes(before: Any, now: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Names of what differs between two fingerprints: config keys, then modules.

    Args:
        before: as it was read; nothing is known of what it lacks.
        now: the present one.
    """
    found = []
    for kind, said in (("config", "{}"), ("code", "the source of {}")):
        old = before.get(kind) if isinstance(before, dict) else None
        if not isinstance(old, dict):
            continue
        names = {*old, *now[kind]}
        found += [
            said.format(name) for name in sorted(names) if old.get(name) != now[kind].get(name)
        ]
    return found
