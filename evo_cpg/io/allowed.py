"""Allowed values of a key of a configuration, in words, from its JSON Schema."""

import difflib
import functools
from typing import Any

import pydantic

from evo_cpg.io.keys import follow, put, value_at

Schema = dict[str, Any]
Place = tuple[str | int, ...]

# If a key has the wrong type, pydantic ends the location of the error with this part.
_OF_KEY = "[key]"

# Units that are multiples of ours, so that the bare number would mean something else.
_OTHER_UNITS = {"ms", "min", "h", "mm", "cm", "km", "g", "rad"}

_SIMPLE = {
    "string": ("text", "texts"),
    "number": ("a number", "numbers"),
    "integer": ("a whole number", "whole numbers"),
    "boolean": ("true or false", "booleans"),
    "null": ("null", "nulls"),
}


class Allowed:
    """The JSON Schema of a configuration, looked up at the keys of a given configuration.

    Args:
        model: model of the whole configuration.
        data: the given configuration, whose ``type`` keys select the kinds of sections.
        tags: kinds that pydantic assumed for sections without ``type``.
    """

    def __init__(self, model: type[pydantic.BaseModel], data: Any, tags: frozenset[str]):
        self._model, self._root = model, _schema_of(model)
        self._data, self._tags = data, tags

    def keys(self, place: Place) -> list[str]:
        """Return the valid keys of the section at a place."""
        options = self._at(place)
        return sorted({key for option in options for key in option.get("properties", {})})

    def types_by_key(self, place: Place) -> dict[str, list[str]]:
        """Return the types of a section at a place that have each key, whatever its type is."""
        found: dict[str, list[str]] = {}
        for option in self._at(place, any_type=True):
            if kind := self._kind(option):
                for key in option["properties"]:
                    found.setdefault(key, []).append(kind)
        return found

    def words(self, place: Place) -> str:
        """Return the allowed values in words: ``a number``, ``a list of 3 numbers``."""
        return self._words(self._at(place))

    def hint(self, place: Place, given: Any) -> str:
        """Return advice on how to write the probably intended value, or "" if it is unknown."""
        options = self._at(place)
        if place and isinstance(place[-1], int) and not isinstance(given, (list, dict)):
            # A flat list is given, but a list of lists is expected.
            whole = value_at(self._data, place[:-1])
            if isinstance(whole, list) and self._fits(place[:-1], [whole]):
                return f"Write {as_written([whole])}"
        if given is None:
            none = ", write [] for none" if self._fits(place, []) else ""
            return f"The key has no value. Leave it out{none}, or give it one"
        for reading in _readings(given):
            if self._fits(place, reading):
                return f"Write {as_written(reading)}"
        if isinstance(given, dict) and any(option.get("type") == "array" for option in options):
            return "Begin each entry with '- '"
        if isinstance(given, str) and given in map(self._kind, options):
            return f"Write {{type: {given}}}"
        words = [word for o in options for word in o.get("enum", []) if isinstance(word, str)]
        if close := difflib.get_close_matches(str(given), words, n=1, cutoff=0.5):
            return f"Did you mean {close[0]!r}?"
        for option in options:
            (only, *more) = option.get("required", []) or ["", ""]
            if not more and self._fits(place, {only: given}):
                return f"Write {as_written({only: given})}"
        return ""

    def _fits(self, place: Place, value: Any) -> bool:
        """Return whether a place accepts a value, regardless of errors elsewhere."""
        data = put(self._data, place, value)
        try:
            self._model.model_validate(data)
        except pydantic.ValidationError as error:
            return all(key_of(each, data)[: len(place)] != place for each in error.errors())
        return True

    def _at(self, place: Place, any_type: bool = False) -> list[Schema]:
        """Return the schemas that a place may match, with references resolved.

        Args:
            place: the place.
            any_type: whether to include types that the section at the place does not have.
        """
        options, here = self._options(self._root, self._data), self._data
        for number, part in enumerate(place, 1):
            here = None if any_type and number == len(place) else value_at(here, (part,))
            options = [
                each
                for option in options
                for inner in _entries(option, part)
                for each in self._options(inner, here)
            ]
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
        kinds = [self._kind(option) for option in options]
        written = given.get("type")
        found = {written} if written is not None else self._tags.intersection(filter(None, kinds))
        if not found:
            return options
        exact = [option for option, kind in zip(options, kinds, strict=True) if kind in found]
        return exact or [o for o, kind in zip(options, kinds, strict=True) if kind is None]

    def _kind(self, option: Schema) -> str | None:
        """Return the ``type`` of an alternative, or None if it may be any, or does not exist."""
        return option.get("properties", {}).get("type", {}).get("const")

    def _words(self, options: list[Schema]) -> str:
        choices: list[str] = []
        for option in options:
            for each in option.get("enum", [option["const"]] if "const" in option else []):
                choices.append(repr(each))
        choices += [_SIMPLE[kind][0] for kind in map(_simple_kind, options) if kind]
        for option in options:
            if option.get("type") == "array":
                choices.append(f"a list of {self._entries(option)}")
        sections = [option for option in options if option.get("type") == "object"]
        kinds = [kind for kind in map(self._kind, sections) if kind]
        if len(kinds) > 1:
            own = ["module:Class"] if len(kinds) < len(sections) else []
            choices.append(f"a section whose type is {_listed([*map(repr, kinds), *own])}")
        else:
            choices += [f"a section {self._keys(section)}" for section in sections]
        return _listed(list(dict.fromkeys(choices))) or "something else"

    def _keys(self, schema: Schema) -> str:
        if "properties" in schema:
            return f"with the keys {', '.join(schema['properties'])}"
        inner = schema.get("additionalProperties")
        if isinstance(inner, dict):
            return f"of names, each with {self._words(self._options(inner, None))}"
        return "of keys and values"

    def _entries(self, schema: Schema) -> str:
        """Return the allowed entries of a list, in the plural."""
        items = schema.get("prefixItems") or [schema.get("items", {})]
        options = self._options(items[0], None)
        least, most = schema.get("minItems"), schema.get("maxItems")
        count = f"{least} " if least == most and least is not None else ""
        if len(options) > 1 or "enum" in options[0]:
            return f"{count}entries, each {self._words(options)}"
        kind = options[0].get("type")
        if kind == "array":
            return f"{count}lists of {self._entries(options[0])}"
        if kind == "object":
            return f"{count}sections {self._keys(options[0])}"
        return f"{count}{_SIMPLE[kind][1]}" if kind in _SIMPLE else f"{count}entries"


