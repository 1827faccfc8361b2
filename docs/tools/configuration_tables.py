"""Write the configuration reference: a table of keys for each part of the file, from the schema."""

import json
import re
from collections.abc import Iterator
from functools import cache
from typing import Any, NamedTuple

from evo_cpg.io.file_schema import Schema, file_schema

# Longer units come first, because "m" is the end of many of them.
_UNITS = (
    "W for each kg of animal",
    "m/s per square root of a second",
    "N m s/rad",
    "N m/rad",
    "kg m^2",
    "kg/m^3",
    "Pa s",
    "m^2/s",
    "degrees",
    "rad/s",
    "m/s^2",
    "1/s",
    "m/s",
    "N m",
    "m",
    "s",
)
_UNIT = re.compile(rf"(?:, |^)({'|'.join(map(re.escape, _UNITS))})(?=[,;.]|$)")

# No quantity in SI units reaches this value. Larger bounds would not help a reader.
_BEYOND = 1e9


class Part(NamedTuple):
    """Part of the file with a table of its own.

    Attributes:
        paths: allowed places in the file, such as ``creature.bodies.N.joint``.
        name: name of its definition in the schema, empty for the whole file.
        kind: ``type`` and its value, or the first key, if there are several kinds.
    """

    paths: tuple[str, ...]
    name: str
    kind: str | None


def every_key() -> str:
    """Return the reference as Markdown."""
    schema = file_schema()
    pieces, section = [], ""
    for part in parts(schema):
        definition = schema["$defs"][part.name] if part.name else schema
        top = part.paths[0].split(".")[0]
        if part.kind and top != section and "." not in part.paths[0]:
            pieces.append(f"## `{top}`\n")
        section = top
        pieces.append(f"{heading(part)}\n")
        if part.name:
            pieces.append(f"{_sentence(definition['description'])}\n")
        pieces.append(_table(definition))
    return "\n".join(pieces)


def parts(schema: Schema) -> list[Part]:
    """Return all parts in the order of the schema, with related parts side by side."""
    found: dict[str, Part] = {}

    def visit(path: str, name: str, several: bool) -> None:
        if name == "CreatureFile":
            return
        if name in found:
            paths = dict.fromkeys((*found[name].paths, path))
            found[name] = found[name]._replace(paths=tuple(paths))
            return
        definition = schema["$defs"][name] if name else schema
        kind = _kind(definition) if several else None
        found[name] = Part((path,), name, kind)
        for key, value in definition["properties"].items():
            inner = list(_inner(value))
            for step, other in inner:
                visit(f"{path}.{key}{step}".strip("."), other, len(inner) > 1)

    visit("", "", False)
    return list(found.values())


def _kind(definition: Schema) -> str:
    """Return the text by which a definition differs from others at its place."""
    if "type" not in definition["properties"]:
        return next(iter(definition["properties"]))
    return f"type: {definition['properties']['type'].get('const', 'my_module:MyClass')}"


def anchor(name: str) -> str:
    """Return the anchor of a table: its heading as GitHub and MyST shorten it."""
    return _anchors()[name]


@cache
def _anchors() -> dict[str, str]:
    return {
        part.name: re.sub(r"[^\w\- ]", "", heading(part).lstrip("# ").lower()).replace(" ", "-")
        for part in parts(file_schema())
    }


def _inner(value: Schema, step: str = "") -> Iterator[tuple[str, str]]:
    """Yield the definitions that a value may have, each with the path from the key to them."""
    if "$ref" in value:
        yield step, value["$ref"].rsplit("/", 1)[-1]
    for choice in ("anyOf", "oneOf"):
        for option in value.get(choice, ()):
            yield from _inner(option, step)
    if isinstance(value.get("items"), dict):
        yield from _inner(value["items"], f"{step}.N")
    if isinstance(value.get("additionalProperties"), dict):
        yield from _inner(value["additionalProperties"], f"{step}.NAME")


def heading(part: Part) -> str:
    """Return the heading of the table of a part."""
    if not part.name:
        return "## The whole file"
    level = "##" if "." not in part.paths[0] and part.kind is None else "###"
    kind = f": `{part.kind}`" if part.kind else ""
    return f"{level} {', '.join(f'`{path}`' for path in part.paths)}{kind}"


def _table(definition: Schema) -> str:
    required = definition.get("required", ())
    rows = ["| Key | Value | Unit | Default | Meaning |", "|---|---|---|---|---|"]
    for key, value in definition["properties"].items():
        text, unit = _told(value["description"])
        default = "**required**" if key in required else _default(value)
        cells = [f"`{key}`", _values(value), unit, default, text]
        rows.append("| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |")
    return "\n".join(rows) + "\n"


