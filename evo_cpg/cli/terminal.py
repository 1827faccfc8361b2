"""Messages and tables on the terminal, and streams whose errors never end a command.

If a disk is full or a pipe is closed, output is lost and the work continues. Characters that the
locale lacks are escaped.
"""

import contextlib
import errno
import io
import itertools
import os
import sys
import warnings
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, TextIO

from evo_cpg.errors import Advice
from evo_cpg.system import folded

# Characters between two columns of a table.
_GAP = 3
# Least width of a column of sentences, characters.
_SENTENCE = 10


def tell(words: str) -> None:
    """Print words to standard error. On a terminal, no word is broken."""
    print(folded(words, sys.stderr), file=sys.stderr)


def warn(words: object) -> None:
    """Print a warning to standard error."""
    tell(f"evo-cpg: warning: {words}")


@contextlib.contextmanager
def advice_printed() -> Iterator[None]:
    """Print each `Advice` as a line while the block lasts."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", Advice)
        before = warnings.showwarning

        def show(message: Any, category: type[Warning], *place: Any, **more: Any) -> None:
            if issubclass(category, Advice):
                warn(message)
            else:
                before(message, category, *place, **more)

        warnings.showwarning = show
        yield


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


class _Raw(io.FileIO):
    """Descriptor that keeps the first write error and raises none.

    Attributes:
        error: first write error, or None before.
    """

    error: OSError | None = None

    def write(self, data, /) -> int:
        try:
            return super().write(data)
        except OSError as error:
            self.error = self.error or error
            return memoryview(data).nbytes


def protect() -> None:
    """Replace the standard output and error of this process by streams that never raise."""
    for descriptor in (0, 1, 2):
        # Open the null device at the number of a closed stream. Otherwise a file of ours could get
        # the number, and libraries that print to it would write into the file.
        try:
            os.fstat(descriptor)
        except OSError:
            null = os.open(os.devnull, os.O_RDWR)
            if null != descriptor:
                os.dup2(null, descriptor)
                os.close(null)
            os.set_inheritable(descriptor, True)
    for name, descriptor in (("stdout", 1), ("stderr", 2)):
        before = getattr(sys, name)
        with contextlib.suppress(OSError, AttributeError):
            before.flush()
        setattr(sys, name, opened(descriptor, before))


def opened(descriptor: int, like: TextIO | None) -> TextIO:
    """Open a descriptor for text, as a stream that never raises.

    Args:
        descriptor: descriptor to write to.
        like: stream to replace, for its encoding, or None if the stream was closed.
    """
    # If PYTHONUNBUFFERED is set, Python's streams are not buffered. Buffer them by line here.
    by_line = getattr(like, "line_buffering", True) or getattr(like, "write_through", False)
    return io.TextIOWrapper(
        io.BufferedWriter(_Raw(descriptor, "wb", closefd=False)),
        encoding=getattr(like, "encoding", None) or "utf-8",
        errors="backslashreplace",
        line_buffering=by_line,
    )


def output_error() -> OSError | None:
    """Return the first write error of standard output, or None.

    A pipe that its reader closed is an error, too. Only a write detects it.
    """
    sys.stdout.flush()
    raw = getattr(getattr(sys.stdout, "buffer", None), "raw", None)
    return raw.error if isinstance(raw, _Raw) else None


def is_read() -> bool:
    """Return whether standard output may still have a reader."""
    error = output_error()
    return error is None or error.errno != errno.EPIPE
