"""From a YAML file and overrides to a checked configuration."""

import contextlib
import copy
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import pydantic
import yaml

from evo_cpg.config.errors import ConfigError, Key, nearest
from evo_cpg.config.files import read_small
from evo_cpg.config.meshes import read_mesh
from evo_cpg.config.schema.creature import CreatureConfig
from evo_cpg.config.schema.experiment import ExperimentConfig
from evo_cpg.config.shipped import shipped_names
from evo_cpg.config.terrain import read_heights
from evo_cpg.config.trust import beside, trusting
from evo_cpg.config.yaml_text import parse_yaml, to_yaml
from evo_cpg.system import as_utf8

# What pydantic calls an unknown key, in models and in dataclasses.
_LENGTH = ("too_short", "too_long")
_UNKNOWN_KEY = ("extra_forbidden", "unexpected_keyword_argument")


def load_config(path: Path | str, overrides: Sequence[str] = ()) -> ExperimentConfig:
    """Read and check a configuration file.

    Args:
        path: the YAML file.
        overrides: ``key.path=value`` with a YAML value, applied in order.

    Raises:
        ConfigError: anything that is wrong with it, in words for the user.
    """
    path = Path(path)
    return complete_config(read_yaml(path), path, overrides)


def complete_config(
    data: dict[str, Any], source: Path, overrides: Sequence[str] = ()
) -> ExperimentConfig:
    """Check the contents of a configuration file, with those of the files that it names.

    Args:
        data: the contents.
        source: the file; others are looked for beside it.
        overrides: ``key.path=value`` with a YAML value, applied in order.

    Raises:
        ConfigError: anything that is wrong with it, in words for the user.
    """
    data = copy.deepcopy(data)
    _read_files(data, source)
    for key, entry in _mesh_entries(data):
        if isinstance(entry["shape"].get("file"), str):
            beside(source, entry["shape"]["file"], (*key, "file"))
    for override in overrides:
        _apply(data, override)
        # What the command line names may lie anywhere.
        with trusting():
            _read_files(data, source)
    with trusting():
        _read_meshes(data, source)
    return check_config(data, source)


def check_config(data: dict[str, Any], source: Path | str) -> ExperimentConfig:
    """Check the contents of a configuration file.

    Raises:
        ConfigError: anything that is wrong with it.
    """
    try:
        config = ExperimentConfig.model_validate(data)
    except pydantic.ValidationError as error:
        raise _worded(error, data, source) from None
    for key, value, problem in _misread(data, config.model_dump()):
        raise ConfigError(source, key, f"{_short(value)}: {problem}")
    for key, name, valid in config.creature.references():
        if name not in valid:
            raise ConfigError(
                source, ("creature", *key), f"{name!r} does not exist; {nearest(name, valid)}"
            )
    return config


def dump_config(config: ExperimentConfig) -> str:
    """The complete configuration as YAML, from which `load_config` makes an equal one."""
    return to_yaml(config.model_dump(mode="json"))


def dump_creature(config: CreatureConfig) -> str:
    """A creature's own file, without what has its default, from which an equal one is read."""
    return to_yaml(config.model_dump(mode="json", exclude_defaults=True), flow=None)


def as_overrides(values: Mapping[str, Any]) -> list[str]:
    """Settings as they stand on the command line, ``key=value``."""
    return [f"{key}={to_yaml([value], flow=True).strip()[1:-1]}" for key, value in values.items()]


