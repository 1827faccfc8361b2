"""What long work shows while it goes on: a bar on a terminal, lines elsewhere."""

import contextlib
import sys
from collections.abc import Callable, Iterator

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn


@contextlib.contextmanager
def progress(
    title: str, step: str, total: int, completed: int = 0
) -> Iterator[Callable[[int, str, float], None]]:
    """Show every step of some work.

    Args:
        title: of the bar.
        step: what a step is called.
        total: steps in all.
        completed: steps done before.

    Yields:
        A function to call after every step, with its number (from 0), how things stand, and the
        seconds that it took.
    """
    console = Console(stderr=True)
    if not console.is_terminal:

        def tell(number: int, state: str, seconds: float) -> None:
            words = f"{step} {number + 1:4d}/{total}  {state}  {seconds:6.2f} s"
            print(words, file=sys.stderr, flush=True)

        yield tell
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=24),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[state]}"),
    )
    with Progress(*columns, console=console) as bars:
        bar = bars.add_task(title, total=total, completed=completed, state="compiling")

        def advance(number: int, state: str, seconds: float) -> None:
            del number, seconds
            bars.update(bar, advance=1, state=state)

        yield advance
