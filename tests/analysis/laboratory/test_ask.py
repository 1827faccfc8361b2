"""Questions to a small swimmer, each against a closed form or a conservation law."""

import copy
import re
from pathlib import Path

import numpy as np
import pytest
from swimmer import FORWARDS, SWIMMER, subject

from evo_cpg.analysis.laboratory.ask import ask
from evo_cpg.analysis.laboratory.bodies import config_of
from evo_cpg.analysis.laboratory.measures import flume_notes
from evo_cpg.analysis.laboratory.settings import LabError
from evo_cpg.io.build import build_experiment
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.schema.task import ReachLightConfig
from evo_cpg.physics.water.added_mass import AddedMass


@pytest.fixture(scope="module")
def ribbon(tmp_path_factory):
    return subject(tmp_path_factory.mktemp("ribbon"))


@pytest.mark.slow
def test_current_carries_a_still_body_along(ribbon):
    """Quadratic drag: w' = -k w^2 for the water's speed w past the body, so w = U/(1 + k U t)."""
    rows = ask(ribbon, {"u": [0.0], "current": [0.5], "tow": [0.0]}, seconds=0.1).rows
    answer = ask(ribbon, {"u": [0.0], "current": [0.5]})
    (moving,), (row,) = answer.recordings, answer.rows
    law = answer.simulations[0].world.law(AddedMass)
    carried = row["mass"] + float(np.asarray(law.carried)[3, 3].sum())
    k = rows[0]["straight_drag"] / 0.5**2 / carried
    expected = -(0.5 * moving.time - np.log1p(k * 0.5 * moving.time) / k)
    np.testing.assert_allclose(moving.position[:, 0, 0], expected, atol=0.02 * abs(expected[-1]))


def test_flume_note_is_the_interpolated_current():
    settings = [{"current": c, "u": u} for u in (0.5, 1.0) for c in (0.0, 0.2, 0.4)]
    speeds = 0.3, 0.1, -0.1, 0.5, 0.3, 0.1
    rows = [{"ground_speed": speed} for speed in speeds]
    assert flume_notes(settings, rows) == (
        "u=0.5: holds its place against a current of 0.3 m/s",
        "u=1: holds its place in none of these currents",
    )


@pytest.mark.slow
def test_swimmer_in_a_flume_holds_its_place_at_its_speed(ribbon):
    """Galileo: a current U from ahead is swimming with a start at speed U in still water."""
    rows = ask(ribbon, FORWARDS | {"current": [0.0, 0.1]}).rows
    still, against = (row["ground_speed"] for row in rows)
    assert still > 0.1
    # Neither has its steady speed after 4 s. Later the animal turns.
    assert still - against == pytest.approx(0.1, rel=0.1)


@pytest.mark.slow
def test_size_scales_speed_without_viscosity(ribbon):
    """Form drag ~ L^4 (speed ~ L), inertia ~ L^5: lengths per second do not depend on size."""
    rows = ask(ribbon, FORWARDS | {"size": [1.0, 2.0]}).rows
    assert rows[1]["length"] == pytest.approx(2 * rows[0]["length"])
    assert rows[1]["mass"] == pytest.approx(8 * rows[0]["mass"])
    assert rows[1]["path_speed"] == pytest.approx(2 * rows[0]["path_speed"], rel=1e-3)
    assert rows[1]["power"] == pytest.approx(32 * rows[0]["power"], rel=1e-3)


def test_light_stays_as_many_lengths_away_in_all_sizes(ribbon):
    lit = ribbon.config.model_copy(update={"task": ReachLightConfig()})
    distances = []
    for size in (1.0, 1e-3):
        config = config_of(lit, ribbon.source, {"size": size})
        (situation,) = build_experiment(config, ribbon.source).simulation.situations
        distances.append(np.linalg.norm(np.subtract(situation.light, situation.start_position)))
    assert distances[0] == pytest.approx(8.0) and distances[1] == pytest.approx(8e-3)


def test_factors_multiply_keys_of_the_same_question(ribbon):
    setting = {"world.gravity": 2.0, "gravity": 3.0, "world.water.current.0": 0.5, "current": 0.2}
    world = config_of(ribbon.config, ribbon.source, setting).world
    assert world.gravity == 6.0 and world.water is not None
    assert world.water.current[0] == pytest.approx(0.3)


@pytest.mark.slow
def test_key_of_the_configuration_is_a_knob(ribbon):
    key = "creature.materials.flesh.density"
    rows = ask(ribbon, {key: [1000.0, 1100.0], "u": [0.5]}, seconds=1.0).rows
    assert rows[0]["mass"] == pytest.approx(rows[1]["mass"] / 1.1)


@pytest.mark.slow
def test_passive_joints_have_no_torque(ribbon):
    answer = ask(ribbon, {"passive": ["none", "tail2+tail3"], "u": [0.5]}, seconds=2.0)
    active, passive = (np.abs(each.torque).max(0) for each in answer.recordings)
    assert (active > 1e-3).all()
    assert passive[0] > 1e-3 and (passive[1:] == 0).all()


