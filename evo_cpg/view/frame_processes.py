"""Draw frames in several processes, because a software renderer leaves cores idle.

Each process builds the whole scene once. A frame does not depend on the process that draws it,
except on uneven ground. The horizon follows the focus in steps there, so an opacity may differ by
one of 255 levels.
"""

import atexit
import contextlib
import functools
import itertools
import multiprocessing
import signal
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from typing import Protocol

import jax
import numpy as np

# Starting a process and building its scene takes as long as this many frames. Two processes took as
# long as one for 240 frames of the swimmer on two cores. They took 40 s instead of 47 s for 1000
# frames.
_WORTH = 120
# Most processes: each holds the libraries and a scene, some 400 MB.
_MOST = 8
# Frames for each process that are being drawn, or in memory, at once.
_AHEAD = 3


class Reel(Protocol):
    """Frames that can be drawn in any order, such as `evo_cpg.view.frames.Frames`.

    Attributes:
        count: number of frames.
        size: width and height of a frame in the result, pixels.
        rendered: width and height of a frame before averaging, pixels.
    """

    count: int
    size: tuple[int, int]
    rendered: tuple[int, int]

    def drawn(self) -> contextlib.AbstractContextManager[Callable[[int], np.ndarray]]:
        """Build the scenes, and close them at the end of the context.

        Yields:
            A function that draws the frame of a given number: ``(height, width, 3)`` bytes, bottom
            row first. The next call may overwrite the result.
        """
        ...


# Function that lays out the frames, in a process that draws.
_makers: list[Callable[[], Reel]] = []


class DrawingError(RuntimeError):
    """A process that draws frames failed."""


def drawing_processes(frames: int, cores: int) -> int:
    """Return the number of processes that draw the frames fastest.

    Args:
        frames: number of frames.
        cores: number of usable cores.
    """
    return max(1, min(cores, frames // _WORTH, _MOST))


@contextlib.contextmanager
def drawn_frames(
    frames: Reel, make: Callable[[], Reel], processes: int
) -> Iterator[Iterator[np.ndarray]]:
    """Draw all frames, one after the other.

    Args:
        frames: the frames.
        make: function that lays out the same frames in another process.
        processes: number of drawing processes. With 1, this process draws.

    Yields:
        The frames in order: ``(height, width, 3)`` bytes, bottom row first. Each is valid until the
        next one.

    Raises:
        DrawingError: one of the processes failed.
    """
    if processes == 1:
        with frames.drawn() as draw:
            yield map(draw, range(frames.count))
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, context, _prepare, (make,)) as pool:
        try:
            yield _in_order(pool, frames.count, _AHEAD * processes)
        finally:
            pool.shutdown(cancel_futures=True)


def _in_order(pool: Executor, count: int, ahead: int) -> Iterator[np.ndarray]:
    numbers = iter(range(count))
    awaited = deque(pool.submit(_draw, number) for number in itertools.islice(numbers, ahead))
    while awaited:
        try:
            picture = awaited.popleft().result()
        except Exception as error:
            raise DrawingError(f"a process that draws frames failed: {error}") from error
        yield picture
        awaited.extend(pool.submit(_draw, number) for number in itertools.islice(numbers, 1))


def _prepare(make: Callable[[], Reel]) -> None:
    """Store the function that lays out the frames."""
    # Ignore Ctrl-C, because the parent process stops this one.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # The CPU is enough for heights of the ground.
    jax.config.update("jax_platforms", "cpu")
    _makers[:] = [make]


def _draw(number: int) -> np.ndarray:
    return _scene()(number)


@functools.cache
def _scene() -> Callable[[int], np.ndarray]:
    stack = contextlib.ExitStack()
    atexit.register(stack.close)
    return stack.enter_context(_makers[0]().drawn())
