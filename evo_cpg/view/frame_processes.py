"""Draw frames in several processes: a software renderer leaves cores idle, most with many bodies.

Each process sets the whole scene once. A frame does not depend on the process that draws it, except
on uneven ground: the horizon follows the focus in steps, so an opacity may differ by one of 255
levels.
"""

import atexit
import contextlib
import functools
import itertools
import multiprocessing
import signal
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor

import jax
import numpy as np

from evo_cpg.view.frames import Film, Frames
from evo_cpg.view.scene import Panel

# To start a process and to set its scene takes as long as so many frames: of the swimmer, on two
# cores, 240 frames took two processes as long as one, 1000 took them 40 s instead of 47.
_WORTH = 120
# Each holds the libraries and a scene: some 400 MB.
_MOST = 8
# Frames for each process that are drawn, or in memory, at once.
_AHEAD = 3

# In a process that draws: the animals and the settings.
_films: list[tuple[Sequence[Panel], Film]] = []


class DrawingError(RuntimeError):
    """A process that draws frames failed."""


def drawing_processes(frames: int, cores: int) -> int:
    """Return how many processes draw so many frames fastest.

    Args:
        frames: to draw.
        cores: that may be used.
    """
    return max(1, min(cores, frames // _WORTH, _MOST))


@contextlib.contextmanager
def drawn_frames(
    panels: Sequence[Panel], film: Film, frames: Frames, processes: int
) -> Iterator[Iterator[np.ndarray]]:
    """Draw all frames, one after the other.

    Args:
        panels: the animals.
        film: settings.
        frames: laid out by these.
        processes: that draw them; with one it is this process.

    Yields:
        The frames in order: ``(height, width, 3)`` bytes, bottom row first; each lasts until the
        next one.

    Raises:
        DrawingError: one of the processes failed.
    """
    if processes == 1:
        with frames.drawn() as draw:
            yield map(draw, range(frames.count))
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, context, _prepare, (panels, film)) as pool:
        try:
            yield _in_order(pool, frames.count, _AHEAD * processes)
        finally:
            pool.shutdown(cancel_futures=True)


def _in_order(pool: ProcessPoolExecutor, count: int, ahead: int) -> Iterator[np.ndarray]:
    numbers = iter(range(count))
    awaited = deque(pool.submit(_draw, number) for number in itertools.islice(numbers, ahead))
    while awaited:
        try:
            picture = awaited.popleft().result()
        except Exception as error:
            raise DrawingError(f"a process that draws frames failed: {error}") from error
        yield picture
        awaited.extend(pool.submit(_draw, number) for number in itertools.islice(numbers, 1))


def _prepare(panels: Sequence[Panel], film: Film) -> None:
    """Store what this process draws."""
    # The process that started this one stops it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Heights of the ground need no more.
    jax.config.update("jax_platforms", "cpu")
    _films[:] = [(panels, film)]


def _draw(number: int) -> np.ndarray:
    return _scene()(number)


@functools.cache
def _scene() -> Callable[[int], np.ndarray]:
    stack = contextlib.ExitStack()
    atexit.register(stack.close)
    return stack.enter_context(Frames(*_films[0]).drawn())
