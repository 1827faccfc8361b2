"""Progress lines of the library, and cases without any."""

import io
import sys

import numpy as np
import pytest

import evo_cpg as evo
from evo_cpg.api import fitness, progress
from tiny_run import CONFIG, PAIR


class Terminal(io.StringIO):
    """Stream that is a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def streams(monkeypatch):
    """Replace standard error, and shorten the time before a line."""
    monkeypatch.setattr(progress, "_SOON", 0.02)
    monkeypatch.delitem(sys.modules, "ipykernel", raising=False)

    def use(stream: io.StringIO) -> io.StringIO:
        monkeypatch.setattr(sys, "stderr", stream)
        return stream

    yield use
    evo.show_progress(None)


def take_long():
    with progress.working("compiling"):
        progress.threading.Event().wait(0.2)


def test_a_terminal_shows_long_work(streams):
    said = streams(Terminal())
    take_long()
    first, last = said.getvalue().splitlines()
    assert first == "evo_cpg: compiling ..."
    assert last.startswith("evo_cpg: compiling: 0.") and last.endswith(" s")


def test_short_work_prints_nothing(streams):
    said = streams(Terminal())
    with progress.working("compiling"):
        pass
    assert said.getvalue() == ""


@pytest.mark.parametrize(
    ("stream", "on", "lines"),
    [(io.StringIO(), None, ["evo_cpg: compiling ..."]), (Terminal(), False, [])],
)
def test_a_pipe_gets_one_line_and_progress_can_be_switched_off(streams, capsys, stream, on, lines):
    said = streams(stream)
    evo.show_progress(on)
    take_long()
    assert said.getvalue().splitlines() == lines and capsys.readouterr().out == ""


def test_a_derivative_is_named_while_it_compiles(streams, monkeypatch):
    """The line comes while the fitness is traced, before JAX compiles its derivative."""
    experiment = evo.load(CONFIG, [*PAIR, "task={type: distance}", "creature.light_sensors=[]"])
    said, wait = streams(io.StringIO()), progress.threading.Event().wait
    monkeypatch.setattr(fitness, "rollout", lambda *given, **options: wait(0.2))
    monkeypatch.setattr(fitness, "judge", lambda *given: np.zeros(1))
    experiment.fitness_function()(np.zeros(experiment.gene_count))
    (line,) = said.getvalue().splitlines()
    assert line.startswith(f"evo_cpg: compiling the fitness of {experiment.name!r}, and its deriv")


def test_requested_progress_and_notebooks_print_lines(streams, monkeypatch):
    said = streams(io.StringIO())
    evo.show_progress(True)
    take_long()
    assert said.getvalue().startswith("evo_cpg: compiling ...")
    evo.show_progress(None)
    monkeypatch.setitem(sys.modules, "ipykernel", sys)
    said = streams(io.StringIO())
    take_long()
    assert said.getvalue().startswith("evo_cpg: compiling ...")


def test_a_failure_passes_through_and_a_closed_stream_is_ignored(streams):
    said = streams(Terminal())
    with pytest.raises(KeyError), progress.working("compiling"):
        progress.threading.Event().wait(0.1)
        raise KeyError
    assert len(said.getvalue().splitlines()) == 2
    said.close()
    take_long()


def test_a_search_prints_progress_every_ten_seconds(streams, monkeypatch):
    said = streams(Terminal())
    clock = iter(np.arange(0.0, 100.0, 4.0))
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(clock))
    generations = progress.Generations(20)
    for best in (0.1, 0.2, 0.3, 0.4):
        generations.add(best)
    (line,) = said.getvalue().splitlines()
    assert line == "evo_cpg: 3 of 20 generations, best fitness 0.3"
