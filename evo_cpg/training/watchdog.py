"""Work that may never end, watched: a limit of time, and an interrupt that is heard.

What waits for another process waits in C++, where neither an interrupt nor a clock of Python's
reaches it. JAX's heartbeat finds who is dead or stopped, but not who lives and is stuck. So such
work is done in a thread, and the main thread waits for that one.
"""

import threading
from collections.abc import Callable
from typing import Any, TypeVar

Result = TypeVar("Result")


def finish_within(limit: float, work: Callable[[], Result]) -> Result:
    """What some work gives.

    Args:
        limit: so long it may take, s.
        work: raises what this raises. It goes on where it is given up, for nobody can end it: the
            process should, by `os._exit`.

    Raises:
        TimeoutError: it takes longer.
    """
    results: list[Any] = []
    errors: list[BaseException] = []
    over = threading.Event()

    def run() -> None:
        try:
            results.append(work())
        except BaseException as error:
            errors.append(error)
        finally:
            over.set()

    threading.Thread(target=run, name="watched", daemon=True).start()
    if not over.wait(limit):
        raise TimeoutError(f"not done after {limit:.1f} s")
    if errors:
        raise errors[0]
    return results[0]
