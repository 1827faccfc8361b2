"""Progress on standard error: a moving line on a terminal, plain lines elsewhere.

The first call of a program compiles it, which takes seconds or, for a large animal, minutes. So no
work stays silent: a thread prints its name and duration if the work itself prints nothing. In the
log or pipe of a command, at most `LONGEST_SILENCE` seconds pass between two lines. A script or
notebook prints at intervals that double, because nobody may be waiting.
"""

import contextlib
import dataclasses
import math
import sys
import threading
import time
from collections.abc import Callable, Iterator

from rich.console import Console, RenderableType
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text
from typing_extensions import override

from evo_cpg.system import folded

# Longest time without a line, s.
LONGEST_SILENCE = 10.0

# Time before the first line, and between two lines, s. Shorter than the longest silence, since the
# thread may have to wait for its turn.
FIRST, BETWEEN = 5.0, 8.0

# Interval at which the thread checks the clock, s.
_LOOK = 0.25

# Smallest finished fraction of the work from which the remaining time is estimated.
_LEAST_FRACTION = 0.02

# True for all lines, False for none, None for fewer lines if there is no terminal.
_shown: bool | None = None


def show_progress(on: bool | None = None) -> None:
    """Choose whether long work of this library prints its progress to standard error.

    Args:
        on: True for all lines, False for none. None (the default) is a moving line on a terminal,
            and elsewhere a line after 5 s, 10 s, 20 s and so on.
    """
    global _shown
    _shown = on


@contextlib.contextmanager
def all_lines() -> Iterator[None]:
    """Print all lines in the block, as the commands do."""
    before = _shown
    show_progress(True)
    try:
        yield
    finally:
        show_progress(before)


class Work:
    """Receiver of progress reports of some work. This one ignores them."""

    def say(self, line: str) -> None:
        """Print a line that stays."""

    def doing(self, what: str) -> None:
        """Name the next part of the work."""

    def reached(self, done: int, total: int) -> None:
        """Report how much of the work is done."""

    def step(self, name: str, state: str, seconds: float, done: int, total: int) -> None:
        """Report a finished step, with the name of all steps, the state, and the duration, s."""


class Heartbeat(Work):
    """Progress in a log or a pipe.

    Args:
        what: name of the work.
        printed: time of the last printed line, s, or minus infinity before the first line.
        every: print a line for each step, and lines at most `LONGEST_SILENCE` apart. Otherwise
            print only the lines that are due, at intervals that double.
        clock: function that returns the time, s.
    """

    def __init__(
        self,
        what: str,
        printed: float = -math.inf,
        every: bool = True,
        clock: Callable[[], float] = time.monotonic,
    ):
        self._every, self._clock, self._lock = every, clock, threading.Lock()
        self._wait = BETWEEN if every else FIRST
        self.doing(what)
        # The silence since the last line of earlier work counts, too.
        self._next = self._start + FIRST
        if every and math.isfinite(printed):
            self._next = min(self._next, printed + BETWEEN)

    @override
    def say(self, line: str) -> None:
        if self._every:
            say(line)
            with self._lock:
                self._next = self._clock() + BETWEEN

    @override
    def doing(self, what: str) -> None:
        with self._lock:
            self._what, self._start = what, self._clock()
            self._done: tuple[int, int] | None = None

    @override
    def reached(self, done: int, total: int) -> None:
        with self._lock:
            self._done = done, total

    @override
    def step(self, name: str, state: str, seconds: float, done: int, total: int) -> None:
        count = f"{done:4d}/{total} {name}"
        self.say(f"{count}  {state}  {seconds:6.2f} s")
        count = count if self._every else f"{count}  {state}"
        self.doing(f"{count}, and the next one" if done < total else count)

    def due(self) -> str | None:
        """Return the line that is due, else None. The line counts as printed."""
        with self._lock:
            now = self._clock()
            if now < self._next:
                return None
            self._next = now + self._wait
            self._wait *= 1 if self._every else 2
            words = f"{self._what}: {now - self._start:.0f} s so far"
            if self._done is not None:
                (done, total), elapsed = self._done, now - self._start
                words = f"{self._what}: {done}/{total}, {elapsed:.0f} s"
                if _LEAST_FRACTION * total < done < total:
                    words += f", about {elapsed * (total - done) / done:.0f} s to go"
            return words

    @contextlib.contextmanager
    def beating(self, write: Callable[[str], None] | None = None) -> Iterator["Heartbeat"]:
        """Print due lines, in a thread, while the block lasts.

        Args:
            write: function that prints a line, or None for standard error.
        """
        over = threading.Event()

        def watch() -> None:
            while not over.wait(_LOOK):
                line = self.due()
                if line is not None:
                    (write or say)(line)

        thread = threading.Thread(target=watch, name="heartbeat", daemon=True)
        thread.start()
        try:
            yield self
        finally:
            over.set()
            thread.join()


