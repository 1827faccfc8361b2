"""What the library says of work that takes long, and when it says nothing."""

import io
import sys

import numpy as np
import pytest

import evo_cpg as evo
from evo_cpg.api import progress


class Terminal(io.StringIO):
    """A stream that is a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def streams(monkeypatch):
    """Let standard error be another one, and no line wait for long."""
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


def test_a_terminal_is_told_what_takes_long(streams):
    said = streams(Terminal())
    take_long()
    first, last = said.getvalue().splitlines()
    assert first == "evo_cpg: compiling ..."
    assert last.startswith("evo_cpg: compiling: 0.") and last.endswith(" s")


def test_what_is_soon_done_is_not_told(streams):
    said = streams(Terminal())
    with progress.working("compiling"):
        pass
    assert said.getvalue() == ""


@pytest.mark.parametrize(("stream", "on"), [(io.StringIO(), None), (Terminal(), False)])
def test_nobody_is_told_who_did_not_ask(streams, stream, on):
    said = streams(stream)
    evo.show_progress(on)
    take_long()
    assert said.getvalue() == ""


def test_a_pipe_and_a_notebook_are_told_if_they_ask(streams, monkeypatch):
    said = streams(io.StringIO())
    evo.show_progress(True)
    take_long()
    assert said.getvalue().startswith("evo_cpg: compiling ...")
    evo.show_progress(None)
    monkeypatch.setitem(sys.modules, "ipykernel", sys)
    said = streams(io.StringIO())
    take_long()
    assert said.getvalue().startswith("evo_cpg: compiling ...")


def test_a_failure_and_a_closed_stream_stay_what_they_are(streams):
    said = streams(Terminal())
    with pytest.raises(KeyError), progress.working("compiling"):
        progress.threading.Event().wait(0.1)
        raise KeyError
    assert len(said.getvalue().splitlines()) == 2
    said.close()
    take_long()


def test_a_search_says_how_far_it_is_every_ten_seconds(streams, monkeypatch):
    said = streams(Terminal())
    clock = iter(np.arange(0.0, 100.0, 4.0))
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(clock))
    generations = progress.Generations(20)
    for best in (0.1, 0.2, 0.3, 0.4):
        generations.add(best)
    (line,) = said.getvalue().splitlines()
    assert line == "evo_cpg: 3 of 20 generations, best fitness 0.3"
