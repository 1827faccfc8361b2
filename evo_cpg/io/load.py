"""Checked configurations from YAML files and overrides, and errors with their file and line."""

import contextlib
import copy
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from evo_cpg.errors import question, similar
from evo_cpg.io.errors import ConfigError, Key, KeyProblem, under
from evo_cpg.io.keys import follow, is_index, parts_of, value_at
from evo_cpg.io.named_files import read_heights, read_mesh
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.io.shipped import shipped_names
from evo_cpg.io.trust import beside, read_small, trusting
from evo_cpg.io.wording import checked, short
from evo_cpg.io.yaml_text import compose_yaml, lost_colour, parse_yaml, syntax_problem, to_yaml


@contextlib.contextmanager
def located(source: Path | str, data: Any = None) -> Iterator[None]:
    """Convert a `KeyProblem` into a `ConfigError`, with the file and line of its key.

    Values of ``data``, the configuration with overrides, get a line if they are those of the file.
    If ``data`` is None, no error gets a line.
    """

    def is_of(written: Any, value: Any) -> bool:
        """Return whether a value is the written one, to whose sections defaults may be added."""
        if isinstance(written, dict) and isinstance(value, dict):
            return all(key in value and is_of(each, value[key]) for key, each in written.items())
        return bool(written == value)

    try:
        yield
    except ConfigError:
        raise
    except KeyProblem as error:
        path, key = Path(source), error.key
        value, known = follow(data, key)
        places = [(path, key)] if key and data is not None else []
        for name in (("creature", "file"), ("creature",)):
            found = _find(path, name) if places and key[0] == "creature" else None
            if found is not None and isinstance(found[1], str):
                # The creature has a file of its own.
                places.insert(0, (path.parent / found[1], key[1:]))
                break
        for file, inner in places:
            found = _find(file, inner)
            if found is not None and found[2] == len(key) - known and is_of(found[1], value):
                raise ConfigError(file, key, error.problem, found[0]) from None
        raise ConfigError(source, key, error.problem) from None


def load_config(path: Path | str, overrides: Sequence[str] = ()) -> ExperimentConfig:
    """Read and check a configuration file.

    Raises:
        ConfigError: the configuration is invalid. The message is worded for the user.
    """
    path = Path(path)
    return complete_config(read_yaml(path), path, overrides)


def complete_config(
    data: dict[str, Any], source: Path, overrides: Sequence[str] = ()
) -> ExperimentConfig:
    """Check the contents of a configuration file and of the files that it names.

    Raises:
        ConfigError: the configuration is invalid. The message is worded for the user.
    """
    data = copy.deepcopy(data)
    with located(source, data):
        _read_files(data, source)
        for key, entry in _mesh_entries(data):
            if isinstance(entry["shape"].get("file"), str):
                with under(*key, "file"):
                    beside(source, entry["shape"]["file"])
        # The user wrote the overrides, so the files that they name may be anywhere.
        with trusting():
            for override in overrides:
                _apply(data, override)
                _read_files(data, source)
            meshes: dict[str, dict[str, Any]] = {}
            for key, entry in _mesh_entries(data):
                shape = repr(entry["shape"])
                if shape not in meshes:
                    with under(*key):
                        meshes[shape] = read_mesh(source, entry["shape"])
                entry["shape"] = meshes[shape]
        return _check(data)


def check_config(data: dict[str, Any], source: Path | str) -> ExperimentConfig:
    """Check the contents of a configuration file.

    Raises:
        ConfigError: the configuration is invalid.
    """
    with located(source):
        return _check(data)


def _check(data: dict[str, Any]) -> ExperimentConfig:
    config = checked(ExperimentConfig, data)
    for key, value, problem in _misread(data, config.model_dump()):
        raise KeyProblem(key, f"{short(value)}: {problem}")
    with under("creature"):
        config.creature.require_names()
    return config


def dump_config(config: ExperimentConfig) -> str:
    """Return the complete configuration as YAML, which `load_config` reads back unchanged."""
    return to_yaml(config.model_dump(mode="json"))


def as_overrides(values: Mapping[str, Any]) -> list[str]:
    """Return settings in the form of the command line, ``key=value``."""
    return [f"{key}={to_yaml([value], flow=True).strip()[1:-1]}" for key, value in values.items()]


