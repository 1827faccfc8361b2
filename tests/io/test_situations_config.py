"""Situations of trials and positions of lights: building from YAML, and errors."""

import numpy as np
import pytest
import yaml

from evo_cpg.io.build import build_experiment
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.load import check_config, dump_config, load_config
from evo_cpg.simulation.situation import Situation
from tiny_run import CONFIG, REPOSITORY

HEXAPOD = REPOSITORY / "configs" / "hexapod.yaml"
TASK = """
from evo_cpg.simulation.tasks import Distance

class Lit(Distance):
    light: tuple[float, float, float] = (1.0, 2.0, 3.0)
"""


def built(*overrides: str, path=CONFIG):
    return build_experiment(load_config(path, overrides), path)


def situations(trials: str, *overrides: str, path=CONFIG) -> tuple[Situation, ...]:
    return built(f"simulation.trials={trials}", *overrides, path=path).simulation.situations


def lights(trials: str, *overrides: str):
    return [situation.light for situation in situations(trials, *overrides)]


def test_a_number_of_trials_is_one_situation():
    light = "task.light={distance: 3, bearing_deg: 0}"
    start = "simulation.start=[1, 2]", "simulation.start_heading_deg=90"
    simulation = built("simulation.trials=1", *start, light).simulation
    (situation,) = simulation.situations
    assert situation.start_position == (1.0, 2.0, 0.0)
    assert situation.start_heading == pytest.approx(np.pi / 2)
    assert simulation.task.light == pytest.approx((1.0, 5.0, 0.0))
    experiment = built("simulation.trials=5", "noise.push=0.1")
    assert (len(experiment.simulation.situations), experiment.trials) == (1, 5)
    assert experiment.simulation.lights == (experiment.simulation.task.light,)


def test_an_entry_changes_only_its_keys():
    """Start, heading and each key of the light can change alone."""
    some = (
        "[{light: {bearing_deg: -60}}, {light: {bearing_deg: 90, distance: 5}}, {},"
        " {start: [3, 0], start_heading_deg: 180, light: {bearing_deg: 0}}, {start: [0, 1]}]"
    )
    light = "task.light={distance: 4, bearing_deg: 90}"
    made = built(f"simulation.trials={some}", "simulation.start=[1, 0]", light).simulation
    goals = [(3, -2 * np.sqrt(3), 0), (1, 5, 0), (1, 4, 0), (-1, 0, 0), (0, 5, 0)]
    np.testing.assert_allclose([made.lights[i] for i in range(5)], goals, atol=1e-12)
    assert made.task.light == made.lights[0]
    starts = [situation.start_position[:2] for situation in made.situations]
    assert starts == [(1, 0), (1, 0), (1, 0), (3, 0), (0, 1)]
    turns = [situation.start_heading for situation in made.situations]
    np.testing.assert_allclose(turns, [0, 0, 0, np.pi, 0])


def test_every_situation_is_a_trial_with_and_without_noise():
    for noise in ((), ("noise.push=0.1",)):
        assert built("simulation.trials=[{}, {start: [1, 1]}]", *noise).trials == 2


def test_a_light_may_have_a_position_in_the_world():
    """It does not depend on the start. The other keys then start from their defaults."""
    trials = "[{}, {start: [5, 5], start_heading_deg: 70}, {light: {bearing_deg: 0}}]"
    found = lights(trials, "task.light={at: [1, 2, 3]}")
    assert found[:2] == [(1, 2, 3), (1, 2, 3)]
    assert found[2] == pytest.approx((8, 0, 0))
    assert lights("[{light: {at: [1, 2, 3]}}]", "task.light.distance=4") == [(1, 2, 3)]
    assert lights("[{light: {}}]", "task.light.at=null", "task.light.bearing_deg=0") == [(8, 0, 0)]


def test_situations_are_read_back_unchanged(tmp_path):
    trials = "[{light: {bearing_deg: -60}}, {start: [3, 0], light: {at: [1, 2, 3]}}, {}]"
    config = load_config(CONFIG, [f"simulation.trials={trials}"])
    copy = tmp_path / "copy.yaml"
    copy.write_text(dump_config(config))
    assert load_config(copy) == config
    assert yaml.safe_load(copy.read_text())["simulation"]["trials"] == [
        {"light": {"bearing_deg": -60.0}},
        {"start": [3.0, 0.0], "light": {"at": [1.0, 2.0, 3.0]}},
        {},
    ]
    again = build_experiment(load_config(copy), copy).simulation.situations
    assert again == situations(trials)


def test_an_override_can_change_one_situation():
    config = load_config(CONFIG, ["simulation.trials=[{}, {}]", "simulation.trials.1.start=[2, 3]"])
    trials = config.simulation.trials
    assert isinstance(trials, list)
    assert [entry.start for entry in trials] == [None, (2.0, 3.0)]


