"""Progress lines: their texts and times, with a clock that the test sets."""

import io
import itertools
import re
import sys
import threading
import time
from typing import Any

import numpy as np
import pytest
from rich.console import Console

import evo_cpg as evo
from evo_cpg.api import fitness
from evo_cpg.api import progress as module
from evo_cpg.api.progress import BETWEEN, FIRST, LONGEST_SILENCE, Heartbeat
from tiny_run import CONFIG, PAIR


@pytest.fixture(autouse=True)
def every_line():
    """Print all lines, as the commands do."""
    with module.all_lines():
        yield


@pytest.fixture
def impatient(monkeypatch):
    """Print lines soon."""
    monkeypatch.setattr(module, "_LOOK", 0.001)
    monkeypatch.setattr(module, "FIRST", 0.25)


class Timed(Heartbeat):
    """Heartbeat with a clock that the test sets."""

    def __init__(self, what: str, now: float = 0.0, **given: Any):
        self.now = now
        super().__init__(what, clock=lambda: self.now, **given)

    def due_at(self, now: float) -> str | None:
        self.now = now
        return self.due()


def lines_of(heartbeat: Timed, seconds: float, step: float = 0.25) -> list[tuple[float, str]]:
    """Return the times and texts of all lines, if the heartbeat is checked every ``step``."""
    instants = [tick * step for tick in range(int(seconds / step) + 1)]
    lines = [(instant, heartbeat.due_at(instant)) for instant in instants]
    return [(instant, line) for instant, line in lines if line is not None]


def test_long_work_prints_a_line_within_the_longest_silence():
    """The difference of the two limits allows for a late thread."""
    lines = lines_of(Timed("compiling"), 100.0)
    instants = [0.0, *(instant for instant, _ in lines), 100.0]
    assert max(b - a for a, b in itertools.pairwise(instants)) <= BETWEEN + 0.25
    assert BETWEEN + 0.25 < LONGEST_SILENCE
    assert len(lines) <= 1 + 100 / BETWEEN
    assert lines[0][1] == "compiling: 5 s so far"
    assert lines[1][1] == "compiling: 13 s so far"


def test_silence_is_counted_from_the_last_line():
    """The start of this work does not count if an earlier line was printed."""
    assert Timed("b", 7.0, printed=1.0).due_at(1.0 + BETWEEN) == f"b: {BETWEEN - 6:.0f} s so far"
    assert Timed("b", 7.0, printed=6.0).due_at(7.0 + FIRST - 0.1) is None


def test_a_line_has_the_progress_and_the_remaining_time():
    heartbeat = Timed("rendering")
    heartbeat.reached(50, 200)
    assert heartbeat.due_at(20.0) == "rendering: 50/200, 20 s, about 60 s to go"
    heartbeat.reached(1, 200)
    assert heartbeat.due_at(40.0) == "rendering: 1/200, 40 s"
    heartbeat.reached(200, 200)
    assert heartbeat.due_at(60.0) == "rendering: 200/200, 60 s"
    heartbeat.now = 65.0
    heartbeat.doing("writing")
    assert heartbeat.due_at(80.0) == "writing: 15 s so far"


def test_other_lines_end_the_silence():
    """The silence of a generation starts at the report of the earlier generation."""
    heartbeat = Timed("generation 1")
    heartbeat.now = 4.9
    heartbeat.say("generation 1")
    heartbeat.now = 4.9
    heartbeat.doing("generation 2")
    assert heartbeat.due_at(4.9 + BETWEEN - 0.01) is None
    assert heartbeat.due_at(4.9 + BETWEEN) == f"generation 2: {BETWEEN:.0f} s so far"


def test_the_thread_prints_due_lines_and_ends_with_the_work(impatient):
    """The clock runs a hundred times as fast."""
    start, lines = time.monotonic(), []

    def clock() -> float:
        return 100 * (time.monotonic() - start)

    printed = threading.Event()

    def write(line: str) -> None:
        lines.append(line)
        printed.set()

    with Heartbeat("compiling", clock=clock).beating(write):
        assert printed.wait(10)
    assert lines[0].startswith("compiling: ")
    count = len(lines)
    time.sleep(0.2)
    assert len(lines) == count
    assert "heartbeat" not in {thread.name for thread in threading.enumerate()}