def read_yaml(path: Path) -> dict[str, Any]:
    """Return the contents of a YAML file.

    Raises:
        ConfigError: it cannot be read, or is not a mapping.
    """
    try:
        text = read_small(path)
    except FileNotFoundError:
        hint = f". The configuration that comes with evo-cpg is called {path.stem}"
        if path.stem not in shipped_names():
            names: dict[str, str] = {}
            # The folder may be missing or unreadable.
            with contextlib.suppress(OSError):
                files = sorted(each for each in path.parent.iterdir() if each.match("*.y*ml"))
                names = {other.stem: other.name for other in files}
            near = question([names[stem] for stem in similar(path.stem, names)])
            hint = f": {near}" if near else ""
        raise ConfigError(path, (), f"no such file{hint}") from None
    except OSError as error:
        raise ConfigError(path, (), f"cannot be read ({error.strerror})") from None
    except UnicodeDecodeError as error:
        row = error.object[: error.start].count(b"\n") + 1
        problem = f"is not UTF-8 text (byte {error.start}, in line {row}). Save it as UTF-8"
        raise ConfigError(path, (), problem) from None
    except ValueError:
        raise ConfigError(path, (), "is not a file name") from None
    try:
        data = parse_yaml(text)
    except yaml.YAMLError as error:
        place, problem = syntax_problem(text, error)
        problem = f"not valid YAML: {problem}"
        raise ConfigError(path, (), f"{place}: {problem}" if place else problem) from None
    if lost := lost_colour(text):
        raise ConfigError(path, (), lost)
    if data is None:
        raise ConfigError(path, (), "is empty. It must be a YAML mapping of keys to values")
    if not isinstance(data, dict):
        raise ConfigError(path, (), "must be a YAML mapping of keys to values")
    return data


def _read_files(data: dict[str, Any], path: Path) -> None:
    """Replace the names of other files by their contents, so that one file contains everything."""
    creature = data.get("creature")
    if isinstance(creature, str):
        creature = {"file": creature}
    if isinstance(creature, dict) and "file" in creature:
        name, changes = creature["file"], {k: v for k, v in creature.items() if k != "file"}
        with under("creature", "file"):
            if not isinstance(name, str):
                raise KeyProblem((), "must be the path of a creature's file")
            data["creature"] = read_yaml(beside(path, name)) | changes
        for _, entry in _mesh_entries(data):
            if isinstance(entry["shape"].get("file"), str):
                file = str(Path(name).parent / entry["shape"]["file"])
                entry["shape"] = entry["shape"] | {"file": file}
    key = ("world", "ground", "floor")
    floor = value_at(data, key)
    if isinstance(floor, dict) and floor.get("type") == "relief" and "file" in floor:
        given = {key: floor.pop(key) for key in ("file", "lowest", "highest") if key in floor}
        with under(*key):
            floor["heights"] = read_heights(path, given)


def _mesh_entries(data: dict[str, Any]) -> Iterator[tuple[Key, dict[str, Any]]]:
    """Yield the bodies and parts whose shape is a mesh file, with the keys of their shapes.

    A mesh with neither vertices nor faces counts as a mesh file.
    """
    creature = data.get("creature")
    bodies = creature.get("bodies") if isinstance(creature, dict) else None
    for i, entry in enumerate(bodies if isinstance(bodies, list) else []):
        parts = entry.get("parts") if isinstance(entry, dict) else None
        owners: list[tuple[Key, Any]] = [(("creature", "bodies", i), entry)]
        for k, part in enumerate(parts if isinstance(parts, list) else []):
            owners.append((("creature", "bodies", i, "parts", k), part))
        for key, owner in owners:
            shape = owner.get("shape") if isinstance(owner, dict) else None
            if not isinstance(shape, dict) or shape.get("type") != "mesh":
                continue
            if "file" in shape or not {"vertices", "faces"} & set(shape):
                yield (*key, "shape"), owner


def _misread(given: Any, made: Any) -> Iterator[tuple[tuple[str | int, ...], Any, str]]:
    """Yield the key, value and problem of each value that pydantic wrongly accepts.

    Such values are infinite numbers, booleans and quoted text as numbers, and others as booleans.
    """
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


def _apply(data: dict[str, Any], override: str) -> None:
    """Set one value of the raw configuration, and create missing sections."""
    key, separator, text = override.partition("=")
    source, parts = "command line", parts_of(key)
    if not separator or not key:
        problem = f"{override!r} is not of the form key.path=value, such as seed=3"
        raise ConfigError(source, (), problem)
    if any("\ud800" <= character <= "\udfff" for character in text):
        raise ConfigError(source, parts, f"{text!a} is not UTF-8 text")
    try:
        value = parse_yaml(text)
    except yaml.YAMLError as error:
        problem = f"{text!r} is not YAML: {syntax_problem(text, error)[1]}"
        raise ConfigError(source, parts, problem) from None
    *parents, last = parts
    place, known = follow(data, parents)
    for part in parents[known:]:
        if not isinstance(place, dict) or part in place:
            break
        place[part] = {}
        place, known = place[part], known + 1
    if known == len(parents) and isinstance(place, dict):
        place[last] = value
    elif known == len(parents) and isinstance(place, list) and is_index(last, place):
        place[int(last)] = value
    else:
        problem = f"{'.'.join(parts[:known])} has no {parts[known]}"
        if isinstance(place, list) and place:
            problem = f"{problem}. Its entries are numbered from 0 to {len(place) - 1}"
        raise ConfigError(source, parts, problem)


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
