"""Descriptions of invalid YAML: the line, the parser's message, and a hint for the fix."""

import re
from typing import Any

import yaml

# Characters reserved at the beginning of a value: for anchors, aliases, tags and directives.
_RESERVED = "*&!%@`"

# Matches text with braces, such as {side}_fin.
_BRACES = re.compile(r"[^\s,:\[\]{}'\"]*\{\w+\}[^\s,:\[\]{}'\"]*(?:\{\w+\}[^\s,:\[\]{}'\"]*)*")

# Matches a colour without quotes, which YAML reads as a comment.
_COLOUR = re.compile(r"\bcolor:[ \t]+(#[0-9a-fA-F]{6})\b", re.MULTILINE)

_KEY = re.compile(r"(?:- +)*[\w-]+:(?=\s|$)")


def syntax_problem(text: str, error: yaml.YAMLError) -> tuple[str, str]:
    """Return the place of an error, and the parser's message with a hint for the fix.

    Args:
        text: invalid YAML.
        error: error that the parser raised.

    Returns:
        ``line 3, column 7``, empty if it is unknown, and the problem on one line.
    """
    mark = getattr(error, "problem_mark", None)
    row, column = (mark.line, mark.column) if mark else _place_of(error, text)
    problem = getattr(error, "problem", None) or getattr(error, "reason", "cannot be parsed")
    if row is None:
        return "", problem
    hint = _hint(text.splitlines() or [""], row, column, error, problem)
    return f"line {row + 1}, column {column + 1}", f"{problem}{f'. {hint}' if hint else ''}"


def lost_colour(text: str) -> str | None:
    """Return the problem of a colour without quotes, read as a comment, or None without one."""
    for line, words in enumerate(text.splitlines()):
        found = _COLOUR.search(words)
        if found and "#" not in words[: found.start()]:
            return (
                f"line {line + 1}: color: the value is missing, since # begins a comment. Write "
                f"the color in quotes: '{found[1]}'"
            )
    return None


def _place_of(error: Any, text: str) -> tuple[int | None, int]:
    """Return the line and column of a character that is not allowed in YAML."""
    position = getattr(error, "position", None)
    if not isinstance(position, int):
        return None, 0
    found = next((i for i, one in enumerate(text) if ord(one) == _code(error)), position)
    before = text[:found]
    return before.count("\n"), found - (before.rfind("\n") + 1)


def _code(error: Any) -> int:
    character = getattr(error, "character", 0)
    return ord(character) if isinstance(character, str) else int(character)


def _hint(lines: list[str], row: int, column: int, error: Any, problem: str) -> str:
    """Return a hint for the fix, or empty if there is none."""
    here = _line(lines, row)
    above = next((i for i in range(min(row, len(lines)) - 1, -1, -1) if lines[i].strip()), None)
    opened = getattr(error, "context_mark", None)
    context = str(getattr(error, "context", None) or "")
    at = here[column : column + 1]
    if re.match(r"[ -]*\t", here):
        return "A tab stands at the beginning of the line. YAML allows only spaces there"
    if strange := re.search(r"[\u00a0\u2000-\u200b\u3000\ufeff]", f"{here}{_line(lines, above)}"):
        code = f"U+{ord(strange[0]):04X}"
        return f"The character {code} looks like a space but is not one. Write a space"
    if braces := _unquoted_braces(here) or _unquoted_braces(_line(lines, above)):
        return f"Write text with braces in quotes: '{braces}'"
    word = re.split(r"[\s,\]}#]", here[column:])[0]
    if at and at in _RESERVED and not word.startswith("!!"):
        return f"YAML reserves {at} at the beginning of a value. Write it in quotes: '{word}'"
    if "another document" in problem:
        return "A file contains one configuration. Leave out '---'"
    if "quoted scalar" in context and opened:
        return f"The quote that opens in line {opened.line + 1} is not closed"
    if "flow" in context and opened:
        bracket = "[" if "sequence" in context else "{"
        rest = _line(lines, opened.line)[opened.column :]
        lost = ". A # after a space begins a comment" if re.search(r"\s#", rest) else ""
        return f"The {bracket} in line {opened.line + 1} is not closed, or a comma is missing{lost}"
    for number, line in ((above, _line(lines, above)), (row, here)):
        words = line.strip()
        if (
            number is not None
            and re.match(r"-[\w'\"{\[]", words)
            and not re.match(r"-\.?\d", words)
        ):
            return f"A space is missing after the - in line {number + 1}"
        glued = re.match(r"(?:- +)?[A-Za-z_]\w*:(?![\s/]|$)", words)
        if number is not None and glued:
            return f"A space is missing after the colon in line {number + 1}"
    if "mapping values" in problem and len(_KEY.findall(here)) > 1:
        return "Write text that contains a colon and a space in quotes"
    if above is not None and at.strip() and _indent(here) != _indent(_line(lines, above)):
        return (
            f"The line is indented by {_indent(here)} characters, line {above + 1} by "
            f"{_indent(_line(lines, above))}. All keys of a section begin in the same column"
        )
    return ""


def _line(lines: list[str], number: int | None) -> str:
    """Return a line, or an empty text if the line does not exist."""
    return "" if number is None or number >= len(lines) else lines[number]


def _indent(line: str) -> int:
    """Return the indentation of a line. The dash of a list entry counts as a space."""
    return len(line) - len(re.sub(r"^[ -]*", "", line))


def _unquoted_braces(line: str) -> str | None:
    """Return an unquoted text with braces, or None if there is none."""
    plain = re.sub(r"'[^']*'|\"[^\"]*\"", lambda found: " " * len(found[0]), line)
    for found in _BRACES.finditer(plain.split(" #")[0]):
        if not re.fullmatch(r"\{\w+\}", found[0]):
            return found[0]
    return None
