"""Pydantic's errors in a configuration, in words: key, value, allowed type, nearest key."""

import functools
from typing import Any, TypeVar

import pydantic

from evo_cpg.io.errors import KeyProblem, nearest
from evo_cpg.io.keys import follow, value_at

_Section = TypeVar("_Section", bound=pydantic.BaseModel)

Schema = dict[str, Any]
Place = tuple[str | int, ...]

# Pydantic's error types for an unknown key, in models and in dataclasses.
_UNKNOWN_KEY = ("extra_forbidden", "unexpected_keyword_argument")

# If a key has the wrong type, pydantic ends the location of the error with this part.
_OF_KEY = "[key]"

# JSON types of a value, and of the entries of a list, in words.
_TYPES = {
    "string": ("text", "texts"),
    "number": ("a number", "numbers"),
    "integer": ("a whole number", "whole numbers"),
    "boolean": ("true or false", "booleans"),
    "null": ("null", "nulls"),
    "array": ("a list", "lists"),
    "object": ("a section", "sections"),
}

# Keys of a creature, and the message for a file of a creature in place of a configuration.
_CREATURE = {"name", "materials", "bodies"}
_IS_CREATURE = (
    "describes a creature, and not an experiment. Name this file in a configuration: creature: FILE"
)


def checked(model: type[_Section], data: Any) -> _Section:
    """Build a section from its contents.

    Raises:
        KeyProblem: the contents are invalid.
    """
    try:
        return model.model_validate(data)
    except pydantic.ValidationError as error:
        raise _worded(error, model, data) from None


def short(value: Any) -> str:
    """Return a value in the form of messages, at most 60 characters long."""
    text = "null" if value is None else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


class Allowed:
    """The JSON Schema of a configuration, looked up at the keys of a given configuration.

    Args:
        model: model of the whole configuration.
        data: the given configuration, whose ``type`` keys select the kinds of sections.
        tags: kinds that pydantic assumed for sections without ``type``.
    """

    def __init__(
        self, model: type[pydantic.BaseModel], data: Any, tags: frozenset[str] = frozenset()
    ):
        self._root, self._data, self._tags = _schema_of(model), data, tags

    def keys(self, place: Place) -> list[str]:
        """Return the valid keys of the section at a place."""
        options = self._at(place)
        return sorted({key for option in options for key in option.get("properties", {})})

    def words(self, place: Place) -> str:
        """Return the allowed values in words: ``a number``, ``a list of 3 numbers``."""
        options = self._at(place)
        choices: list[str] = []
        kinds = [repr(kind) for kind in map(_kind_of, options) if kind]
        for option in options:
            named = option.get("enum", [option["const"]] if "const" in option else [])
            kind = option.get("type", "")
            if named:
                choices += map(repr, named)
            elif kind == "array":
                items = (option.get("prefixItems") or [option.get("items", {})])[0]
                inner = self._options(items, None)
                entries = "entries"
                if len(inner) == 1:
                    named = ", ".join(map(repr, inner[0].get("enum", [])))
                    entries = named or _TYPES.get(inner[0].get("type", ""), ("", entries))[1]
                count = option.get("minItems") if "prefixItems" in option else None
                choices.append(f"a list of {entries if count is None else f'{count} {entries}'}")
            elif kind == "object" and kinds:
                kinds += ["module:Class"] * (_kind_of(option) is None)
            elif kind == "object" and "properties" in option:
                choices.append(f"a section with the keys {', '.join(option['properties'])}")
            elif kind in _TYPES:
                choices.append(_TYPES[kind][0])
        if kinds:
            choices.append(f"a section whose type is {', '.join(kinds)}")
        *most, last = dict.fromkeys(choices) or ["something else"]
        return f"{', '.join(most)} or {last}" if most else last

    def _at(self, place: Place) -> list[Schema]:
        """Return the schemas that a place may match, with references resolved."""
        options, here = self._options(self._root, self._data), self._data
        for part in place:
            here, inner = value_at(here, (part,)), list[Any]()
            for option in options:
                if isinstance(part, int):
                    first = option.get("prefixItems", [])
                    inner.append(first[part] if part < len(first) else option.get("items"))
                else:
                    rest = option.get("additionalProperties")
                    inner.append(option.get("properties", {}).get(part, rest))
            found = [each for each in inner if isinstance(each, dict)]
            options = [option for each in found for option in self._options(each, here)]
        return options

    def _options(self, schema: Schema, given: Any) -> list[Schema]:
        """Return the alternatives of a schema that the given ``type`` selects, or all."""
        if "$ref" in schema:
            return self._options(self._root["$defs"][schema["$ref"].rsplit("/", 1)[-1]], given)
        union = schema.get("oneOf") or schema.get("anyOf")
        if union is None:
            return [schema]
        options = [each for option in union for each in self._options(option, given)]
        if not isinstance(given, dict):
            return options
        kinds = [_kind_of(option) for option in options]
        written = given.get("type")
        found = {written} if written is not None else self._tags.intersection(filter(None, kinds))
        if not found:
            return options
        exact = [option for option, kind in zip(options, kinds, strict=True) if kind in found]
        return exact or [o for o, kind in zip(options, kinds, strict=True) if kind is None]


