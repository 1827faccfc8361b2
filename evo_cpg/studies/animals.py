"""Study of real animals: a report card of figures of animals beside ours.

Evolution never sees the card. A row says so if the animal was tuned for its number.
"""

from collections.abc import Sequence
from functools import partial

from evo_cpg.api.lab import lab
from evo_cpg.studies import card_rows
from evo_cpg.studies.card import AnsweredRow, Row, card_tables
from evo_cpg.studies.study import Part, Runs, Study, Table
from evo_cpg.studies.workshop import Workshop

RUNS = {
    "trot": Runs("salamander_trot", ("evolution.generations=12",), 3),
    "tripod": Runs("hexapod_tripod", (), 3),
}

# Longest trial of a quick test, s.
_QUICK_SECONDS = 3.0


def card(workshop: Workshop, rows: Sequence[Row]) -> list[Table]:
    """Ask all questions of some rows, and return the card and its commands.

    A shipped animal answers, or all champions of runs.
    """
    from evo_cpg.view.answer_plots import Bar, card_figure

    answers, places = {}, {}
    for question in {id(row.question): row.question for row in rows}.values():
        animal, knobs, seconds = question
        seconds = min(seconds, _QUICK_SECONDS) if workshop.quick else seconds
        if animal in RUNS:
            folder = workshop.member(animal).folder.path
            found = [
                lab(folder, knobs, seconds, number=champion.run)
                for champion in workshop.champions(animal)
            ]
            places[animal] = f"reproduction/{workshop.study.name}/runs/{animal}"
        else:
            found, places[animal] = [lab(animal, knobs, seconds)], animal
        answers[id(question)] = found
    verdicts = [AnsweredRow(row, list(row.measure(answers[id(row.question)]))) for row in rows]
    bars = [
        Bar(row.name, *row.rule, values, bool(row.rule.holds(values))) for row, values in verdicts
    ]
    workshop.draw(card_figure(bars))
    return card_tables(verdicts, places)


STUDY = Study(
    "animals",
    "Figures of real animals beside ours",
    RUNS,
    {
        "swimming": Part("speed, efficiency and shape of swimmers", (),
                         partial(card, rows=card_rows.EFFICIENCY + card_rows.SHAPE)),
        "nerves": Part("viscous water, feedback, cuts and muscles", (),
                       partial(card, rows=card_rows.VISCOSITY + card_rows.SENSES
                               + card_rows.MUSCLES)),
        "land": Part("water and land, and walkers", ("trot", "tripod"),
                     partial(card, rows=card_rows.WALKERS)),
    },
)  # fmt: skip
