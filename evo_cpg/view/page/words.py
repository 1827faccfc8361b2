"""Format numbers, and values from files of unknown origin."""

import math
from pathlib import PurePath
from typing import Any

import numpy as np

from evo_cpg.analysis.quantity import Quantity

# Letters of the longest text in a cell.
_LETTERS = 120


def number(value: float | np.floating) -> str:
    """Return a number with three significant digits, or a dash if it is not finite.

    Numbers from a thousand to a million are rounded to whole numbers.
    """
    if not math.isfinite(value):
        return "\N{EN DASH}"
    words = f"{value:.3g}"
    if "e" in words:
        words = f"{value:.0f}" if 1e3 <= abs(value) < 1e6 else words
    return words.replace("-", "\N{MINUS SIGN}", 1) if words.startswith("-") else words


def with_unit(each: Quantity) -> str:
    """Return the value and unit of a quantity."""
    return f"{number(each.value)} {each.unit}".rstrip()


def quantity(value: Any, unit: Any) -> str:
    """Return a number from a file with its unit, or an empty text for any other value."""
    if not _is_number(value):
        return ""
    return f"{100 * value:.3g} %" if unit == "%" else f"{value:.3g} {unit}".rstrip()


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def listed(value: Any) -> list[Any]:
    """Return a list from a file, or an empty list for any other value."""
    return value if isinstance(value, list) else []


def cell(value: Any) -> str:
    """Return any value as a short text, or a dash for None."""
    if value is None:
        return "\N{EN DASH}"
    words = f"{value:.6g}" if isinstance(value, float) else str(value)
    return words if len(words) <= _LETTERS else words[: _LETTERS - 3] + "..."


def without_folders(word: str) -> str:
    """Return a word of a command, with an absolute path or a home path cut to its last name.

    Other people may read the page, and must not see the user's folders.
    """
    key, mark, value = word.partition("=")
    place = value if mark else word
    if PurePath(place).is_absolute() or place.startswith("~"):
        return f"{key}{mark}{PurePath(place).name}" if mark else PurePath(place).name
    return word