def _told(description: str) -> tuple[str, str]:
    """Return a description and the unit that it names."""
    unit = _UNIT.search(description)
    if unit is None:
        return _words(description), ""
    rest = description[: unit.start()] + description[unit.end() :]
    return _words(rest.lstrip(";, ")), unit[1]


def _words(text: str) -> str:
    """Return the text of a docstring as Markdown."""
    text = re.sub(r"``(.+?)``", r"`\1`", text)
    text = re.sub(r"\bNone\b", "`null`", text)
    return text.removesuffix(".").replace("<", r"\<")


def _sentence(text: str) -> str:
    return _words(text).rstrip(".:") + "."


def _default(value: Schema) -> str:
    default = value.get("default")
    if isinstance(default, dict):
        kind = default.get("type")
        return f"`{{type: {kind}}}`" if kind else ("none" if not default else "its defaults")
    if default is None or default == []:
        return "none"
    if isinstance(default, list):
        return f"`{json.dumps([_number(x) for x in default])}`"
    return f"`{_number(default)}`"


def _number(value: Any) -> Any:
    """Return a value as YAML writes it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return int(value) if value.is_integer() else float(f"{value:.7g}")
    return value


def _values(value: Schema) -> str:
    """Return the allowed values of a key in words."""
    if "$ref" in value:
        name = value["$ref"].rsplit("/", 1)[-1]
        return f"[keys](#{anchor(name)})"
    if "anyOf" in value or "oneOf" in value:
        return _one_of(value.get("anyOf") or value["oneOf"])
    if "const" in value:
        return f"`{value['const']}`"
    if "enum" in value:
        return _or([f"`{each}`" for each in value["enum"]])
    kind = value.get("type")
    if kind == "array":
        return _list(value)
    if kind == "object":
        inner = value.get("additionalProperties")
        plain = not isinstance(inner, dict) or not inner
        return "names and values" if plain else f"names, each with {_values(inner)}"
    words = {"boolean": "`true` or `false`", "string": "text", "null": "`null`", None: "anything"}
    if kind in words:
        return words[kind]
    number = "whole number" if kind == "integer" else "number"
    return f"{number} {_range(value)}".strip()


def _one_of(options: list[Schema]) -> str:
    """Return alternatives in words. Parts with a ``type`` are named by it."""
    refs = [option["$ref"].rsplit("/", 1)[-1] for option in options if "$ref" in option]
    refs = [name for name in refs if name != "CreatureFile"]
    if len(refs) > 1:
        kinds = file_schema()["$defs"]
        links = []
        for name in refs:
            kind = kinds[name]["properties"].get("type", {}).get("const", "your own")
            links.append(f"[{kind}](#{anchor(name)})")
        return _or(links)
    told = [
        _values(option)
        for option in options
        # An optional key may always be null, so null is not listed.
        if option.get("type") != "null" and option.get("$ref", "")[-12:] != "CreatureFile"
    ]
    return _or(list(dict.fromkeys(told)))


def _or(words: list[str]) -> str:
    return " or ".join(filter(None, (", ".join(words[:-1]), words[-1])))


def _list(value: Schema) -> str:
    fixed = value.get("prefixItems")
    fewest, most = value.get("minItems"), value.get("maxItems")
    if fixed or (fewest is not None and fewest == most):
        each = {_values(item) for item in fixed or [value["items"]]}
        assert len(each) == 1, value
        return f"{fewest} {_plural(each.pop())}"
    bounds = ""
    if fewest and most:
        bounds = f" ({fewest} to {most})"
    elif most:
        bounds = f" (at most {most})"
    elif fewest:
        bounds = f" (at least {fewest})"
    return f"list{bounds} of {_plural(_values(value['items']))}"


def _plural(words: str) -> str:
    """Return the plural of the words for a value."""
    if words[:1].isdigit():
        return f"lists of {words}"
    return re.sub(r"^(whole number|number|list|text)(?!s)", r"\1s", words)


def _range(value: Schema) -> str:
    """Return the bounds of a number in words, without bounds that are far away."""
    low, high, above, below = (
        None if key not in value or abs(value[key]) >= _BEYOND else _number(value[key])
        for key in ("minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum")
    )
    if low is not None and high is not None:
        return f"from {low} to {high}"
    bounds = (("of at least", low), ("above", above), ("up to", high), ("below", below))
    return ", ".join(f"{word} {bound}" for word, bound in bounds if bound is not None)
