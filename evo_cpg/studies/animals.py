"""Study of real animals: a report card of figures of animals beside ours.

Evolution never sees the card. A row says so if the animal was tuned for its number.
"""

from collections.abc import Sequence
from functools import partial

from evo_cpg.analysis.laboratory.ask import Answer
from evo_cpg.api.lab import lab
from evo_cpg.studies import card_rows
from evo_cpg.studies.card import Absent, AnsweredRow, Question, Row, absent_table, card_tables
from evo_cpg.studies.study import Part, Runs, Study, Table
from evo_cpg.studies.workshop import Workshop

RUNS = {
    "trot": Runs("salamander_trot", ("evolution.generations=12",), 3),
    "tripod": Runs("hexapod_tripod", (), 3),
}

# Longest trial of a quick test, s.
_QUICK_SECONDS = 3.0


def card(workshop: Workshop, rows: Sequence[Row]) -> list[Table]:
    """Ask all questions of some rows, and return the card and its commands."""
    from evo_cpg.view.answer_plots import Bar, card_figure

    questions = list({id(row.question): row.question for row in rows}.values())
    answers = {id(question): _ask(workshop, question) for question in questions}
    verdicts = [AnsweredRow(row, list(row.measure(answers[id(row.question)]))) for row in rows]
    bars = [
        Bar(row.name, *row.rule, values, bool(row.rule.holds(values))) for row, values in verdicts
    ]
    workshop.draw(card_figure(bars))
    places = {question.animal: _place(workshop, question.animal) for question in questions}
    return card_tables(verdicts, places)


def absent(workshop: Workshop, rows: Sequence[Absent]) -> list[Table]:
    """Return the figures that no simulation of ours answers."""
    return [absent_table(rows)]


def _ask(workshop: Workshop, question: Question) -> list[Answer]:
    """Return the answers to a question: of a shipped animal, or of all champions of runs."""
    seconds = min(question.seconds, _QUICK_SECONDS) if workshop.quick else question.seconds
    if question.animal not in RUNS:
        return [lab(question.animal, question.knobs, seconds)]
    folder = workshop.member(question.animal).folder.path
    return [
        lab(folder, question.knobs, seconds, number=champion.run)
        for champion in workshop.champions(question.animal)
    ]


def _place(workshop: Workshop, animal: str) -> str:
    """Return a configuration or run folder as `evo-cpg lab` takes it."""
    if animal not in RUNS:
        return animal
    return f"reproduction/{workshop.study.name}/runs/{animal}"


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
        "absent": Part("figures without an answer", (),
                       partial(absent, rows=card_rows.ABSENT)),
    },
)  # fmt: skip
