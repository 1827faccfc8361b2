"""Tables and sentences on the terminal."""

import itertools
import sys
from collections.abc import Iterable, Sequence

from evo_cpg.system import folded

# Characters between two columns of a table.
_GAP = 3
# Least width of a column of sentences, characters.
_SENTENCE = 10


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

    console = Console(highlight=False, markup=False)
    console.width = max(width, console.width)
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    rows = list(rows)
    columns = list(itertools.zip_longest(heads, *rows, fillvalue=""))
    # Columns of names and numbers stay whole if there is room. Sentences need less.
    longest = [max(map(len, column)) for column in columns]
    sentences = [any(" " in cell for cell in column) for column in columns[:left]]
    needed = [min(n, _SENTENCE) if s else n for n, s in zip(longest, sentences, strict=False)]
    fits = sum([*needed, *longest[left:]]) + _GAP * len(heads) <= console.width
    for number, head in enumerate(heads):
        is_text = number < left
        is_name = is_text and fits and not sentences[number]
        table.add_column(
            head,
            justify="left" if is_text else "right",
            overflow="fold",
            no_wrap=is_name or not is_text,
        )
    for row in rows:
        table.add_row(*row)
    console.print(table)