@pytest.mark.slow
def test_undriven_oscillators_fall_silent(ribbon):
    answer = ask(ribbon, FORWARDS | {"undriven": ["none", "tail3"]})
    whole, without = (np.abs(each.cpg_output[-60:]).max(0) for each in answer.recordings)
    assert (whole > 0.1).all()
    assert (without[:2] > 0.1).all() and without[2] < 1e-6


@pytest.mark.slow
def test_stiff_joints_bend_less(ribbon):
    answer = ask(ribbon, {"stiffness": [0.0, 100.0], "u": [0.5]}, seconds=2.0)
    loose, stiff = (np.abs(each.joint_angle).max() for each in answer.recordings)
    assert stiff < 0.02 * loose


@pytest.mark.slow
def test_towed_stiff_body_has_its_drag_and_no_thrust(ribbon):
    """The drag of the laws grows with the square of the speed."""
    rows = ask(ribbon, FORWARDS | {"u": [0.0, 1.0], "tow": [0.1, 0.2]}).rows
    slow, fast, *moving = rows
    assert slow["holding_force"] == pytest.approx(slow["straight_drag"], rel=1e-2)
    assert fast["straight_drag"] == pytest.approx(4 * slow["straight_drag"], rel=1e-5)
    for row in moving:
        assert row["thrust"] > 0.01 and 0 < row["efficiency"] < 1


@pytest.mark.slow
def test_largest_drive_of_the_configuration_is_the_unit_of_the_drive(ribbon):
    """Outputs are proportional to the drive: u = 0.5 of 2 is u = 1 of 1."""
    once = ask(ribbon, {"u": [1.0], "feedback": [0.0]}, seconds=6.0).recordings[0]
    key = "controller.cpg.max_tonic_input"
    twice = ask(ribbon, {key: [2.0], "u": [0.5], "feedback": [0.0]}, seconds=6.0).recordings[0]
    largest = (np.abs(each.cpg_output[180:]).max(0) for each in (once, twice))
    np.testing.assert_allclose(*largest, rtol=0.05)


@pytest.mark.slow
def test_joints_without_a_change_are_those_of_the_animal(ribbon):
    plain = ask(ribbon, {"u": [0.5]}, seconds=0.5).rows
    same = ask(ribbon, {"u": [0.5], "passive": ["none"], "stiffness": [0.0]}, seconds=0.5).rows
    assert same[0]["path_speed"] == plain[0]["path_speed"]


@pytest.mark.parametrize(
    ("knobs", "message"),
    [
        ({"u": [float("nan")]}, "u=nan: tonic input .* Allowed: from 0 to 1"),
        ({"behind": [0.5]}, "behind: needs cut=BODY"),
        ({"silence": ["light"]}, "silence=light: no effect, because no brain drives"),
        ({"v": [1.0]}, "'v' is no knob: "),
        ({"b": [-1.0]}, "b=-1: adaptation gain .* Allowed: at least 0"),
        ({"u": ["high"]}, "u=high: expected a number"),
        ({"cut": ["tial1"]}, "cut=tial1: 'tial1' names no body with a joint .did you mean 'tail1'"),
        ({"silence": ["eyes"]}, "silence=eyes: .*light"),
        ({"viscosity": [10.0]}, "viscosity: the water has none. Set world.water.viscosity"),
        ({"u": []}, "u: no value is given"),
        ({"u": np.ones(200).tolist(), "b": np.ones(51).tolist()}, "10200 settings. Allowed: up to"),
    ],
)
def test_wrong_question_has_one_clear_line(ribbon, knobs, message):
    with pytest.raises(LabError, match=message) as raised:
        ask(ribbon, knobs)
    assert "\n" not in str(raised.value)


def test_animal_without_feedback_has_no_knob_of_it(tmp_path):
    unfeeling = copy.deepcopy(SWIMMER)
    del unfeeling["controller"]["cpg"]["feedback"]
    animal = subject(tmp_path, unfeeling)
    with pytest.raises(LabError, match=r"feedback: the spinal cord senses nothing. Set controller"):
        ask(animal, {"feedback": [2.0]})


@pytest.mark.parametrize(
    ("seconds", "word"),
    [(0.0, "seconds"), (float("nan"), "seconds"), (1e9, "seconds"), (1e5, "GB of memory")],
)
def test_wrong_duration_has_one_clear_line(ribbon, seconds, word):
    with pytest.raises(LabError, match=word):
        ask(ribbon, {"u": np.linspace(0.1, 1, 10).tolist()}, seconds)


def test_wrong_key_of_the_configuration_is_named(ribbon):
    with pytest.raises(ConfigError, match=r"world.water.densty: does not exist"):
        ask(ribbon, {"world.water.densty": [1.0]})


@pytest.mark.slow
def test_program_of_the_page_runs(capsys):
    page = (Path(__file__).parents[3] / "docs" / "lab.md").read_text()
    (program,) = re.findall(r"```python\n(.+?)```", page, re.S)
    exec(compile(program, "documented", "exec"), {})
    assert len(capsys.readouterr().out.splitlines()) == 2
