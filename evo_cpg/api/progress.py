"""Progress lines on standard error.

The first call of a program compiles it, which takes seconds or, for a large animal, minutes. So
that no call seems to hang, such work prints its name. Terminals and notebooks show its duration and
the generations of a search, too. In a log or a pipe, these lines are printed only on request.
"""

import contextlib
import sys
import threading
import time
from collections.abc import Iterator

# Shorter work prints no line, s.
_SOON = 2.0

# Time between two lines about generations, s.
_BETWEEN = 10.0

_shown: bool | None = None


def show_progress(on: bool | None = None) -> None:
    """Choose whether long work of this library prints its progress to standard error.

    Args:
        on: True for all lines, False for none, None (the default) for all lines on a terminal and
            in a notebook, but only the names of long work elsewhere.
    """
    global _shown
    _shown = on


@contextlib.contextmanager
def working(what: str, timed: bool = True) -> Iterator[None]:
    """Print the name of work that takes more than two seconds, and its duration at the end.

    Args:
        what: name of the work.
        timed: whether the work is over at the end of the block, so that its duration is known.
    """
    if _shown is False:
        yield
        return
    start, done, printed = time.monotonic(), threading.Event(), threading.Event()

    def wait() -> None:
        if not done.wait(_SOON):
            printed.set()
            _say(f"{what} ...")

    waiter = threading.Thread(target=wait, name="progress", daemon=True)
    waiter.start()
    try:
        yield
    finally:
        done.set()
        waiter.join()
        if printed.is_set() and timed and _is_shown():
            _say(f"{what}: {time.monotonic() - start:.1f} s")


class Generations:
    """Progress of a search, a line every ten seconds.

    Args:
        total: number of generations of the search.
    """

    def __init__(self, total: int):
        self._total, self._done, self._next = total, 0, time.monotonic() + _BETWEEN

    def add(self, best: float) -> None:
        """Count a generation, and print the progress if a line is due.

        Args:
            best: best fitness so far.
        """
        self._done += 1
        if time.monotonic() >= self._next and _is_shown():
            self._next = time.monotonic() + _BETWEEN
            _say(f"{self._done} of {self._total} generations, best fitness {best:.4g}")


def _is_shown() -> bool:
    """Return whether progress is shown: as chosen, else on a terminal or in a notebook."""
    if _shown is not None:
        return _shown
    # The standard error of a notebook is not a terminal.
    return sys.stderr is not None and (sys.stderr.isatty() or "ipykernel" in sys.modules)


def _say(line: str) -> None:
    # Work continues if the stream is closed.
    with contextlib.suppress(OSError, ValueError):
        print(f"evo_cpg: {line}", file=sys.stderr, flush=True)