@functools.cache
def _schema_of(model: type[pydantic.BaseModel]) -> Schema:
    return model.model_json_schema()


def as_written(value: Any) -> str:
    """Return a value on one line of YAML."""
    if isinstance(value, list):
        return f"[{', '.join(map(as_written, value))}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key}: {as_written(each)}' for key, each in value.items())}}}"
    if value is None or isinstance(value, bool):
        return "null" if value is None else str(value).lower()
    return repr(value) if isinstance(value, str) and not value.isidentifier() else str(value)


def _readings(given: Any) -> list[Any]:
    """Return other values that the user may have intended."""
    found: list[Any] = [[given]]
    if isinstance(given, str):
        if given.lower() in ("none", "nil"):
            found.append(None)
        number, parts = _number_or_text(given), given.split(",")
        numbers = [] if isinstance(number, str) else [number]
        lists = [[_number_or_text(part.strip()) for part in parts]] if len(parts) > 1 else []
        # A single comma without a space is a decimal comma, if a number is allowed.
        decimal = len(parts) == 2 and not any(map(str.isspace, given))
        found += numbers + lists if decimal else lists + numbers
    elif isinstance(given, list) and len(given) == 1:
        found.append(given[0])
    elif isinstance(given, dict) and len(given) == 1 and list(given.values()) == [None]:
        # YAML reads a name that is only a placeholder, such as {i}, as a mapping.
        found.append(f"{{{next(iter(given))}}}")
    elif isinstance(given, bool):
        found.append({} if given else None)
    elif isinstance(given, (int, float)):
        found.append(str(given))
    return found


def _simple_kind(option: Schema) -> str | None:
    """Return the JSON type of a schema that accepts any value of one simple type, or None."""
    named = "enum" in option or "const" in option
    return None if named or option.get("type") not in _SIMPLE else option["type"]


def _number_or_text(text: str) -> Any:
    """Return the number that a text begins with, or the text if it has none, or another unit."""
    plain = text.replace("\N{MINUS SIGN}", "-").replace(",", ".")
    words = plain.split()
    if words[1:] and words[1] in _OTHER_UNITS:
        return text
    for kind in (int, float):
        try:
            return kind(words[0])
        except (IndexError, ValueError):
            continue
    return text


def _entries(schema: Schema, part: str | int) -> list[Schema]:
    """Return a list with the schema of one entry of a list or section, or [] if there is none."""
    if isinstance(part, int):
        first = schema.get("prefixItems", [])
        found = first[part] if part < len(first) else schema.get("items")
    else:
        found = schema.get("properties", {}).get(part, schema.get("additionalProperties"))
    return [found] if isinstance(found, dict) else []


def _listed(words: list[str]) -> str:
    """Return words as a list with ``or`` before the last one."""
    return " or ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))


def key_of(problem: Any, data: Any) -> tuple[str | int, ...]:
    """Return the key of a problem.

    A pydantic location also contains the names of union members, which are not keys of the file.
    """
    location, missing = problem["loc"], problem["type"] == "missing"
    if is_of_key(problem):
        # Leave out the key itself, which pydantic converts to text.
        location = location[: -2 if location[-1] == _OF_KEY else -1]
    key: list[str | int] = []
    place: Any = data
    for i, part in enumerate(location):
        inner, known = follow(place, (part,))
        if known or (missing and i == len(location) - 1 and isinstance(place, dict)):
            key.append(part)
            place = inner
    return tuple(key)


def is_of_key(problem: Any) -> bool:
    """Return whether a problem concerns a key, and not its value."""
    return problem["type"] == "invalid_key" or problem["loc"][-1:] == (_OF_KEY,)
