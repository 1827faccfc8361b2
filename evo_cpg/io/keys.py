"""Access by key to mappings, lists, sections of a configuration and frozen dataclasses.

The parts of a key are names, and indices of lists. Both may be text, as in
``creature.bodies.1.joint``.
"""

import dataclasses
import re
from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import BaseModel

from evo_cpg.io.errors import Key

_T = TypeVar("_T")

# Coefficient of a joint axis in a tendon.
_SPANNED = re.compile(r"(creature\.tendons\.\d+\.joints)\.(.+)")


def parts_of(text: str) -> tuple[str, ...]:
    """Return the parts of a key in text. Names of joint axes contain a dot, and are one part."""
    spanned = _SPANNED.fullmatch(text)
    return (*spanned[1].split("."), spanned[2]) if spanned else tuple(text.split("."))


def replaces(key: str, other: str) -> bool:
    """Return whether a value for a key replaces an earlier value for another key.

    This is so if the other key is the same in another spelling, or lies in the key's section.
    """
    new, old = (
        [part.lstrip("0") or "0" if part.isdigit() else part for part in parts_of(text)]
        for text in (key, other)
    )
    return old[: len(new)] == new


def follow(place: Any, key: Key) -> tuple[Any, int]:
    """Follow a key as far as it exists. Return the value there and the number of parts followed."""
    for known, part in enumerate(key):
        try:
            place = inside(place, part)
        except LookupError:
            return place, known
    return place, len(key)


def value_at(place: Any, key: Key) -> Any:
    """Return the value at a key, or None if the key does not exist."""
    value, known = follow(place, key)
    return value if known == len(key) else None


def inside(place: Any, part: str | int) -> Any:
    """Return the value at one part of a key.

    Raises:
        LookupError: there is no such value.
    """
    if isinstance(place, BaseModel) or dataclasses.is_dataclass(place):
        return getattr(place, str(part))
    if isinstance(place, Mapping):
        return place[part]
    if isinstance(place, (list, tuple)) and is_index(part, place):
        return place[int(part)]
    raise LookupError(part)


def put(place: Any, key: Key, value: Any) -> Any:
    """Return an unchecked copy with another value at an existing key."""
    if not key:
        return value
    name, *rest = key
    changed = put(inside(place, name), rest, value)
    if isinstance(place, BaseModel):
        return place.model_copy(update={str(name): changed})
    if isinstance(place, Mapping):
        return {**place, name: changed}
    if isinstance(place, (tuple, list)):
        return type(place)(changed if i == int(name) else old for i, old in enumerate(place))
    fields = {field.name: getattr(place, field.name) for field in dataclasses.fields(place)}
    return unchecked(type(place), fields | {str(name): changed})


def unchecked(settings: type[_T], fields: Mapping[str, Any]) -> _T:
    """Build a frozen dataclass without the checks of its constructor."""
    made = object.__new__(settings)
    for name, value in fields.items():
        object.__setattr__(made, name, value)
    return made


def is_index(part: str | int, place: list | tuple) -> bool:
    """Return whether a part of a key is an index of a list."""
    text = str(part)
    return text.isascii() and text.isdigit() and int(text) < len(place)