def test_the_thread_ends_if_the_work_fails():
    with pytest.raises(ValueError, match="no"), Heartbeat("x").beating(print):
        raise ValueError("no")
    assert "heartbeat" not in {thread.name for thread in threading.enumerate()}


def test_steps_in_a_pipe_print_lines(impatient, capsys):
    with module.progress("generations", 3, 1, "compiling") as show:
        time.sleep(0.8)
        show("best 2", 0.5)
    _, err = capsys.readouterr()
    assert err == (
        "   1/3 generations  compiling: 0 s so far\n   2/3 generations  best 2    0.50 s\n"
    )


def test_a_terminal_shows_bar_count_and_time_left_in_80_columns(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    screen = io.StringIO()
    monkeypatch.setattr(
        module, "Console", lambda **_: Console(file=screen, force_terminal=True, width=80)
    )
    state = "best  -0.5509  mean  -0.9822  diverged   0    2179 k steps/s"
    with module.working("probing [red] lights", counted=True) as work:
        time.sleep(0.3)
        work.doing("drawing")
        time.sleep(0.3)
    assert "[red]" in screen.getvalue() and "drawing" in screen.getvalue()
    with module.progress("generations", 500, 300) as show:
        for _ in range(3):
            time.sleep(0.2)
            show(state, 0.5)
    shown = re.sub(r"\x1b\[[\d;?]*[a-zA-Z]", "", screen.getvalue())
    assert "302/500 generations" in shown and "\N{BOX DRAWINGS HEAVY HORIZONTAL}" in shown
    assert " left," in shown and state in shown
    assert "compiling" in shown and "\N{HORIZONTAL ELLIPSIS}" not in shown


def test_a_dumb_terminal_gets_lines(impatient, monkeypatch, capsys):
    """Such a terminal cannot move a line, so it would stay silent."""
    monkeypatch.setenv("TERM", "dumb")
    monkeypatch.setattr(module, "Console", lambda **_: Console(stderr=True, force_terminal=True))
    with module.working("rendering"):
        time.sleep(0.8)
    assert capsys.readouterr().err.startswith("rendering: 0 s")


def test_the_intervals_of_a_script_double():
    lines = lines_of(Timed("compiling", every=False), 100.0)
    assert [instant for instant, _ in lines] == [5, 10, 20, 40, 80]


def test_steps_of_a_script_print_no_line_of_their_own(capsys):
    """The next line names the latest step."""
    quiet = Timed("compiling", every=False)
    quiet.step("generations", "best 2", 0.5, 1, 3)
    assert capsys.readouterr().err == ""
    assert quiet.due_at(5.0) == "   1/3 generations  best 2, and the next one: 5 s so far"


def test_progress_can_be_switched_off(impatient, capsys):
    evo.show_progress(False)
    with module.working("rendering") as work:
        work.say("a line")
        time.sleep(0.8)
    assert capsys.readouterr() == ("", "")


def test_inner_work_only_names_a_part(impatient, capsys):
    """A terminal has one moving line."""
    with module.working("training"), module.working("evaluating"):
        time.sleep(0.8)
    assert capsys.readouterr().err.startswith("evaluating: 0 s")


def test_a_closed_stream_is_ignored(impatient, monkeypatch):
    closed = io.StringIO()
    monkeypatch.setattr(sys, "stderr", closed)
    closed.close()
    with module.working("rendering"):
        time.sleep(0.8)


def test_a_derivative_is_named_while_it_compiles(impatient, monkeypatch, capsys):
    """The line comes while the fitness is traced, before JAX compiles its derivative."""
    experiment = evo.load(CONFIG, [*PAIR, "task={type: distance}", "creature.light_sensors=[]"])
    monkeypatch.setattr(fitness, "rollout", lambda *given, **options: time.sleep(0.8))
    monkeypatch.setattr(fitness, "mean_of_trials", lambda given: np.zeros(1))
    experiment.fitness_function()(np.zeros(experiment.gene_count))
    assert "compiling the fitness of" in capsys.readouterr().err
