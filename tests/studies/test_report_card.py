"""Rules and measures of the report card, on numbers that were made up."""

import functools
import math
from types import SimpleNamespace

import numpy as np
import pytest

from evo_cpg.analysis.laboratory.ask import Answer
from evo_cpg.analysis.laboratory.settings import require_values
from evo_cpg.cli.ask import values_of
from evo_cpg.simulation.recording import Recording
from evo_cpg.studies import card_measures, card_rows
from evo_cpg.studies.animals import STUDY
from evo_cpg.studies.card import AnsweredRow, Question, Row, Rule, card_tables, rule
from evo_cpg.studies.workshop import Workshop

ROWS = [
    *card_rows.EFFICIENCY,
    *card_rows.SHAPE,
    *card_rows.VISCOSITY,
    *card_rows.SENSES,
    *card_rows.MUSCLES,
    *card_rows.WALKERS,
]


@pytest.mark.parametrize(
    ("own", "inside", "outside"),
    [
        (Rule(0.2, 0.4), [0.2, 0.4], [0.19, 0.41]),
        (rule("third", 0.45), [0.3001, 0.5999], [0.29, 0.61]),
        (rule("points", -44), [-54, -34], [-55, -33]),
        (rule("exponent", 1.02), [0.9201, 1.1199], [0.91, 1.13]),
        (rule("factor", 0.4), [0.2, 0.8], [0.19, 0.81]),
        (rule("above", 1.0), [1.001], [1.0, 0.9]),
        (rule("below", 5.0), [4.9], [5.0, 6.0]),
    ],
)
def test_a_rule_is_a_range_for_the_median(own, inside, outside):
    assert all(own.holds([value]) for value in inside)
    assert not any(own.holds([value]) for value in outside)
    # One value outside does not matter, and a value that does not exist does not count.
    assert own.holds([inside[0], inside[0], outside[0], math.nan])
    assert own.holds([math.nan]) is None


def test_a_card_has_a_table_for_each_command():
    one = Question("eel", {"u": (0.2, 0.4), "cut": ("none", "tail1")}, 5.0)
    row = Row("eel", "1", "nobody", rule("third", 1.0), one, lambda _: [], "seeds", "a tail")
    other = row._replace(name="worm", question=one._replace(seconds=6.0))
    verdicts = [
        AnsweredRow(row, [0.9, 1.1]),
        AnsweredRow(other, [2.0]),
        AnsweredRow(row, [math.nan]),
    ]
    first, second = card_tables(verdicts, {"eel": "eel"})
    assert first.title == "`evo-cpg lab eel u=0.2,0.4 cut=none,tail1 --seconds 5`"
    range_of_third = "0.667 to 1.33"
    assert first.rows[0] == [
        "eel", "1 (nobody)", range_of_third, "1.00 (0.90 to 1.10), seeds", "yes", "a tail"
    ]  # fmt: skip
    assert first.rows[1][4] == "not measured"
    assert second.rows[0][0] == "worm" and second.rows[0][4] == "no"


def test_commands_have_the_values_of_their_questions():
    for row in ROWS:
        words = row.question.command("eel").split()
        assert words[:3] == ["evo-cpg", "lab", "eel"] and words[-2] == "--seconds"
        values = values_of(words[3:-2])
        require_values(values, float(words[-1]))
        assert set(values) == set(row.question.knobs)
        for name, own in row.question.knobs.items():
            if isinstance(own[0], str):
                assert values[name] == list(own)
            else:
                np.testing.assert_allclose(values[name], own, rtol=1e-5)


def answer(rows: list[dict], recordings: tuple = (), tree: object = None) -> Answer:
    """Return an answer whose settings are the knobs of its rows: u, b and cut."""
    settings = [{k: row[k] for k in ("u", "b", "cut") if k in row} for row in rows]
    whole = recordings or tuple([None] * len(rows))
    simulation = SimpleNamespace(world=SimpleNamespace(tree=tree))
    return Answer(settings, rows, whole, (), tuple([simulation] * len(rows)))  # pyright: ignore


def test_exponents_and_prefactors_of_exact_power_laws_are_found():
    sw = np.geomspace(1e2, 1e7, 11)
    re = np.where(sw < 1e4, 0.03 * sw**1.31, 0.4 * sw**1.02)
    rows = [{"u": 1.0, "swimming_number": x, "reynolds": y} for x, y in zip(sw, re, strict=True)]
    both, given = ("reynolds", "swimming_number", ("u",)), [answer(rows)]
    m = card_measures
    assert m.slope(*both, given, **m.TURBULENT) == pytest.approx([1.02])
    assert m.prefactor(*both, 1.02, given, **m.TURBULENT) == pytest.approx([0.4])
    assert m.slope(*both, given, **m.LAMINAR) == pytest.approx([1.31])
    assert m.prefactor(*both, 1.31, given, **m.LAMINAR) == pytest.approx([0.03])
    assert math.isnan(m.slope(*both, [answer(rows[-3:])], **m.LAMINAR)[0])


