"""Write the API reference as Markdown, from the signatures and docstrings of public names."""

import inspect
import re
import textwrap
from functools import cache
from typing import Any

import griffe

PACKAGE = "evo_cpg"
WIDTH = 100
_LISTED = {"parameters": "Arguments", "attributes": "Attributes", "raises": "Raises"}


def reference(names: list[str]) -> str:
    """Return the entries of public names.

    Args:
        names: ``NAME`` for a function or a class, ``NAME:*`` with all documented methods,
            ``NAME:a,b`` with these methods.
    """
    return "\n".join(_entry(*name.partition(":")[::2]) for name in names)


@cache
def _package() -> Any:
    # A description of a result may have several lines and may contain a colon.
    options = {"returns_multiple_items": False, "returns_named_value": False}
    return griffe.load(PACKAGE, docstring_parser="google", docstring_options=options)


def _entry(name: str, members: str) -> str:
    thing = _package().members[name].final_target
    pieces = [f"### `{name}`\n"]
    if thing.is_function:
        pieces.append(_signature("evo.", thing))
    pieces.append(_text(thing))
    for method in _methods(thing, members):
        pieces += [f"#### `{name}.{method.name}`\n", _signature("", method), _text(method)]
    return "\n".join(piece for piece in pieces if piece)


def _methods(thing: Any, members: str) -> list[Any]:
    chosen = [member for member in members.split(",") if member not in ("", "*")]
    if chosen:
        return [thing.members[member] for member in chosen]
    if not members:
        return []
    return [
        member
        for name, member in thing.members.items()
        if not name.startswith("_") and member.docstring and not member.is_alias
    ]


def _signature(prefix: str, thing: Any) -> str:
    if not thing.is_function:  # a property
        return ""
    line = thing.signature()
    if len(prefix + line) > WIDTH:
        inside = ",\n    ".join(str(p) for p in _parameters(line))
        head, _, tail = line.partition("(")[0], "", line.rpartition(")")[2]
        line = f"{head}(\n    {inside},\n){tail}"
    return f"```python\n{prefix}{line}\n```\n"


def _parameters(signature: str) -> list[str]:
    """Split the arguments of a signature at its outermost commas."""
    inside = signature[signature.index("(") + 1 : signature.rindex(")")]
    parts, depth = [""], 0
    for letter in inside:
        depth += (letter in "([{") - (letter in ")]}")
        if letter == "," and not depth:
            parts.append("")
        else:
            parts[-1] += letter
    return [part.strip() for part in parts]


def _text(thing: Any) -> str:
    pieces = []
    for section in thing.docstring.parsed if thing.docstring else ():
        if section.kind.value == "text":
            pieces.append(_paragraphs(section.value))
        elif section.kind.value == "returns":
            pieces.append("**Returns**\n")
            pieces += [_item("", item.description) for item in section.value]
            pieces.append("")
        elif section.kind.value in _LISTED:
            pieces.append(f"**{_LISTED[section.kind.value]}**\n")
            pieces += [_item(_name(item), item.description) for item in section.value]
            pieces.append("")
        elif section.kind.value == "admonition":
            pieces += [f"**{section.title}**\n", _paragraphs(section.value.description)]
        else:
            raise ValueError(f"{thing.path}: unknown docstring section {section.kind.value!r}")
    return "\n".join(pieces)


def _name(item: Any) -> str:
    return str(getattr(item, "name", None) or item.annotation)


def _item(name: str, text: str) -> str:
    head = f"- `{name}`: " if name else "- "
    return textwrap.fill(
        head + " ".join(_markdown(text).split()), WIDTH, subsequent_indent="  ", **_WHOLE
    )


def _paragraphs(text: str) -> str:
    """Wrap running text and fence code that follows ``::``. Lists and tables stay unchanged."""
    prose, mark, code = _markdown(text).partition("::\n\n")
    done = []
    for block in (prose + ":" * bool(mark)).split("\n\n"):
        plain = not re.search(r"^([-*|] |\d+\. )", block, re.M)
        done.append(textwrap.fill(" ".join(block.split()), WIDTH, **_WHOLE) if plain else block)
    if code:
        done.append(f"```python\n{textwrap.dedent(code).rstrip()}\n```")
    return "\n\n".join(done) + "\n"


_WHOLE = {"break_long_words": False, "break_on_hyphens": False}


def _markdown(text: str) -> str:
    text = inspect.cleandoc(text)
    text = re.sub(r"``(.+?)``", r"`\1`", text, flags=re.S)
    # Public names are attributes of `evo`. Modules keep their path.
    return re.sub(rf"`{PACKAGE}\.(?=[A-Z]|\w+[`(])", "`evo.", text)
