"""Questions to an animal without evolution."""

import itertools
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from evo_cpg.analysis.laboratory.ask import Answer, Subject, ask, shown_columns
from evo_cpg.analysis.laboratory.courses import held_out
from evo_cpg.analysis.laboratory.settings import KNOBS, LabError
from evo_cpg.api.progress import working
from evo_cpg.api.runs import open_champion
from evo_cpg.files import make_folder, write_table
from evo_cpg.io.courses import without_draws
from evo_cpg.io.load import load_config
from evo_cpg.io.run import Run, class_folders
from evo_cpg.io.shipped import find_config
from evo_cpg.io.trust import trusting
from evo_cpg.training import devices

TABLE = "lab.csv"
"""Name of the file with the rows of an answer."""

# Most panels of a picture, and most courses.
_MOST_PANELS, _MOST_COURSES = 6, 10_000


def lab(
    animal: Path | str,
    knobs: Mapping[str, Sequence[Any]],
    seconds: float | None = None,
    *,
    courses: int | None = None,
    number: int | None = None,
    trust: bool = False,
) -> Answer:
    """Simulate an animal under all combinations of settings, in one program.

    Args:
        animal: YAML file, name of a shipped configuration, or run folder with a champion.
        knobs: values of each knob (docs/lab.md), or of keys of the configuration.
        seconds: duration of each trial, s, of which the second half is measured. None is the
            duration in the configuration.
        courses: number of held-out courses, of which the rows have the means, or None for one trial
            without noise. Without knobs, each sense is silenced, and the cord is cut in the middle.
        number: number of one of several runs in the folder, or None for the best.
        trust: whether you trust the configuration, see `evo_cpg.load`.

    Raises:
        LabError: a knob or a value does not fit the animal.
        ConfigError: the configuration is wrong.
        UsageError: there is no such run, or it has no champion.
    """
    count = int(np.prod([len(each) for each in knobs.values()]))
    with trusting(trust):
        source = find_config(animal, folders=True)
        if source.is_dir():
            opened = open_champion(source, number, cores=devices.available_cores())
            opened.require_configured()
            if courses is not None:
                return _on_courses(opened.own, knobs, courses, seconds)
            opened = opened.on_course()
            own, genes = class_folders(opened.folder), opened.champion.genes
            subject = Subject(opened.config, opened.folder.config, own, genes)
        elif courses is not None:
            raise LabError(f"courses: {source} has no champion. Ask a run folder")
        elif number is None:
            devices.use_cores()
            subject = Subject(without_draws(load_config(source)), source)
        else:
            raise LabError(f"run {number}: {source} is a configuration, not a run folder")
        with working(f"compiling, and simulating {count} setting{'s' if count > 1 else ''}"):
            return ask(subject, knobs, seconds)


def _on_courses(
    opened: Run, knobs: Mapping[str, Sequence[Any]], courses: int, seconds: float | None
) -> Answer:
    if seconds is not None:
        raise LabError("seconds: courses have the duration of the configuration. Leave it out")
    if not 1 <= courses <= _MOST_COURSES:
        raise LabError(f"courses: {courses}. Allowed: 1 to {_MOST_COURSES}")
    kind = opened.config.controller.type
    with working(f"compiling, and simulating {courses} courses"):
        found = held_out(opened.experiment, kind, opened.champion, knobs, courses)
    return Answer(*found)


def varied_knobs(answer: Answer) -> list[str]:
    """Return the knobs that differ between the settings of an answer."""
    settings = answer.settings
    return [knob for knob in settings[0] if len({str(each[knob]) for each in settings}) > 1]


def save_answer(answer: Answer, name: str, folder: Path | None = None) -> list[Path]:
    """Write ``lab.csv``, ``columns.csv`` and ``lab.png``, and return paths of table and picture.

    Args:
        answer: the answer.
        name: name of the animal.
        folder: folder of the files, or None for the first of ``lab/NAME``, ``lab/NAME_2`` and so on
            that has no answer.

    Raises:
        OutputError: the files cannot be written.
    """
    from evo_cpg.view.answer_plots import MeasurePanel, cell, lab_figure
    from evo_cpg.view.figure import save_figure

    rows, varied, columns = answer.rows, varied_knobs(answer), shown_columns(answer.rows)
    if folder is None:
        names = itertools.chain([name], (f"{name}_{i}" for i in itertools.count(2)))
        places = (Path("lab") / own for own in names)
        folder = next(place for place in places if not os.path.exists(place / TABLE))
    table = make_folder(folder) / TABLE
    write_table(table, rows)
    meanings = [{"column": name, **each._asdict()} for name, each in answer.meanings.items()]
    if meanings:
        write_table(folder / "columns.csv", meanings)
    drawn = [one for one in columns if len({cell(row[one.key]) for row in rows}) > 1] or columns
    panels = [
        MeasurePanel(one.label, [row[one.key] for row in rows], one.decades, one.cycle)
        for one in drawn[:_MOST_PANELS]
    ]
    if not panels:
        return [table]
    fixed = ", ".join(f"{k}={cell(v)}" for k, v in answer.settings[0].items() if k not in varied)
    units = {knob: KNOBS[knob].unit for knob in varied if knob in KNOBS}
    labels = [f"{knob} ({units[knob]})" if units.get(knob) else knob for knob in varied]
    settings = [[each[knob] for knob in varied] for each in answer.settings]
    figure = lab_figure(labels, settings, panels, f"{name}: {fixed}" if fixed else name)
    return [table, save_figure(figure, table.with_suffix(".png"))]
