"""What C++ prints on the two standard streams, kept apart from what the program says.

When a process is lost JAX ends the others from C++, with a page of log that does not name the
cause in words of ours, and gloo greets on standard output, where scripts read the path of the run.
So both descriptors lead into a pipe, while Python writes to where they led before. Lines about
the processes are kept back; others pass. Where C++ aborts because of them, one line says it.
"""

import contextlib
import ctypes
import os
import re
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable

from evo_cpg.cli.streams import opened
from evo_cpg.fusion.jax_internals import is_of_coordination

# Lines of a log that begin an entry; those after it belong to it.
_ENTRY = re.compile(r"[IWEF]\d{4} \d\d:\d\d:")
_GREETING = "[Gloo] "

_KEPT_LINES = 200

# What was logged just before an abort is read within this time, s.
_LATE = 0.2

_ABORTED = signal.SIGABRT


def keep_apart(explain: Callable[[str], str | None], code: int) -> None:
    """Keep apart what C++ prints, for as long as this process lives.

    Args:
        explain: what an abort means, in words, from the lines that were kept back; None where
            they do not tell: then they are shown, and the process aborts.
        code: exit code of this process where they do.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    shown, errors = os.dup(1), os.dup(2)
    reading, writing = os.pipe()
    for stream in (1, 2):
        os.dup2(writing, stream)
    os.close(writing)
    sys.stdout, sys.stderr = opened(shown, sys.stdout), opened(errors, sys.stderr)
    kept: deque[str] = deque(maxlen=_KEPT_LINES)

    def read() -> None:
        ours = False
        with os.fdopen(reading, encoding="utf-8", errors="replace") as lines:
            for line in lines:
                if line.startswith(_GREETING):
                    continue
                if _ENTRY.match(line):
                    ours = is_of_coordination(line)
                if ours:
                    kept.append(line)
                else:
                    # Who ends to read would have C++ wait for us.
                    with contextlib.suppress(OSError):
                        os.write(errors, line.encode())

    threading.Thread(target=read, name="native output", daemon=True).start()
    _on_abort(lambda: _end(kept, explain, code, errors))


def _end(kept: deque[str], explain: Callable[[str], str | None], code: int, errors: int) -> None:
    time.sleep(_LATE)
    logged = "".join(kept)
    words = explain(logged)
    with contextlib.suppress(OSError):
        os.write(errors, (logged if words is None else f"{words}\n").encode())
    if words is not None:
        os._exit(code)


def _on_abort(act: Callable[[], None]) -> None:
    """Have something done before C++ aborts.

    A handler of Python's own would run only when the main thread comes back to Python, which it
    does not: this one runs at once, in the thread that aborts.
    """
    try:
        system = ctypes.CDLL(None)
        kind = ctypes.CFUNCTYPE(None, ctypes.c_int)
        setting = system.signal
    except (AttributeError, OSError, TypeError):
        return
    setting.argtypes, setting.restype = [ctypes.c_int, ctypes.c_void_p], ctypes.c_void_p

    def handle(number: int) -> None:
        # Only once: an abort after this one is an abort.
        setting(number, None)
        act()

    _handlers.append(kind(handle))
    setting(int(_ABORTED), ctypes.cast(_handlers[-1], ctypes.c_void_p))


# What C calls must stay where it is.
_handlers: list = []
