"""Tables, files and pictures of the command `lab`."""

import itertools
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from evo_cpg.analysis.laboratory.ask import Answer, ask
from evo_cpg.analysis.laboratory.columns import shown_columns
from evo_cpg.analysis.laboratory.settings import KNOBS
from evo_cpg.api.display import working
from evo_cpg.api.lab import subject_of
from evo_cpg.cli.errors import UsageError, require_free, warn
from evo_cpg.cli.tables import show_table, show_words
from evo_cpg.files import make_folder, write_table
from evo_cpg.system import named
from evo_cpg.view.answer_plots import MeasurePanel, cell, lab_figure
from evo_cpg.view.figure import save_figure

# Most rows of a table on the terminal, and most panels of a picture.
_MOST_ROWS, _MOST_PANELS = 60, 6
# Width of a table, characters.
_WIDTH = 80
_TABLE = "lab.csv"


def ask_animal(
    animal: Path,
    words: Sequence[str],
    seconds: float | None,
    number: int | None,
    out: Path | None,
    overwrite: bool,
) -> None:
    """Ask an animal a question, and print, write and draw the answer.

    Args:
        animal: run folder, or file of a configuration.
        words: knobs with their values, such as ``u=0.2,0.6``.
        seconds: duration of each trial, s, or None for the configuration's duration.
        number: number of one of several runs, or None for the best.
        out: folder for the files, or None for the first free default.
        overwrite: whether files in ``out`` are replaced.

    Raises:
        UsageError: a knob or a value is wrong, or the folder has an answer.
    """
    values = values_of(words)
    if out is not None:
        require_free(out / _TABLE, overwrite)
        if os.path.exists(out) and not out.is_dir():
            raise UsageError(f"{out} is a file. --out is a folder")
    subject = subject_of(animal, number)
    count = int(np.prod([len(each) for each in values.values()]))
    with working(f"compiling, and simulating {count} setting{'s' if count > 1 else ''}"):
        answer = ask(subject, values, seconds)
    place = make_folder(out or _free_folder(subject.config.name))
    show_answer(subject.config.name, answer, place)


def _free_folder(name: str) -> Path:
    """Return the first of ``lab/NAME``, ``lab/NAME_2`` and so on that has no answer."""
    folders = itertools.chain([name], (f"{name}_{i}" for i in itertools.count(2)))
    places = (named("lab") / named(folder) for folder in folders)
    return next(place for place in places if not os.path.exists(place / _TABLE))


def values_of(words: Sequence[str]) -> dict[str, list[Any]]:
    """Return the values of knobs such as ``u=0.2,0.6``, ``u=0.2:1:9`` and ``cut=none,tail1``.

    Raises:
        UsageError: a word has another form, or a knob is given twice.
    """
    found: dict[str, list[Any]] = {}
    for word in words:
        name, equals, text = word.partition("=")
        if not (name and equals and text):
            raise UsageError(f"lab: {word!r} is not KNOB=VALUES, such as u=0.2,0.6 or u=0.2:1:9")
        if name in found:
            raise UsageError(f"lab: {name} is given twice")
        found[name] = _values(word, text)
    return found


def _values(word: str, text: str) -> list[Any]:
    if ":" in text:
        parts = text.split(":")
        space = np.geomspace if parts[3:] == ["log"] else np.linspace
        try:
            start, stop, count = float(parts[0]), float(parts[1]), int(parts[2])
            if parts[3:] not in ([], ["log"]) or not 1 <= count <= 10_000:
                raise ValueError
            found = space(start, stop, count)
        except (ValueError, IndexError):
            found = np.array([np.nan])
        if not np.isfinite(found).all():
            raise UsageError(
                f"lab: {word}: expected START:STOP:COUNT, such as 0.2:1:9, or START:STOP:COUNT:log "
                "for equal ratios"
            )
        return [float(value) for value in found]
    return [_value(each) for each in text.split(",")]


def _value(text: str) -> Any:
    try:
        return float(text)
    except ValueError:
        return text


def show_answer(name: str, answer: Answer, place: Path) -> None:
    """Print the table of an answer, and write ``lab.csv``, ``columns.csv`` and ``lab.png``."""
    rows = answer.rows
    varied = [
        knob
        for knob in answer.settings[0]
        if len({str(each[knob]) for each in answer.settings}) > 1
    ]
    columns = shown_columns(rows)
    heads = [*short_heads(varied), *(one.head for one in columns)]
    keys = [*varied, *(one.key for one in columns)]
    cells = [[cell(row[key]) for key in keys] for row in rows[:_MOST_ROWS]]
    widths = np.max([[len(text) + 3 for text in line] for line in (heads, *cells)], axis=0)
    fit = max(int((np.cumsum(widths) <= _WIDTH + 1).sum()), len(varied) + 1)
    show_table(heads[:fit], [line[:fit] for line in cells], left=0)
    if len(rows) > _MOST_ROWS:
        print(f"and {len(rows) - _MOST_ROWS} more settings in the file")
    for note in answer.notes[:_MOST_ROWS]:
        show_words(note)
    table = place / _TABLE
    write_table(table, rows)
    meanings = [{"column": name, **each._asdict()} for name, each in answer.meanings.items()]
    if meanings:
        write_table(place / "columns.csv", meanings)
    drawn = [one for one in columns if len({cell(row[one.key]) for row in rows}) > 1] or columns
    panels = [
        MeasurePanel(one.label, [row[one.key] for row in rows], one.decades, one.cycle)
        for one in drawn[:_MOST_PANELS]
    ]
    fixed = ", ".join(f"{k}={cell(v)}" for k, v in answer.settings[0].items() if k not in varied)
    title = f"{name}: {fixed}" if fixed else name
    units = {knob: KNOBS[knob].unit for knob in varied if knob in KNOBS}
    labels = [f"{knob} ({units[knob]})" if units.get(knob) else knob for knob in varied]
    settings = [[each[knob] for knob in varied] for each in answer.settings]
    print(table)
    if panels:
        print(save_figure(lab_figure(labels, settings, panels, title), table.with_suffix(".png")))
    lost = sum(not np.isfinite(each.position).all() for each in answer.recordings)
    if lost:
        warn(f"{lost} of {len(rows)} settings diverged. Their rows have no numbers")


def short_heads(keys: Sequence[str]) -> list[str]:
    """Return the last parts of keys of a configuration, enough of them to tell the keys apart."""
    ends = [[".".join(key.split(".")[i:]) for i in range(key.count("."), -1, -1)] for key in keys]
    return [
        next(
            (end for end in own if not end[0].isdigit() and sum(end in each for each in ends) == 1),
            own[-1],
        )
        for own in ends
    ]
