"""Run folders of version 1.0 keep its results."""

import shutil
import warnings

import numpy as np
import pytest
import yaml

import evo_cpg as evo
from evo_cpg.api.opened import open_run
from evo_cpg.config.errors import ConfigError
from evo_cpg.config.fingerprint import changes, changes_of_fitness, changes_since, fingerprint
from evo_cpg.config.former import (
    FormerKeyWarning,
    with_former_values,
    with_seconds,
    without_former_values,
)
from evo_cpg.config.load import dump_config, load_config, load_run_config
from evo_cpg.config.numbers import number_at, with_numbers
from evo_cpg.config.schema.experiment import ExperimentConfig
from evo_cpg.config.schema.trial import SimulationConfig
from evo_cpg.physics.fluid import Drag
from evo_cpg.training.run_folder import RunFolder
from tiny_run import CONFIG


def without_key(path) -> None:
    """Remove the key that version 1.0 lacked from a configuration."""
    data = yaml.safe_load(path.read_text())
    del data["world"]["water"]["shelter"]
    path.write_text(yaml.safe_dump(data))


def shelter_of(config: ExperimentConfig) -> str:
    assert config.world.water is not None
    return config.world.water.shelter


def test_run_folder_of_1_0_keeps_its_shelter(finished_run, tmp_path):
    folder = RunFolder(shutil.copytree(finished_run, tmp_path / "run"))
    assert shelter_of(open_run(folder.path).config) == "outline"
    without_key(folder.config)
    assert shelter_of(open_run(folder.path).config) == "facing"
    assert shelter_of(evo.load(folder.path).config) == "facing"
    overrides = ["world.water.shelter=outline"]
    assert shelter_of(load_run_config(folder.config, overrides)) == "outline"
    assert shelter_of(load_config(folder.config)) == "outline"


def test_fingerprint_of_1_0_is_unchanged(finished_run, tmp_path):
    """A key that means the same as in version 1.0 does not count as a change."""
    folder = RunFolder(shutil.copytree(finished_run, tmp_path / "run"))
    without_key(folder.config)
    former = load_run_config(folder.config)
    before = fingerprint(former)
    dumped = former.model_dump(mode="json")
    for key in ("shelter", "viscosity", "reactive_thrust", "lift"):
        del dumped["world"]["water"][key]
    cpg = dumped["controller"]["cpg"]
    assert cpg.pop("feedback") is None
    cpg["sensory_feedback"] = cpg.pop("constant_input")
    trial = dumped["simulation"]
    assert trial.pop("seconds") == 5.0
    trial["steps"] = 300
    assert without_former_values(former.model_dump(mode="json")) == dumped
    now = fingerprint(load_config(folder.config))
    assert changes(before, now) == ["world.water"]


def test_a_key_that_the_earlier_version_lacked_counts_if_it_is_set(finished_run):
    config = load_run_config(RunFolder(finished_run).config)
    before = fingerprint(config)
    for key in ("runs", "simulation.substeps"):
        del before["config"][key]
    assert changes_since(before, config.model_copy(update={"runs": 1})) == []
    assert changes_since(before, config.model_copy(update={"runs": 7})) == ["runs"]
    assert changes_since(None, config) == []


@pytest.mark.parametrize(
    ("given", "change", "harmful"),
    [
        ("", "world.gravity=1", True),
        ("", "creature.light_sensors=[]", True),
        ("", "simulation.substeps=7", True),
        ("", "noise.push=0.1", True),
        ("", "task={type: distance}", True),
        ("", "controller.cpg.time_scale=2", True),
        ("evolution={type: map_elites, axes: [{name: speed, range: [0, 1], cells: 4}]}",
         "evolution.axes.0.range=[0, 2]", True),
        ("", "audit.disqualify=[speed]", True),
        ("audit.disqualify=[speed]", "audit.speed=0.5", True),
        ("", "audit.speed=0.5", False),
        ("noise.push=0.1", "seed=3", True),
        ("", "seed=3", False),
        ("", "name=other", False),
        ("", "creature.name=other", False),
        ("", "evolution.mutation_rate=0.3", False),
    ],
)  # fmt: skip
def test_changes_of_the_search_leave_the_fitness(given, change, harmful):
    given = [given] if given else []
    before = fingerprint(load_config(CONFIG, given))
    found = load_config(CONFIG, [*given, change])
    assert changes_since(before, found) != []
    assert bool(changes_of_fitness(before, found)) is harmful


def test_former_name_of_a_key_works_with_a_warning(tmp_path):
    key, new = "controller.cpg.sensory_feedback", "controller.cpg.constant_input"
    path = tmp_path / "mine.yaml"
    shutil.copytree(CONFIG.parent / "creatures", tmp_path / "creatures")
    path.write_text(CONFIG.read_text().replace("constant_input:", "sensory_feedback:"))
    assert "sensory_feedback: 0.0" in path.read_text()
    words = f"{key} is now called {new}. The former name still works"

    def found(*overrides: str, times: int) -> float:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            config = load_config(path, overrides)
        assert [str(each.message) for each in caught] == [words] * times
        return config.controller.cpg.constant_input

    assert found(times=1) == 0.0
    assert found(f"{new}=0.5", times=1) == 0.5
    assert found(f"{new}=0.5", f"{key}=0.25", times=2) == 0.25
    assert found("controller.cpg={sensory_feedback: 0.75}", times=2) == 0.75
    both = "controller.cpg={sensory_feedback: 1.0, constant_input: 1.0}"
    with pytest.warns(FormerKeyWarning), pytest.raises(ConfigError, match="given twice, also as"):
        load_config(CONFIG, [both])