def read_yaml(path: Path) -> dict[str, Any]:
    """The contents of a YAML file.

    Raises:
        ConfigError: it cannot be read, or holds something else than keys and values.
    """
    try:
        text = read_small(path)
    except FileNotFoundError:
        raise ConfigError(path, (), f"no such file{_elsewhere(path)}") from None
    except OSError as error:
        raise ConfigError(path, (), f"cannot be read ({error.strerror})") from None
    except UnicodeDecodeError as error:
        raise ConfigError(path, (), f"is not UTF-8 text (byte {error.start} is wrong)") from None
    except ValueError:
        raise ConfigError(path, (), "is no name of a file") from None
    try:
        data = parse_yaml(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        problem = getattr(error, "problem", None) or getattr(error, "reason", "cannot be parsed")
        raise ConfigError(path, (), f"{place}not valid YAML: {problem}") from None
    if data is None:
        raise ConfigError(path, (), "is empty; it must be a YAML mapping of keys to values")
    if not isinstance(data, dict):
        raise ConfigError(path, (), "must be a YAML mapping of keys to values")
    return data


def _read_files(data: dict[str, Any], path: Path) -> None:
    """Put the contents of other files in the place of their names, so that one file holds all."""
    creature = data.get("creature")
    if isinstance(creature, str):
        creature = {"file": creature}
    if isinstance(creature, dict) and "file" in creature:
        name, changes = creature["file"], {k: v for k, v in creature.items() if k != "file"}
        if not isinstance(name, str):
            raise ConfigError(path, ("creature", "file"), "must be the path of a creature's file")
        folder = Path(name).parent
        data["creature"] = read_yaml(beside(path, name, ("creature", "file"))) | changes
        for _, entry in _mesh_entries(data):
            if isinstance(entry["shape"].get("file"), str):
                entry["shape"] = entry["shape"] | {"file": str(folder / entry["shape"]["file"])}
    floor: Any = data
    for key in ("world", "ground", "floor"):
        floor = floor.get(key) if isinstance(floor, dict) else None
    if isinstance(floor, dict) and floor.get("type") == "relief" and "file" in floor:
        given = {key: floor.pop(key) for key in ("file", "lowest", "highest") if key in floor}
        floor["heights"] = read_heights(path, **given)


def _read_meshes(data: dict[str, Any], path: Path) -> None:
    """Put the vertices and faces of mesh files in the place of their names, each file once."""
    found: dict[str, dict[str, Any]] = {}
    for key, entry in _mesh_entries(data):
        shape = entry["shape"]
        if repr(shape) not in found:
            found[repr(shape)] = read_mesh(path, key, shape)
        entry["shape"] = found[repr(shape)]


def _mesh_entries(data: dict[str, Any]) -> Iterator[tuple[Key, dict[str, Any]]]:
    """The bodies whose shape is the mesh of a file, and the keys of their shapes.

    What has neither vertices nor faces is meant to have a file.
    """
    creature = data.get("creature")
    bodies = creature.get("bodies") if isinstance(creature, dict) else None
    for i, entry in enumerate(bodies if isinstance(bodies, list) else []):
        shape = entry.get("shape") if isinstance(entry, dict) else None
        if not isinstance(shape, dict) or shape.get("type") != "mesh":
            continue
        if "file" in shape or not {"vertices", "faces"} & set(shape):
            yield ("creature", "bodies", i, "shape"), entry


def _misread(given: Any, made: Any) -> Iterator[tuple[tuple[str | int, ...], Any, str]]:
    """Values that were taken for numbers but are none: booleans, quoted text, infinities."""
    if isinstance(given, dict) and isinstance(made, Mapping):
        inner = [(name, value, made[name]) for name, value in given.items() if name in made]
    elif isinstance(given, list) and isinstance(made, (list, tuple)):
        inner = [(i, *pair) for i, pair in enumerate(zip(given, made, strict=False))]
    else:
        number = isinstance(made, (int, float)) and not isinstance(made, bool)
        if number and not math.isfinite(made):
            yield (), given, "must be a finite number"
        elif number and isinstance(given, (bool, str)):
            yield (), given, "must be a number"
        elif isinstance(made, bool) and not isinstance(given, bool):
            yield (), given, "must be true or false"
        return
    for name, value, result in inner:
        for key, wrong, problem in _misread(value, result):
            yield (name, *key), wrong, problem


def _elsewhere(path: Path) -> str:
    """Where a file that is missing may be instead: among those that are shipped, or near it."""
    if path.stem in shipped_names():
        return f"; that which comes with evo-cpg is called {path.stem}"
    names = []
    # There may be no such folder, or none that may be read.
    with contextlib.suppress(OSError):
        names = [other.name for other in path.parent.iterdir() if other.suffix in (".yaml", ".yml")]
    return f"; {nearest(path.name, names)}" if names else ""


def _apply(data: dict[str, Any], override: str) -> None:
    """Set one value of the raw configuration."""
    key, separator, text = override.partition("=")
    if not separator or not key:
        raise ConfigError("command line", (), f"{override!r} is not of the form key.path=value")
    text = as_utf8(text)
    if any("\ud800" <= character <= "\udfff" for character in text):
        raise ConfigError("command line", key.split("."), f"{text!a} is not UTF-8 text")
    try:
        value = parse_yaml(text)
    except yaml.YAMLError:
        raise ConfigError("command line", key.split("."), f"{text!r} is not YAML") from None
    *parents, last = key.split(".")
    place: Any = data
    for i, part in enumerate(parents):
        if isinstance(place, dict):
            place = place.setdefault(part, {})
        elif isinstance(place, list) and is_index(part, place):
            place = place[int(part)]
        else:
            raise ConfigError(
                "command line", key.split("."), f"{'.'.join(parents[:i])} has no {part}"
            )
    if isinstance(place, list) and is_index(last, place):
        place[int(last)] = value
    elif isinstance(place, dict):
        place[last] = value
    else:
        raise ConfigError("command line", key.split("."), f"{'.'.join(parents)} has no {last}")


def is_index(part: str, place: list[Any]) -> bool:
    """Whether a part of a key, as ``bodies.1`` has it, is the number of an entry of a list."""
    return part.isascii() and part.isdigit() and int(part) < len(place)


def _worded(
    error: pydantic.ValidationError, data: dict[str, Any], source: Path | str
) -> ConfigError:
    """The first problem, in words. Unknown keys go first: a typo explains what is missing."""
    problems = sorted(error.errors(), key=lambda p: p["type"] not in _UNKNOWN_KEY)
    problem = problems[0]
    key = _key_in(data, problem["loc"], problem["type"] == "missing")
    kind, given = problem["type"], problem.get("input")
    if kind in _UNKNOWN_KEY:
        tags = frozenset(part for part in problem["loc"] if isinstance(part, str))
        valid = _siblings(ExperimentConfig, data, key[:-1], tags)
        # A key of a section, without the section.
        inner = [
            f"{section}.{key[0]}"
            for section in (valid if len(key) == 1 else ())
            if key[0] in _siblings(ExperimentConfig, {section: {}} | data, (section,))
        ]
        hint = f"did you mean {' or '.join(inner)}?" if inner else nearest(str(key[-1]), valid)
        return ConfigError(source, key, f"unknown key; {hint}")
    if kind == "missing":
        beside = [p["loc"][-1] for p in problems if p["loc"][:-1] == problem["loc"][:-1]]
        missing = [place + 1 for place in beside if isinstance(place, int)]
        if missing:
            return ConfigError(source, key, f"{_short(given)}: {max(missing)} values are needed")
        return ConfigError(source, key, "is missing and has no default")
    message = problem["msg"].removeprefix("Value error, ")
    if kind == "value_error":
        return ConfigError(source, key, message)
    if kind == "union_tag_not_found" and isinstance(given, dict):
        return ConfigError(source, (*key, "type"), "is missing and has no default")
    if kind.startswith("union_tag"):
        allowed = problem.get("ctx", {}).get("expected_tags", "")
        allowed = allowed.replace("'custom'", "or module:Class for your own")
        found = given.get("type") if isinstance(given, dict) else given
        return ConfigError(source, (*key, "type"), f"{found!r} is not known; allowed: {allowed}")
    if kind in _LENGTH:
        limits = problem.get("ctx", {})
        if kind == "too_short":
            words = f"at least {limits.get('min_length')}"
        else:
            words = f"at most {limits.get('max_length')}"
        count = limits.get("actual_length")
        return ConfigError(source, key, f"{_short(given)}: must have {words}, has {count}")
    more = f" ({len(problems)} problems in all)" if len(problems) > 1 else ""
    return ConfigError(source, key, f"{_short(given)}: {_lower(message)}{more}")


def _key_in(data: Any, location: Key, missing: bool) -> tuple[str | int, ...]:
    """A pydantic location without the names of union members, which are no keys of the file.

    Args:
        data: what was read.
        location: of the problem.
        missing: whether the problem is that there is no such key.
    """
    key: list[str | int] = []
    place: Any = data
    for i, part in enumerate(location):
        of_dict = isinstance(place, dict) and part in place
        of_list = isinstance(place, list) and isinstance(part, int) and part < len(place)
        if of_dict or of_list:
            key.append(part)
            place = cast(Any, place)[part]
        elif missing and i == len(location) - 1 and isinstance(place, dict):
            key.append(part)
    return tuple(key)


def _siblings(
    model: type[pydantic.BaseModel], data: Any, key: Key, tags: frozenset[str] = frozenset()
) -> list[str]:
    """Keys that are valid beside the one in question: those without which the part is refused.

    Args:
        model: of all that was read.
        data: what was read.
        key: of the part.
        tags: among them the kinds that pydantic took sections for which say no ``type``.
    """
    schema = model.model_json_schema()
    return sorted(_properties(schema, schema, data, key, tags))


def _properties(schema: dict, root: dict, data: Any, key: Key, tags: frozenset[str]) -> set[str]:
    """Property names of a JSON schema at a place, following references and the given types."""
    if "$ref" in schema:
        return _properties(root["$defs"][schema["$ref"].rsplit("/", 1)[-1]], root, data, key, tags)
    for choice in ("oneOf", "anyOf"):
        if choice in schema:
            chosen = _chosen(schema[choice], root, data, tags)
            return set().union(*(_properties(one, root, data, key, tags) for one in chosen))
    if not key:
        return set(schema.get("properties", {}))
    part = key[0]
    below = cast(Any, data)[part] if isinstance(data, (dict, list)) else None
    if isinstance(part, int):
        return _properties(schema.get("items", {}), root, below, key[1:], tags)
    inner = schema.get("properties", {}).get(part)
    if inner is None:
        inner = schema.get("additionalProperties", {})
    return _properties(inner, root, below, key[1:], tags) if isinstance(inner, dict) else set()


def _chosen(options: list[dict], root: dict, data: Any, tags: frozenset[str]) -> list[dict]:
    """Members of a union that the given ``type`` asks for; of classes of one's own it is another.

    Without one it is the kind among ``tags``, and where that does not tell, any.
    """
    kinds = [_kind(option, root) for option in options]
    given = data.get("type") if isinstance(data, dict) else None
    asked = {given} if given is not None else tags.intersection(filter(None, kinds))
    if not asked:
        return options
    exact = [option for option, kind in zip(options, kinds, strict=True) if kind in asked]
    return exact or [option for option, kind in zip(options, kinds, strict=True) if kind is None]


def _kind(option: dict, root: dict) -> str | None:
    """Which ``type`` a member of a union stands for; None where that may be any, or is none."""
    if "$ref" in option:
        option = root["$defs"][option["$ref"].rsplit("/", 1)[-1]]
    return option.get("properties", {}).get("type", {}).get("const")


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _lower(message: str) -> str:
    return message[:1].lower() + message[1:]
