"""Parts of every page: HTML that is safe from injection, its files, its policy, and its numbers.

Everything but `Html` is escaped as text.
"""

import base64
import hashlib
import html
import math
from collections.abc import Sequence
from importlib import resources
from pathlib import PurePath
from typing import Any, NamedTuple

import numpy as np

# Rows of a long table that are not folded away.
_DOZEN = 12
# Elements without an end.
_VOID = ("img", "input", "link", "meta", "br")
# Letters of the longest text in a cell.
_LETTERS = 120


class Html(str):
    """Text that is already HTML."""

    __slots__ = ()


def tag(name: str, /, *children: Any, **attributes: Any) -> Html:
    """Return an element.

    Args:
        name: name of the element.
        children: contents. `Html` is kept, other values become text, and None is left out.
        attributes: attributes of the element, with ``_`` for ``-`` and a trailing ``_`` dropped
            (``class_``). True is an attribute without a value. None and False are left out.
    """
    words = [name]
    for key, value in attributes.items():
        key = key.rstrip("_").replace("_", "-")
        if value is True:
            words.append(key)
        elif value is not None and value is not False:
            words.append(f'{key}="{html.escape(str(value))}"')
    end = "" if name in _VOID else f"{join(*children)}</{name}>"
    return Html(f"<{' '.join(words)}>{end}")


def join(*parts: Any) -> Html:
    """Join parts: `Html` is kept, other values become text, and None is left out."""
    made = (part if isinstance(part, Html) else html.escape(str(part)) for part in parts
            if part is not None)  # fmt: skip
    return Html("".join(made))


def table(head: list[Any], rows: list[list[Any]], *, numbers: tuple[int, ...] = ()) -> Html:
    """Return a table.

    The columns in ``numbers`` are set flush right.
    """

    def row(cells: list[Any], name: str) -> Html:
        made = (
            tag(name, cell, class_="number" if i in numbers else None)
            for i, cell in enumerate(cells)
        )
        return tag("tr", *made)

    body = tag("tbody", *(row(cells, "td") for cells in rows))
    inner = tag("table", tag("thead", row(head, "th")), body)
    return tag("div", inner, class_="wide")


def long_table(head: list[Any], rows: list[list[Any]], *, numbers: tuple[int, ...] = ()) -> Html:
    """Return a table whose rows after the first dozen are folded away."""
    first = table(head, rows[:_DOZEN], numbers=numbers)
    if len(rows) <= _DOZEN:
        return first
    rest = table(head, rows[_DOZEN:], numbers=numbers)
    return join(first, tag("details", tag("summary", f"{len(rows) - _DOZEN} more rows"), rest))


class Page(NamedTuple):
    """A whole page.

    Attributes:
        text: the page, as HTML.
        policy: its content security policy, which names its scripts by their digests.
    """

    text: str
    policy: str


def whole_page(
    title: str, style: str, body: str, scripts: Sequence[str], is_served: bool = False
) -> Page:
    """Return a page that may run its own scripts and load nothing.

    Args:
        title: title of the page, as text.
        style: style sheets.
        body: HTML of the body, which is not escaped.
        scripts: scripts in their order.
        is_served: whether the page may call its own server, which sends the policy. If not, the
            page is a file, and contains its policy.
    """
    digests = (base64.b64encode(hashlib.sha256(x.encode()).digest()).decode() for x in scripts)
    allowed = " ".join(f"'sha256-{digest}'" for digest in digests)
    policy = (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data: "
        "blob:; base-uri 'none'; form-action 'none'"
    )
    if is_served:
        policy += "; connect-src 'self'; frame-ancestors 'none'"
        more = tag("link", rel="icon", href="data:,")
    else:
        more = join(
            tag("meta", http_equiv="Content-Security-Policy", content=policy),
            tag("meta", name="generator", content="evo-cpg analyse"),
        )
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        more,
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("title", title),
        tag("style", Html(style)),
    )
    inner = join(Html(body), *(tag("script", Html(script)) for script in scripts))
    return Page(f"<!doctype html>\n{tag('html', head, tag('body', inner), lang='en')}", policy)


def asset(name: str, package: str = "evo_cpg.view.run_page") -> str:
    """Return the text of a file of a page."""
    return resources.files(package).joinpath(name).read_text(encoding="utf-8")


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


def quantity(value: Any, unit: Any) -> str:
    """Return a number from a file with its unit, or an empty text for any other value."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not math.isfinite(value):
        return ""
    return f"{100 * value:.3g} %" if unit == "%" else f"{value:.3g} {unit}".rstrip()


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