def test_own_task_keeps_its_light_unless_an_entry_moves_it(tmp_path, monkeypatch):
    (tmp_path / "lit_task.py").write_text(TASK)
    monkeypatch.syspath_prepend(str(tmp_path))
    data = load_config(CONFIG).model_dump()
    data["task"] = {"type": "lit_task:Lit"}
    data["simulation"]["trials"] = [{}, {"light": {"bearing_deg": 0}}]
    simulation = build_experiment(check_config(data, "x.yaml"), "x.yaml").simulation
    assert [situation.light for situation in simulation.situations] == [None, (8.0, 0.0, 0.0)]
    assert simulation.lights == ((1.0, 2.0, 3.0), (8.0, 0.0, 0.0))


SURFACE = ("world.water.surface=1", "world.water.density=1250")


@pytest.mark.slow
def test_settled_start_floats_at_its_place_and_heading():
    """Each situation keeps its own position and heading, and the light rises with the root."""
    trials = "[{}, {start: [2, 1], start_heading_deg: 90}]"
    neutral = situations(trials, *SURFACE)
    assert {situation.start_orientation for situation in neutral} == {None}
    afloat = situations(trials, "simulation.start_pose=settled", *SURFACE)
    for found, given in zip(afloat, neutral, strict=True):
        assert found.start_position[:2] == pytest.approx(given.start_position[:2], abs=1e-9)
        assert found.start_position[2] > 0.9
        w, _, _, z = found.orientation
        assert 2 * np.arctan2(z, w) == pytest.approx(given.start_heading, abs=1e-6)
        assert found.light is not None and given.light is not None
        rise = found.start_position[2] - given.start_position[2]
        assert found.light[2] - given.light[2] == pytest.approx(rise)


SETTLED = "simulation.start_pose=settled"
STONE = "world.ground.obstacles=[{type: block, centre: [4, 0, 0], size: [2, 2, 2000]}]"


@pytest.mark.parametrize(
    ("overrides", "key", "word"),
    [
        (["simulation.start_pose=setled"], "", "'settled'"),
        (["world.water={surface: 0, density: 900}", SETTLED], "simulation.start_pose", "sinks"),
        (["simulation.trials={}"], "", "list"),
        (["simulation.trials=[{}, {strat: [1, 2]}]"], "simulation.trials.1.strat", "'start'"),
        (["simulation.trials=[{light: {bearing: 3}}]"], "0.light.bearing", "_deg"),
        (["simulation.trials=[{light: {distance: '5'}}]"], "0.light", "a number"),
        (["task.light.at=[0, 0, 1]"], "task.light", "distance, bearing_deg"),
        (
            ["task={type: distance}", "simulation.trials=[{}, {light: {distance: 3}}]"],
            "1.light",
            "no light",
        ),
        (["simulation.trials=[{light: {distance: 10000}}]"], "0.light", "1000 times"),
        (["task.light={at: [9e9, 0, 0]}"], "task.light", "9e+09"),
        (
            ["world.ground={}", "simulation.trials=[{}, {light: {elevation_deg: -60}}]"],
            "1.light",
            "deep",
        ),
        (["world.ground={}", "task.light={at: [1, 0, -0.5]}"], "task.light", "0.5 m deep"),
        (["world.ground={}", STONE, "task.light={at: [4, 0, 2]}"], "task.light", "1 m deep"),
        (["world.ground={}", STONE, "simulation.trials=[{}, {start: [4, 0]}]"], "1.start", "stand"),
        (["simulation.start=[0, -1e5]"], "simulation.start", "float32"),
        (["simulation.trials=[{}, {start: [5e5, 5e6]}]"], "1.start", "float32"),
    ],
)
def test_invalid_situations_and_lights_are_rejected(overrides, key, word):
    key = key or overrides[-1].partition("=")[0]
    with pytest.raises(ConfigError) as refused:
        built(*overrides)
    assert key in str(refused.value) and word in str(refused.value)


@pytest.mark.slow
@pytest.mark.parametrize("height", [300, 3000])
@pytest.mark.parametrize(
    "floor",
    [
        "{{type: relief, heights: [[{0}, {0}], [{0}, {0}]]}}",
        "{{type: shore, stop: 1, start_height: {0}, stop_height: {0}}}",
    ],
)
def test_high_ground_carries_an_animal(floor, height):
    """It starts as on a level plane, up to the rounding of float32."""
    starts = [
        situations("1", f"world.ground.floor={given}", path=HEXAPOD)[0].start_position[2]
        for given in (floor.format(height), f"{{height: {height}}}")
    ]
    assert starts[0] == pytest.approx(starts[1], abs=4 * float(np.spacing(np.float32(height))))


def test_an_unused_start_is_not_checked():
    """A start that every entry overrides may lie inside an obstacle."""
    stone = ("world.ground={}", STONE, "simulation.start=[4, 0]")
    (situation,) = situations("[{start: [0, 0], light: {bearing_deg: 90}}]", *stone)
    assert situation.start_position[:2] == (0, 0)