@dataclasses.dataclass
class _Line(Work):
    """Progress on a terminal."""

    bars: "_Bars"
    bar: TaskID

    def say(self, line: str) -> None:
        self.bars.console.print(line, markup=False, highlight=False)

    def doing(self, what: str) -> None:
        self.bars.update(self.bar, description=what.lstrip())

    def reached(self, done: int, total: int) -> None:
        self.bars.update(self.bar, completed=done, total=total)

    def step(self, name: str, state: str, seconds: float, done: int, total: int) -> None:
        self.bars.state = f"{state}  {seconds:.2f} s"
        self.doing(f"{done}/{total} {name}")
        self.reached(done, total)


class _TimeLeft(TimeRemainingColumn):
    """Remaining time, or nothing before it is known."""

    @override
    def render(self, task: Task) -> Text:
        if not task.time_remaining:
            return Text("")
        return Text.assemble(super().render(task), " left,")


class _Bars(Progress):
    """Progress lines of a terminal, with a line about the state below them."""

    state = ""

    @override
    def get_renderables(self) -> Iterator[RenderableType]:
        yield from super().get_renderables()
        if self.state:
            yield Text(self.state)


# Outermost work whose progress is shown.
_outer: Work | None = None


@contextlib.contextmanager
def working(what: str, counted: bool = False, stays: bool = False) -> Iterator[Work]:
    """Show some work and its duration while the block lasts.

    Work inside other work only names the present part of it, because a terminal has one moving
    line.

    Args:
        what: name of the work.
        counted: whether the work reports its finished steps.
        stays: whether the line stays on a terminal after the work.

    Yields:
        Receiver whose methods the work may call to report its progress.
    """
    global _outer
    if _outer is not None:
        _outer.doing(what)
        yield Work()
        return
    work, console = Work(), Console(stderr=True)
    # A dumb terminal, such as a shell in an editor, cannot move a line.
    moves = console.is_terminal and not console.is_dumb_terminal
    with contextlib.ExitStack() as shown:
        if _shown is not False and not moves:
            heartbeat = Heartbeat(what, _printed_at, every=bool(_shown))
            work = shown.enter_context(heartbeat.beating())
        elif _shown is not False:
            columns: list[ProgressColumn] = [
                SpinnerColumn(finished_text=""),
                TextColumn("{task.description}", markup=False),
            ]
            if counted:
                columns += [BarColumn(bar_width=20), _TimeLeft()]
            # Text that the work prints goes above the line, unless standard output is a pipe.
            redirect = sys.stdout.isatty()
            bars = _Bars(
                *columns,
                TimeElapsedColumn(),
                console=console,
                redirect_stdout=redirect,
                transient=not stays,
            )
            work = _Line(shown.enter_context(bars), bars.add_task(what.lstrip(), total=None))
        _outer = work
        try:
            yield work
        finally:
            _outer = None


@contextlib.contextmanager
def progress(
    step: str, total: int, completed: int = 0, first: str = "compiling", last: str = ""
) -> Iterator[Callable[..., None]]:
    """Show the progress of work in steps.

    Args:
        step: name of several steps. The line shows the number of finished steps. It does not show
            the number of the current step, because generations have their own numbers, from 0.
        total: number of all steps.
        completed: number of steps done before.
        first: name of the work before the first step.
        last: name of the work after the last step.

    Yields:
        A function to call after every step, with a line about the state and the duration of the
        step, s. The default duration is the time since the previous step.
    """
    number, since = completed, time.perf_counter()
    start = f"{completed:4d}/{total} {step}  {first}"
    with working(start, counted=True, stays=True) as work:

        def show(state: str, seconds: float | None = None) -> None:
            nonlocal number, since
            number, before, since = number + 1, since, time.perf_counter()
            took = since - before if seconds is None else seconds
            work.step(step, state, took, number, total)
            if last and number == total:
                work.doing(last)

        yield show


# Time of the last printed line, s.
_printed_at = -math.inf


def say(line: str) -> None:
    """Print a line about work that continues, also if the stream is closed."""
    global _printed_at
    _printed_at = time.monotonic()
    with contextlib.suppress(OSError, ValueError):
        print(folded(line, sys.stderr), file=sys.stderr, flush=True)
