"""Frames drawn by several processes: a software renderer leaves cores idle, most with many bodies.

Each process sets the whole scene and draws every so-manieth frame; they come back in order, by a
pipe each. They are the same whoever draws them, but on uneven ground, where the horizon follows the
focus in steps: there an opacity may differ by one of 255 levels.
"""

import contextlib
import os
import pickle
import subprocess
import sys
from collections.abc import Iterator, Sequence
from typing import IO, cast

import numpy as np

from evo_cpg.system import scratch_file
from evo_cpg.view.frames import Frames, Plan

# To start a process and to set its scene takes as long as so many frames: of the swimmer, on two
# cores, 240 frames took two processes as long as one, 1000 took them 40 s instead of 47.
_WORTH = 120
# Each holds the libraries and a scene: some 400 MB.
_MOST = 8


class DrawingError(RuntimeError):
    """A process that draws frames has ended before it was done."""


def drawing_processes(frames: int, cores: int) -> int:
    """How many processes draw so many frames fastest.

    Args:
        frames: to draw.
        cores: that may be used.
    """
    return max(1, min(cores, frames // _WORTH, _MOST))


@contextlib.contextmanager
def drawn_frames(plan: Plan, frames: Frames, processes: int) -> Iterator[Iterator[np.ndarray]]:
    """Draw all frames, one after the other.

    Args:
        plan: of the frames.
        frames: laid out by that plan.
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
    command = [sys.executable, "-P", "-m", __name__]
    # What this process can import; the CPU, for heights of the ground need no more.
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "JAX_PLATFORMS": "cpu"}
    with contextlib.ExitStack() as stack:
        complaints = [stack.enter_context(scratch_file()) for _ in range(processes)]
        started = [
            stack.enter_context(
                _ended(
                    subprocess.Popen(
                        command,
                        stdin=subprocess.PIPE,
                        stdout=subprocess.PIPE,
                        stderr=file,
                        env=environment,
                    )
                )
            )
            for file in complaints
        ]
        for first, process in enumerate(started):
            # One that has ended already is told of where its frames are missing.
            with contextlib.suppress(BrokenPipeError), cast(IO[bytes], process.stdin) as pipe:
                pickle.dump((plan, first, processes), pipe)
        yield _in_turn(frames, started, complaints)


def _in_turn(
    frames: Frames, started: list[subprocess.Popen], complaints: Sequence[IO[bytes]]
) -> Iterator[np.ndarray]:
    picture = np.empty((frames.rendered[1], frames.rendered[0], 3), np.uint8)
    whole = memoryview(picture.data).cast("B")
    for number in range(frames.count):
        turn = number % len(started)
        pipe, filled = cast(IO[bytes], started[turn].stdout), 0
        while filled < len(whole):
            read = pipe.readinto(whole[filled:])  # pyright: ignore[reportAttributeAccessIssue]
            if not read:
                complaints[turn].seek(0)
                said = complaints[turn].read().decode(errors="replace").strip().splitlines()
                reason = said[-1] if said else f"code {started[turn].wait()}"
                raise DrawingError(f"a process that draws frames has ended: {reason}")
            filled += read
        yield picture


@contextlib.contextmanager
def _ended(process: subprocess.Popen) -> Iterator[subprocess.Popen]:
    """The process does not outlive the block."""
    try:
        yield process
    finally:
        process.kill()
        for pipe in (process.stdin, process.stdout):
            with contextlib.suppress(BrokenPipeError):
                cast(IO[bytes], pipe).close()
        process.wait()


def _draw_share() -> None:
    """Draw what stands on standard input; the frames go to standard output."""
    plan, first, every = pickle.load(sys.stdin.buffer)
    # Libraries that print must not print into the frames.
    out = os.fdopen(os.dup(sys.stdout.fileno()), "wb", buffering=0)
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    frames = Frames(plan)
    with frames.drawn() as draw:
        for number in range(first, frames.count, every):
            left = memoryview(np.ascontiguousarray(draw(number)).data).cast("B")
            while left:
                left = left[out.write(left) :]


if __name__ == "__main__":
    # Interrupted, or nobody reads any more: whoever started it knows.
    with contextlib.suppress(BrokenPipeError, KeyboardInterrupt):
        _draw_share()
