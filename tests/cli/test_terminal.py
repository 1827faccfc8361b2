"""Tables and long lines on a terminal."""

import io

import pytest

from evo_cpg.cli.terminal import show_table
from evo_cpg.system import folded


@pytest.mark.parametrize("width", [60, 80])
def test_a_table_breaks_no_name_if_there_is_room(monkeypatch, capsys, width):
    monkeypatch.setenv("COLUMNS", str(width))
    name = "iwadate2010_salamander_water"
    show_table(("name", "study", "description"), [(name, "Iwadate 2010", "word " * 30)], left=3)
    lines = capsys.readouterr().out.splitlines()
    assert any(f" {name} " in line for line in lines) and max(map(len, lines)) <= width
    assert sum(line.count("word") for line in lines) == 30


class Terminal(io.StringIO):
    """A stream that claims to be a terminal."""

    def isatty(self) -> bool:
        return True


def test_a_terminal_breaks_lines_between_words(monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    words = "first line\nat half the step it keeps 100 %. See `evo-cpg audit runs/mine`"
    assert folded(words, Terminal()).splitlines() == [
        "first line",
        "at half the step it keeps 100 %. See",
        "`evo-cpg audit runs/mine`",
    ]
    assert folded(words, io.StringIO()) == words
