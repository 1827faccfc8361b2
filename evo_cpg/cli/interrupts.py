"""Control-C: a KeyboardInterrupt that is neither lost nor ends the process in a crash.

JAX calls Python from places that no exception may leave. An exception in a callback of the garbage
collector, which is frequent, is printed and dropped, and the program continues. An exception while
a cache of C++ hashes or compares its keys ends the process. In these places the interrupt waits for
a moment.
"""

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from types import FrameType
from typing import Any, NoReturn

# No exception may leave these functions, nor the functions that they call.
_SILENT = frozenset({"__hash__", "__eq__", "__del__", "_xla_gc_callback"})

_MOMENT = 0.01  # s


@contextlib.contextmanager
def interrupts_delivered() -> Iterator[None]:
    """Deliver interrupts during the block; ignored interrupts stay ignored."""
    ours = threading.current_thread() is threading.main_thread()
    ours &= hasattr(signal, "pthread_kill")  # Windows has none
    if not ours or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    before, again = sys.unraisablehook, _Again()

    def interrupt(number: int, frame: FrameType | None) -> None:
        if not _must_return(frame):
            raise KeyboardInterrupt
        again()

    def forgotten(unraisable: Any) -> None:
        if issubclass(unraisable.exc_type, KeyboardInterrupt):
            again()
        else:
            before(unraisable)

    signal.signal(signal.SIGINT, interrupt)
    sys.unraisablehook = forgotten
    try:
        yield
    finally:
        again.cancel()
        sys.unraisablehook = before
        signal.signal(signal.SIGINT, signal.default_int_handler)


_waits = True


def wait_for_no_thread() -> None:
    """Have the process leave its threads alone when it ends, of which one may compile for long."""
    global _waits
    _waits = False


def waits_for_threads() -> bool:
    """Return whether the process is to wait for its threads when it ends."""
    return _waits


def leave_at_once(code: int) -> NoReturn:
    """End the process without waiting for its threads, of which one may compile for long."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


class _Again:
    """A request for one more interrupt in a moment; further requests until then change nothing."""

    def __init__(self) -> None:
        self._timer: threading.Timer | None = None
        self._requested = False

    def __call__(self) -> None:
        if self._requested:
            return
        self._requested = True
        # To this thread, so that it wakes up should it sleep by then.
        main = threading.main_thread().ident
        self._timer = threading.Timer(_MOMENT, self._interrupt, [main])
        self._timer.daemon = True
        self._timer.start()

    def _interrupt(self, main: int) -> None:
        # First: the interrupt may ask for another one while this thread has not ended yet.
        self._requested = False
        signal.pthread_kill(main, signal.SIGINT)

    def cancel(self) -> None:
        """Cancel the interrupt, if there is still time."""
        if self._timer is not None:
            self._timer.cancel()


def _must_return(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_name in _SILENT:
            return True
        frame = frame.f_back
    return False
