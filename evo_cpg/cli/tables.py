"""Tables and sentences on the terminal."""

import sys
from collections.abc import Iterable, Sequence

from evo_cpg.system import folded


def show_words(words: str) -> None:
    """Print words to standard output. On a terminal, no word is broken."""
    print(folded(words, sys.stdout))


def show_table(
    heads: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    left: int = 1,
    title: str | None = None,
    width: int = 0,
) -> None:
    """Print a table.

    Args:
        heads: head of each column.
        rows: cells of each row.
        left: number of first columns with text, which folds. The other columns hold numbers.
        title: title above the table.
        width: least width, characters, even on a narrower terminal.
    """
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for number, head in enumerate(heads):
        is_text = number < left
        table.add_column(
            head,
            justify="left" if is_text else "right",
            overflow="fold",
            no_wrap=not is_text,
        )
    for row in rows:
        table.add_row(*row)
    console = Console(highlight=False, markup=False)
    console.width = max(width, console.width)
    console.print(table)
