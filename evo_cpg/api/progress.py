"""A line on standard error for work that takes long: on a terminal and in a notebook, or if asked.

A library prints nothing that its user did not request, so logs and pipes stay clean. But the
first call of a program compiles it, which takes seconds or, for a large animal, minutes. A user who
watches should know what is going on.
"""

import contextlib
import sys
import threading
import time
from collections.abc import Iterator

# Shorter work prints no line, s.
_SOON = 1.0

# Between two lines about generations, s.
_BETWEEN = 10.0

_shown: bool | None = None


def show_progress(on: bool | None = None) -> None:
    """Choose whether long work of this library prints its progress to standard error.

    Args:
        on: True for always, False for never, None for only on a terminal and in a notebook, as it
            is from the start.
    """
    global _shown
    _shown = on


@contextlib.contextmanager
def working(what: str) -> Iterator[None]:
    """Print the name of work that takes more than a second, and afterwards its duration.

    Args:
        what: name of the work.
    """
    if not _is_shown():
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
        if printed.is_set():
            _say(f"{what}: {time.monotonic() - start:.1f} s")


class Generations:
    """Tells how far a search is, a line every ten seconds.

    Args:
        total: generations of the search.
    """

    def __init__(self, total: int):
        self._total, self._done, self._next = total, 0, time.monotonic() + _BETWEEN

    def add(self, best: float) -> None:
        """Count a generation, and tell how far the search is if a line is due.

        Args:
            best: fitness so far.
        """
        self._done += 1
        if time.monotonic() >= self._next and _is_shown():
            self._next = time.monotonic() + _BETWEEN
            _say(f"{self._done} of {self._total} generations, best fitness {best:.4g}")


def _is_shown() -> bool:
    """Return whether somebody watches, or asked for it."""
    if _shown is not None:
        return _shown
    # Standard error of a notebook is no terminal.
    return sys.stderr is not None and (sys.stderr.isatty() or "ipykernel" in sys.modules)


def _say(line: str) -> None:
    # Work continues if the stream is closed.
    with contextlib.suppress(OSError, ValueError):
        print(f"evo_cpg: {line}", file=sys.stderr, flush=True)