def test_changes_compare_settings_that_differ_in_one_knob():
    rows = [
        {"u": u, "b": b, "speed": u * b, "best": -abs(u - 0.1 * b)}
        for u in (0.2, 0.4)
        for b in (2.0, 4.0)
    ]
    given = [answer(rows)]
    assert card_measures.change("speed", "b", 2.0, 4.0, given) == pytest.approx([100, 100])
    assert card_measures.ratio("speed", "u", 0.4, 0.2, given) == pytest.approx([0.5, 0.5])
    assert card_measures.at_best("u", given, "best", "b") == [0.2, 0.4]
    tenfold = functools.partial(card_measures.each, "speed", scale=10.0)
    assert card_measures.where(tenfold, given, u=0.4) == pytest.approx([8.0, 16.0])
    assert card_measures.size(lambda _: [-2.0], given) == [2.0]


def motion(lags: list[float]) -> Recording:
    """Return two oscillators at 1 Hz. The second lags by a number of cycles in each cycle."""
    time = np.arange(100 * len(lags)) / 100.0
    lag = np.repeat(lags, 100)
    output = np.stack([np.sin(2 * np.pi * time), np.sin(2 * np.pi * (time - lag))], 1)
    nothing = np.zeros((len(time), 1, 3))
    return Recording(time, nothing, nothing[..., None], output, output, output, output,
                     time, np.zeros(3), ("a.z", "b.z"))  # fmt: skip


def test_the_cycles_until_a_lag_returns_are_counted():
    rows = [{"u": 1.0, "cut": "none"}, {"u": 1.0, "cut": "b"}]
    back = motion([0.5, 0.5, 0.5, 0.3, *[0.2] * 16])
    never = motion([0.5] * 20)
    knobs = "b.z", {"cut": "none"}, {"cut": "b"}
    count = functools.partial(card_measures.cycles_to_return, *knobs)
    (found,) = count([answer(rows, (motion([0.2] * 20), back))])
    assert 2 <= found <= 4
    (found,) = count([answer(rows, (motion([0.2] * 20), never))])
    assert found >= 17
    (found,) = count([answer(rows, (back, back))])
    assert found == pytest.approx(3, abs=1)


def test_activity_that_outruns_bending_has_a_shorter_lag():
    """The joints of a body of 2 m have uneven distances."""
    apart = np.array([0.1, 0.3, 0.1, 0.2, 0.3, 0.2, 0.3])
    time, place = np.arange(2000) / 100.0, np.append(0.0, np.cumsum(apart)) / 2.0
    waves = [np.cos(2 * np.pi * (time[:, None] - k * place)) for k in (1.0, 0.5)]
    nothing = np.zeros((2000, 1, 3))
    one = Recording(time, nothing, nothing[..., None], waves[0], waves[1], waves[1], waves[1],
                    time, np.zeros(3), ("a.z",) * 8)  # fmt: skip
    offset = np.zeros((3, 9))
    offset[0, 1:] = -0.25, *-apart
    tree = SimpleNamespace(
        parents=tuple(range(-1, 8)), joint_offset=offset, dof_bodies=tuple(range(1, 9))
    )
    row = {"u": 1.0, "stride_frequency": 1.0, "length": 2.0}
    given = [answer([row], (one,), tree)]
    assert card_measures.outrunning(given) == pytest.approx([2.0], rel=1e-2)
    assert card_measures.activity_speed(given) == pytest.approx([2.0], rel=1e-2)
    # The lead grows by half of the distance between the middles of the outer thirds.
    grown = (place[-2:].mean() - place[:2].mean()) / 2
    assert card_measures.lead_grows(given) == pytest.approx([grown], rel=2e-2)
    assert card_measures.burst(0.0, given) == pytest.approx([47.0], abs=1.0)


def test_every_row_of_the_card_is_in_one_part_and_has_a_source():
    parts = [part.report.keywords["rows"] for part in STUDY.parts.values()]  # pyright: ignore
    assert sum(len(rows) for rows in parts) == len(ROWS)
    assert len({row.name for row in ROWS}) == len(ROWS)
    assert all(row.source for row in ROWS)


@pytest.mark.slow
def test_a_quick_card_of_a_cheap_question_has_numbers(tmp_path):
    shop = Workshop(STUDY, tmp_path, True, 1)
    shop.claim()
    page, picture = shop.make("nerves")
    assert picture.is_file()
    text = page.read_text()
    assert text.count("`evo-cpg lab eel ") == 4 and "| yes |" in text
