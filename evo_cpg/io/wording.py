"""Pydantic's errors in a configuration, in words: key, value, allowed values."""

import difflib
from typing import Any, TypeVar

import pydantic

from evo_cpg.io.allowed import Allowed, is_of_key, key_of
from evo_cpg.io.errors import KeyProblem, nearest
from evo_cpg.io.keys import value_at

_Section = TypeVar("_Section", bound=pydantic.BaseModel)

# Pydantic's error types for an unknown key, in models and in dataclasses.
_UNKNOWN_KEY = ("extra_forbidden", "unexpected_keyword_argument")
_LENGTH = ("too_short", "too_long")

# Keys of a creature, and the message for a file of a creature in place of a configuration.
_CREATURE = {"name", "materials", "bodies"}
_IS_CREATURE = (
    "describes a creature, and not an experiment. Name this file in a configuration: creature: FILE"
)

_TRUTHS = "YAML reads yes, no, on, off, true and false as booleans. Put text in quotes"


def worded(
    error: pydantic.ValidationError, model: type[pydantic.BaseModel], data: dict[str, Any]
) -> KeyProblem:
    """Return one of pydantic's problems, in words.

    Keys that are not text and unknown keys come first, because a typo explains a missing key.

    Args:
        error: pydantic's error.
        model: model of the whole configuration.
        data: the given configuration.
    """
    if data.keys() >= _CREATURE and "creature" not in data and "creature" in model.model_fields:
        return KeyProblem((), _IS_CREATURE)
    problems = sorted(error.errors(), key=lambda p: not (is_of_key(p) or p["type"] in _UNKNOWN_KEY))
    problem = _closest(problems, data)
    key = key_of(problem, data)
    kind, given = problem["type"], problem.get("input")
    tags = frozenset(part for part in problem["loc"] if isinstance(part, str))
    allowed = Allowed(model, data, tags)
    if is_of_key(problem):
        return KeyProblem(key, _about_key(given, value_at(data, (*key, given))))
    if kind in _UNKNOWN_KEY:
        return KeyProblem(key, f"unknown key: {_near_key(allowed, key)}")
    if kind == "missing":
        beside = [p["loc"][-1] for p in problems if p["loc"][:-1] == problem["loc"][:-1]]
        missing = [place + 1 for place in beside if isinstance(place, int)]
        if missing:
            return KeyProblem(key, f"{short(given)}: must have {max(missing)} values")
        return KeyProblem(key, "is missing and has no default")
    message = problem["msg"].removeprefix("Value error, ")
    if kind == "value_error":
        return KeyProblem(key, message)
    if kind == "union_tag_not_found" and isinstance(given, dict):
        return KeyProblem((*key, "type"), "is missing and has no default")
    if kind.startswith("union_tag") and isinstance(given, dict):
        expected = problem.get("ctx", {}).get("expected_tags", "")
        expected = expected.replace("'custom'", "or module:Class for your own")
        found = given.get("type")
        return KeyProblem((*key, "type"), f"{found!r} is not known. Allowed: {expected}")
    if kind in _LENGTH:
        limits = problem.get("ctx", {})
        least, most = limits.get("min_length"), limits.get("max_length")
        words = f"at least {least}" if kind == "too_short" else f"at most {most}"
        problem = f"must have {words}, has {limits.get('actual_length')}"
        return KeyProblem(key, f"{short(given)}: {problem}")
    if _is_wrong_kind(problem) or kind.startswith("union_tag"):
        return KeyProblem(key, f"{short(given)}: {_about_kind(allowed, key, given)}")
    keys = {key_of(each, data) for each in problems}
    more = f" ({len(keys)} problems in all)" if len(keys) > 1 else ""
    message = message.replace("Input should be", "must be", 1)
    return KeyProblem(key, f"{short(given)}: {message[:1].lower()}{message[1:]}{more}")


def checked(model: type[_Section], data: Any) -> _Section:
    """Build a section from its contents.

    Raises:
        KeyProblem: the contents are invalid.
    """
    try:
        return model.model_validate(data)
    except pydantic.ValidationError as error:
        raise worded(error, model, data) from None


def short(value: Any) -> str:
    """Return a value in the form of messages, at most 60 characters long."""
    text = "null" if value is None else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _about_kind(allowed: Allowed, key: tuple[str | int, ...], given: Any) -> str:
    """Return the allowed values of a place with a wrong type, and how to write the value."""
    words = allowed.words(key)
    problem = f"must be {words}"
    if isinstance(given, bool) and words.startswith("text"):
        return f"{problem}. {_TRUTHS}"
    hint = allowed.hint(key, given)
    return f"{problem}. {hint}" if hint else problem


def _about_key(given: Any, value: Any) -> str:
    """Return the problem with a key that is not text."""
    if isinstance(given, bool):
        return f"the key {given} must be text. {_TRUTHS}"
    if value is None:
        return f"the key {given} must be text. If it follows a decimal comma, write a point"
    return f"the key {given} must be text. Write it in quotes: '{given}'"


def _is_wrong_kind(problem: Any) -> bool:
    """Return whether a problem is a value of the wrong type."""
    named = ("literal_error", "int_from_float")
    return problem["type"].endswith(("_type", "_parsing")) or problem["type"] in named


def _near_key(allowed: Allowed, key: tuple[str | int, ...]) -> str:
    """Return valid keys similar to an unknown key, or where a key of a more similar name is."""
    valid, name = allowed.keys(key[:-1]), str(key[-1])
    inner = []
    if len(key) == 1:
        inner = [f"{section}.{key[0]}" for section in valid if key[0] in allowed.keys((section,))]
    if inner:
        return f"did you mean {' or '.join(inner)}?"
    types = allowed.types_by_key(key[:-1])
    (other, *_) = difflib.get_close_matches(name, {*types, *valid}, n=1, cutoff=0.8) or [name]
    if other in types and other not in valid:
        owners = " and ".join(types[other])
        return f"{other!r} is a key of type {owners}. Valid here: {', '.join(valid)}"
    return nearest(name, valid)


def _closest(problems: list[Any], data: dict[str, Any]) -> Any:
    """Return the first problem, or a more exact one within the same list or section.

    If a place accepts several types, pydantic reports the problem with each type.
    """
    first = problems[0]
    if not _is_wrong_kind(first) or not isinstance(first.get("input"), (dict, list)):
        return first
    key = key_of(first, data)
    inner = [each for each in problems if key_of(each, data)[: len(key)] == key]
    return max(inner, key=lambda each: len(key_of(each, data)))