@functools.cache
def _schema_of(model: type[pydantic.BaseModel]) -> Schema:
    return model.model_json_schema()


def _kind_of(option: Schema) -> str | None:
    """Return the ``type`` of a section, or None if it may be any, or does not exist."""
    return option.get("properties", {}).get("type", {}).get("const")


def _worded(
    error: pydantic.ValidationError, model: type[pydantic.BaseModel], data: dict[str, Any]
) -> KeyProblem:
    """Return one of pydantic's problems, in words.

    Keys that are not text and unknown keys come first, because a typo explains a missing key.
    """
    if data.keys() >= _CREATURE and "creature" not in data and "creature" in model.model_fields:
        return KeyProblem((), _IS_CREATURE)
    problems = sorted(
        error.errors(), key=lambda p: not (_is_of_key(p) or p["type"] in _UNKNOWN_KEY)
    )
    problem = problems[0]
    if _is_of_wrong_type(problem) and isinstance(problem.get("input"), (dict, list)):
        # If a place accepts several types, pydantic reports the problem with each type. Take a
        # more exact one within the same list or section.
        outer = _key_of(problem, data)
        inside = [each for each in problems if _key_of(each, data)[: len(outer)] == outer]
        problem = max(inside, key=lambda each: len(_key_of(each, data)))
    key, kind, given = _key_of(problem, data), problem["type"], problem.get("input")
    tags = frozenset(part for part in problem["loc"] if isinstance(part, str))
    allowed, limits = Allowed(model, data, tags), problem.get("ctx", {})
    message = problem["msg"].removeprefix("Value error, ")
    if _is_of_key(problem):
        return KeyProblem(key, f"the key {given} must be text. Write it in quotes: '{given}'")
    if kind in _UNKNOWN_KEY:
        valid, name = allowed.keys(key[:-1]), str(key[-1])
        inner = [f"{x}.{name}" for x in valid if len(key) == 1 and name in allowed.keys((x,))]
        near = f"did you mean {' or '.join(inner)}?" if inner else nearest(name, valid)
        return KeyProblem(key, f"unknown key: {near}")
    if kind == "missing":
        beside = [p["loc"][-1] for p in problems if p["loc"][:-1] == problem["loc"][:-1]]
        missing = [place + 1 for place in beside if isinstance(place, int)]
        if missing:
            return KeyProblem(key, f"{short(given)}: must have {max(missing)} values")
        return KeyProblem(key, "is missing and has no default")
    if kind == "value_error":
        return KeyProblem(key, message)
    if kind == "union_tag_not_found" and isinstance(given, dict):
        return KeyProblem((*key, "type"), "is missing and has no default")
    if kind.startswith("union_tag") and isinstance(given, dict):
        expected = limits.get("expected_tags", "").replace("'custom'", "or module:Class")
        return KeyProblem(
            (*key, "type"), f"{given.get('type')!r} is not known. Allowed: {expected}"
        )
    if kind in ("too_short", "too_long"):
        least, most = limits.get("min_length"), limits.get("max_length")
        words = f"at least {least}" if kind == "too_short" else f"at most {most}"
        message = f"must have {words}, has {limits.get('actual_length')}"
    elif _is_of_wrong_type(problem) or kind.startswith("union_tag"):
        message = f"must be {allowed.words(key)}"
    message = message.replace("Input should be", "must be", 1)
    return KeyProblem(key, f"{short(given)}: {message[:1].lower()}{message[1:]}")


def _is_of_wrong_type(problem: Any) -> bool:
    named = ("literal_error", "int_from_float")
    return problem["type"].endswith(("_type", "_parsing")) or problem["type"] in named


def _is_of_key(problem: Any) -> bool:
    """Return whether a problem concerns a key, and not its value."""
    return problem["type"] == "invalid_key" or problem["loc"][-1:] == (_OF_KEY,)


def _key_of(problem: Any, data: Any) -> Place:
    """Return the key of a problem.

    A pydantic location also contains the names of union members, which are not keys of the file.
    """
    location, missing = problem["loc"], problem["type"] == "missing"
    if _is_of_key(problem):
        # Leave out the key itself, which pydantic converts to text.
        location = location[: -2 if location[-1] == _OF_KEY else -1]
    key: list[str | int] = []
    place: Any = data
    for i, part in enumerate(location):
        inner, known = follow(place, (part,))
        rest = location[i + 1 : i + 2]
        # A section of a union may be named like one of its keys, such as `slide`.
        absent = missing and i + 2 == len(location) and not isinstance(inner, dict | list)
        if known and rest and not follow(inner, rest)[1] and (absent or follow(place, rest)[1]):
            continue
        if known or (missing and not rest and isinstance(place, dict)):
            key.append(part)
            place = inner
    return tuple(key)
