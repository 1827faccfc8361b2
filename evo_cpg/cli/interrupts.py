"""Control-C: deliver a KeyboardInterrupt without losing it and without a crash.

JAX calls Python from places that no exception may leave. An exception in a callback of the garbage
collector is printed and dropped, and the program continues. This is frequent. An exception while a
C++ cache hashes or compares its keys ends the process. Interrupts in these places are delayed for a
moment.
"""

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from types import FrameType
from typing import Any, NoReturn

# Names of functions that no exception may leave. Neither may it leave the functions that they call.
_SILENT = frozenset({"__hash__", "__eq__", "__del__", "_xla_gc_callback"})

_MOMENT = 0.01  # s


@contextlib.contextmanager
def interrupts_delivered() -> Iterator[None]:
    """Deliver interrupts during the block. If interrupts are ignored, they stay ignored."""
    ours = threading.current_thread() is threading.main_thread()
    ours &= hasattr(signal, "pthread_kill")  # Windows has none
    if not ours or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    before, again = sys.unraisablehook, _Again()

    def interrupt(number: int, frame: FrameType | None) -> None:
        while frame is not None:
            if frame.f_code.co_name in _SILENT:
                again()
                return
            frame = frame.f_back
        raise KeyboardInterrupt

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


# Whether the process must wait for its threads when it ends.
waits = True


def wait_for_no_thread() -> None:
    """Let the process end without waiting for its threads, one of which may compile for long."""
    global waits
    waits = False


def leave_at_once(code: int) -> NoReturn:
    """End the process without waiting for its threads, one of which may compile for long."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


class _Again:
    """Request for one more interrupt in a moment. Further requests until then have no effect."""

    def __init__(self) -> None:
        self._timer: threading.Timer | None = None
        self._requested = False

    def __call__(self) -> None:
        if self._requested:
            return
        self._requested = True
        # Send the signal to the main thread, to wake it up if it sleeps.
        main = threading.main_thread().ident
        self._timer = threading.Timer(_MOMENT, self._interrupt, [main])
        self._timer.daemon = True
        self._timer.start()

    def _interrupt(self, main: int) -> None:
        # Reset this first: the interrupt may request another one before this thread has ended.
        self._requested = False
        signal.pthread_kill(main, signal.SIGINT)

    def cancel(self) -> None:
        """Cancel the interrupt if it was not sent yet."""
        if self._timer is not None:
            self._timer.cancel()
