"""HTML that is safe from injection: everything but `Html` is escaped as text."""

import html
from typing import Any


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
    inner = join(*children)
    if name in _VOID:
        return Html(f"<{' '.join(words)}>")
    return Html(f"<{' '.join(words)}>{inner}</{name}>")


def join(*parts: Any) -> Html:
    """Join parts: `Html` is kept, other values become text, and None is left out."""
    return Html("".join(_inner(part) for part in parts if part is not None))


def table(head: list[Any], rows: list[list[Any]], *, numbers: tuple[int, ...] = ()) -> Html:
    """Return a table.

    Args:
        head: headings of the columns.
        rows: cells of each row.
        numbers: columns that are set flush right.
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


_DOZEN = 12
_VOID = ("img", "input", "meta", "br")


def _inner(part: Any) -> str:
    return part if isinstance(part, Html) else html.escape(str(part))
