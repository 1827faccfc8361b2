"""In which line of which file a value of a configuration stands."""

from pathlib import Path
from typing import Any

import yaml

from evo_cpg.config.errors import ConfigError, Key
from evo_cpg.config.files import read_small
from evo_cpg.config.yaml_text import compose_yaml, parse_yaml


def with_line(error: ConfigError, data: Any) -> ConfigError:
    """Return the error with the line of its key; as it is if the value stands in no file.

    Args:
        error: about a configuration that came from a file.
        data: the contents with overrides: what these changed stands in no line.
    """
    path, key = Path(error.source), error.key
    if error.line is not None or not key:
        return error
    value, known = _inside(data, key)
    for own in _places(path, key):
        found = _find(*own)
        if found is not None and found[1:] == (value, len(key) - known):
            return ConfigError(own[0], error.key, error.problem, found[0])
    return error


def _places(path: Path, key: Key) -> list[tuple[Path, Key]]:
    """Return the files and the keys in them at which a value may stand."""
    places: list[tuple[Path, Key]] = [(path, key)]
    if key[:1] == ("creature",):
        for name in (("creature", "file"), ("creature",)):
            found = _find(path, name)
            if found is not None and isinstance(found[1], str):
                return [(path.parent / found[1], key[1:]), *places]
    return places


def _find(path: Path, key: Key) -> tuple[int, Any, int] | None:
    """Return the line of a key, the value there, and how many parts of the key are missing.

    Of a key that is missing it is the line of the section that lacks it.
    """
    try:
        text = read_small(path)
        node, data = compose_yaml(text), parse_yaml(text)
    except (OSError, ValueError, yaml.YAMLError):
        return None
    value, known = _inside(data, key)
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


def _inside(data: Any, key: Key) -> tuple[Any, int]:
    """Return the value at a key, or where that ends, and how much of the key there is."""
    for known, part in enumerate(key):
        try:
            data = data[part]
        except (IndexError, KeyError, TypeError):
            return data, known
    return data, len(key)
