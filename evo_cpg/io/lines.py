"""Files and lines of the values of a configuration."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from evo_cpg.io.errors import ConfigError, Key, KeyProblem
from evo_cpg.io.files import read_small
from evo_cpg.io.keys import follow
from evo_cpg.io.yaml_text import compose_yaml, parse_yaml


@contextlib.contextmanager
def located(source: Path | str, data: Any = None) -> Iterator[None]:
    """Convert a `KeyProblem` into a `ConfigError`, with the file and line of its key.

    Args:
        source: file of the configuration.
        data: contents of the configuration with overrides, whose values get no line. If None, no
            error gets a line.
    """
    try:
        yield
    except ConfigError:
        raise
    except KeyProblem as error:
        raise _with_line(source, error, data) from None


def _with_line(source: Path | str, error: KeyProblem, data: Any) -> ConfigError:
    path, key = Path(source), error.key
    if key and data is not None:
        value, known = follow(data, key)
        for own in _places(path, key):
            found = _find(*own)
            if found is not None and found[2] == len(key) - known and _is_of(found[1], value):
                return ConfigError(own[0], key, error.problem, found[0])
    return ConfigError(source, key, error.problem)


def _is_of(written: Any, value: Any) -> bool:
    """Return whether a value is the written one, in which defaults may be added to sections."""
    if isinstance(written, dict) and isinstance(value, dict):
        return all(key in value and _is_of(each, value[key]) for key, each in written.items())
    return bool(written == value)


def _places(path: Path, key: Key) -> list[tuple[Path, Key]]:
    """Return the files, and the keys in them, that may contain a value."""
    places: list[tuple[Path, Key]] = [(path, key)]
    if key[:1] == ("creature",):
        for name in (("creature", "file"), ("creature",)):
            found = _find(path, name)
            if found is not None and isinstance(found[1], str):
                return [(path.parent / found[1], key[1:]), *places]
    return places


def _find(path: Path, key: Key) -> tuple[int, Any, int] | None:
    """Return the line of a key, its value, and the number of missing parts of the key.

    For a missing key the line is that of the enclosing section.
    """
    try:
        text = read_small(path)
        node, data = compose_yaml(text), parse_yaml(text)
    except (OSError, ValueError, yaml.YAMLError):
        return None
    value, known = follow(data, key)
    line = None
    for part in key[:known]:
        if isinstance(node, yaml.MappingNode):
            pairs = {own.value: (own, inner) for own, inner in node.value}
            if part not in pairs:
                return None
            named, node = pairs[part]
            line = named.start_mark.line
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int):
            node = node.value[part]
            line = node.start_mark.line
    return None if line is None else (line + 1, value, len(key) - known)