@pytest.mark.parametrize(
    ("written", "overrides", "steps", "words"),
    [
        ("steps: 300", (), 300, "300 control steps are 5 s."),
        ("steps: 601, control_rate_hz: 100", (), 601, "601 control steps are 6.01 s."),
        ("steps: 300", ("simulation.control_rate_hz=100",), 300, "300 control steps are 3 s."),
        ("steps: 300", ("simulation.seconds=2",), 120, None),
        ("seconds: 2", ("simulation.steps=300",), 300, "300 control steps are 5 s."),
        ("seconds: 2", ("simulation={steps: 7}",), 7, "7 control steps are 0.116667 s."),
    ],
)
def test_a_number_of_steps_stays_exact(tmp_path, written, overrides, steps, words):
    path = tmp_path / "mine.yaml"
    shutil.copytree(CONFIG.parent / "creatures", tmp_path / "creatures")
    text = CONFIG.read_text().partition("simulation:")
    rest = text[2][text[2].index("\n\n") :]
    path.write_text(f"{text[0]}simulation: {{{written}}}{rest}")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        config = load_config(path, overrides)
    assert config.simulation.steps == steps
    assert [words in str(each.message) for each in caught] == [True] * (words is not None)
    # The program writes the duration, and reads the number of steps of former runs without a word.
    (tmp_path / "config.yaml").write_text(dump_config(config))
    assert load_run_config(tmp_path / "config.yaml") == config


def test_every_number_of_steps_becomes_a_duration():
    for rate in (7.0, 30, 59.94, 60, 100 / 3, 1000):
        for steps in (1, 2, 17, 59, 1999, 999_999, 1_000_000):
            (found,) = with_seconds(
                {"simulation": {"steps": steps, "control_rate_hz": rate}}, False
            ).values()
            assert SimulationConfig(**found).steps == steps


def test_a_duration_is_given_once():
    with pytest.raises(ConfigError, match="given twice, also as seconds"):
        load_config(CONFIG, ["simulation={steps: 60, seconds: 1}"])


def test_a_changed_duration_is_named_by_its_key(finished_run):
    config = load_run_config(RunFolder(finished_run).config)
    longer = load_run_config(RunFolder(finished_run).config, ["simulation.seconds=9"])
    assert changes_of_fitness(fingerprint(config), longer) == ["simulation.seconds"]


def test_numbers_are_found_under_their_former_names():
    key, config = "controller.cpg.sensory_feedback", load_config(CONFIG)
    with pytest.warns(FormerKeyWarning):
        assert number_at(config, key) == 0.0
    assert with_numbers(config, {key: 0.5}, CONFIG).controller.cpg.constant_input == 0.5


def test_run_folder_of_1_0_keeps_its_constant_input(finished_run, tmp_path):
    """The program wrote the former name, so it does not warn."""
    folder = RunFolder(shutil.copytree(finished_run, tmp_path / "run"))
    text = folder.config.read_text()
    folder.config.write_text(text.replace("constant_input: 0.0", "sensory_feedback: 0.5"))
    assert load_run_config(folder.config).controller.cpg.constant_input == 0.5


@pytest.mark.filterwarnings("default::evo_cpg.config.former.FormerKeyWarning")
def test_command_warns_of_a_former_key_in_one_line(cli):
    _, _, err = cli("validate", CONFIG, "controller.cpg.sensory_feedback=0.1")
    assert err.splitlines()[0] == (
        "evo-cpg: warning: controller.cpg.sensory_feedback is now called "
        "controller.cpg.constant_input. The former name still works"
    )


def test_files_without_water_stay_as_they_are():
    for data in ({}, {"world": None}, {"world": {"water": None}}, {"world": {"water": 3}}):
        assert with_former_values(data) == data
        assert without_former_values(data) == data


def test_rules_differ_for_round_bodies_only():
    """The swimmer is made of boxes, the salamander of ellipsoids and capsules."""
    for name, same in (("iwadate2010_swimmer", True), ("iwadate2010_salamander_water", False)):
        areas = []
        for rule in ("facing", "outline"):
            loaded = evo.load(name, [f"world.water.shelter={rule}"])
            law = loaded.parts.simulation.world.forces[0]
            assert isinstance(law, Drag)
            areas.append(np.concatenate([patch.normal_area for patch in law.patches]))
        assert (
            np.shape(areas[0]) == np.shape(areas[1]) and bool((areas[0] == areas[1]).all())
        ) is same


def test_free_slip_and_cost_are_no_change():
    """A weight of 0 means the same as in version 1.0, any other does not."""
    walk = {"type": "walk", "tilt_weight": 20.0}
    for weights, left in (
        ({"slip_weight": 0.0, "cost_weight": 0.0}, {}),
        ({"slip_weight": 1.0, "cost_weight": 0.0}, {"slip_weight": 1.0}),
    ):
        assert without_former_values({"task": walk | weights}) == {"task": walk | left}
        assert with_former_values({"task": walk | weights}) == {"task": walk | weights}
