"""From a YAML file and overrides to a checked configuration."""

import contextlib
import copy
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pydantic
import yaml

from evo_cpg.config.errors import ConfigError, Key, nearest
from evo_cpg.config.files import read_small
from evo_cpg.config.lines import with_line
from evo_cpg.config.meshes import read_mesh
from evo_cpg.config.schema.creature import CreatureConfig
from evo_cpg.config.schema.experiment import ExperimentConfig
from evo_cpg.config.shipped import shipped_names
from evo_cpg.config.terrain import read_heights
from evo_cpg.config.trust import beside, trusting
from evo_cpg.config.wording import short, worded
from evo_cpg.config.yaml_problem import lost_colour, syntax_problem
from evo_cpg.config.yaml_text import parse_yaml, to_yaml
from evo_cpg.system import as_utf8


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
    try:
        return check_config(data, source)
    except ConfigError as error:
        raise with_line(error, data) from None


def check_config(data: dict[str, Any], source: Path | str) -> ExperimentConfig:
    """Check the contents of a configuration file.

    Raises:
        ConfigError: anything that is wrong with it.
    """
    try:
        config = ExperimentConfig.model_validate(data)
    except pydantic.ValidationError as error:
        raise worded(error, ExperimentConfig, data, source) from None
    for key, value, problem in _misread(data, config.model_dump()):
        raise ConfigError(source, key, f"{short(value)}: {problem}")
    if twice := config.creature.named_twice():
        key, problem = twice
        raise ConfigError(source, ("creature", *key), problem)
    for key, name, valid in config.creature.references():
        if name not in valid:
            problem = f"{name!r} does not exist; {nearest(name, valid)}"
            if "*" in name:
                problem = f"{problem}; a name here may have placeholders such as {{i}}, but no *"
            raise ConfigError(source, ("creature", *key), problem)
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
        row = error.object[: error.start].count(b"\n") + 1
        problem = (
            f"is not UTF-8 text (byte {error.start} is wrong, in line {row}); save it as UTF-8"
        )
        raise ConfigError(path, (), problem) from None
    except ValueError:
        raise ConfigError(path, (), "is no name of a file") from None
    try:
        data = parse_yaml(text)
    except yaml.YAMLError as error:
        place, problem = syntax_problem(text, error)
        where = f"{place}: " if place else ""
        raise ConfigError(path, (), f"{where}not valid YAML: {problem}") from None
    if lost := lost_colour(text):
        raise ConfigError(path, (), lost)
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
        floor["heights"] = read_heights(path, given)


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
    except yaml.YAMLError as error:
        _, problem = syntax_problem(text, error)
        words = f"{text!r} is not YAML: {problem}"
        raise ConfigError("command line", key.split("."), words) from None
    *parents, last = key.split(".")
    place: Any = data
    for i, part in enumerate(parents):
        if isinstance(place, dict):
            place = place.setdefault(part, {})
        elif isinstance(place, list) and is_index(part, place):
            place = place[int(part)]
        else:
            problem = _lacks(".".join(parents[:i]), part, place)
            raise ConfigError("command line", key.split("."), problem)
    if isinstance(place, list) and is_index(last, place):
        place[int(last)] = value
    elif isinstance(place, dict):
        place[last] = value
    else:
        problem = _lacks(".".join(parents), last, place)
        raise ConfigError("command line", key.split("."), problem)


def _lacks(key: str, part: str, place: Any) -> str:
    """Return what is wrong with a part of a key, and what a list has instead."""
    if isinstance(place, list) and place:
        return f"{key} has no {part}; its entries are numbered from 0 to {len(place) - 1}"
    return f"{key} has no {part}"


def is_index(part: str, place: list[Any]) -> bool:
    """Whether a part of a key, as ``bodies.1`` has it, is the number of an entry of a list."""
    return part.isascii() and part.isdigit() and int(part) < len(place)
