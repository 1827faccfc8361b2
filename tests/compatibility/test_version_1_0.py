"""The interface and the configurations of version 1.0 still work.

The folder `version_1_0` holds them: the interface as `public_interface.py` described version 1.0.0.
"""

import json
import warnings
from pathlib import Path

import numpy as np
import public_interface
import pytest

import evo_cpg as evo
from evo_cpg.config.build import build_experiment
from evo_cpg.config.former import RENAMED
from evo_cpg.config.load import load_config
from evo_cpg.config.shipped import shipped

FORMER = Path(__file__).with_name("version_1_0")
CONFIGS = sorted((FORMER / "configs").glob("*.yaml"))

# Defaults that changed. docs/from-1.0.md or the changelog describes each.
NEW_DEFAULTS = {
    f"audit.{limit}": (former, None)
    for limit, former in (("penetration", 0.01), ("overlap", 0.01), ("speed", 20.0))
}
# Keys that still work, with another meaning of their number (`tests/cli/test_former_runs.py`).
REPLACED = {"simulation.steps"}
POSITIONAL = "POSITIONAL_ONLY", "POSITIONAL_OR_KEYWORD"


@pytest.fixture(scope="module")
def former():
    return json.loads((FORMER / "interface.json").read_text())


def broken_calls(before: dict[str, str], now: dict[str, str]) -> list[str]:
    """Return the parameters with which calls of the former function fail or change."""
    wrong = [name for name, how in before.items() if now.get(name) != how]
    first = [name for name, how in before.items() if how.startswith(POSITIONAL)]
    if list(now)[: len(first)] != first:
        wrong.append(f"order of {', '.join(first)}")
    free = "VAR_POSITIONAL", "VAR_KEYWORD"
    added = {name: how for name, how in now.items() if name not in before}
    return wrong + [name for name, how in added.items() if " = " not in how and how not in free]


def broken_names(before, now) -> list[str]:
    """Return the names and parameters that changed or are gone."""
    wrong = sorted(before.keys() - now.keys())
    for name in before.keys() & now.keys():
        old, new = before[name], now[name]
        wrong += [f"{name}: {each}" for each in broken_calls(old["parameters"], new["parameters"])]
        mine, others = old.get("members", {}), new.get("members", {})
        for member, parameters in mine.items():
            if member not in others or (parameters is None) != (others[member] is None):
                wrong.append(f"{name}.{member}")
            elif parameters is not None:
                calls = broken_calls(parameters, others[member])
                wrong += [f"{name}.{member}: {each}" for each in calls]
    return wrong


def broken_commands(before, now) -> list[str]:
    """Return the commands, arguments and options with which former calls fail."""
    wrong = sorted(before.keys() - now.keys())
    for command in before.keys() & now.keys():
        old, new = before[command], now[command]
        for one, how in old.items():
            found = new.get(one)
            same = found is not None and all(
                found[key] == how[key] for key in ("values", "repeated", "flag")
            )
            if not same or not set(how["choices"]) <= set(found["choices"]):
                wrong.append(f"{command} {one}")
            elif found["required"] and not how["required"]:
                wrong.append(f"{command} {one} is required")
        wrong += [
            f"{command} {one} is required" for one in new if one not in old and new[one]["required"]
        ]
    return wrong


def broken_keys(before, now) -> list[str]:
    """Return the configuration keys, words and defaults that changed or are gone."""
    wrong = []
    for key, how in before.items():
        section, _, name = key.rpartition(".")
        # An actuator without a type is a servo.
        section = section.replace("joint.actuator", "joint.actuator[servo]")
        found = now.get(f"{section}.{RENAMED.get(name, name)}".strip("."))
        if found is None:
            wrong += [key] * (key not in REPLACED)
            continue
        gone = set(how["allowed"]) - set(found["allowed"])
        wrong += [f"{key}: {word} is no longer allowed" for word in sorted(gone)]
        defaults = how.get("default"), found.get("default")
        if defaults[0] != defaults[1] and NEW_DEFAULTS.get(key) != defaults:
            wrong.append(f"{key}: another default")
    return wrong


def test_names_of_1_0_take_the_same_calls(former):
    assert len(former["names"]) == 19
    assert broken_names(former["names"], public_interface.names()) == []


def test_evaluation_of_1_0_has_one_trial():
    fitness = np.array([1.0, -np.inf])
    evaluation = evo.Evaluation(fitness, {}, {})
    np.testing.assert_array_equal(evaluation.trial_fitness, [fitness])


def test_commands_and_options_of_1_0_exist(former):
    assert len(former["commands"]) > 20
    assert broken_commands(former["commands"], public_interface.commands()) == []


def test_configuration_keys_of_1_0_exist(former):
    assert len(former["keys"]) > 300
    assert broken_keys(former["keys"], public_interface.keys()) == []


def test_removed_and_changed_parts_are_found(former):
    """The comparison itself: each change below breaks a former script."""
    for change, expected in (
        (lambda it: it.pop("load"), ["load"]),
        (
            lambda it: it["load"]["parameters"].pop("trust"),
            ["load: trust", "load: order of config, overrides, cores, trust"],
        ),
        (
            lambda it: it["load"]["parameters"].update(more="KEYWORD_ONLY"),
            ["load: more"],
        ),
        (lambda it: it["Experiment"]["members"].pop("record"), ["Experiment.record"]),
    ):
        now = json.loads(json.dumps(former["names"]))
        change(now)
        assert broken_names(former["names"], now) == expected
    for change, expected in (
        (lambda it: it.pop("audit"), ["audit"]),
        (lambda it: it["render"].pop("--size"), ["render --size"]),
        (lambda it: it["render"]["--camera"]["choices"].remove("top"), ["render --camera"]),
        (lambda it: it["plot"]["argument 1"].update(values=2), ["plot argument 1"]),
    ):
        now = json.loads(json.dumps(former["commands"]))
        change(now)
        assert broken_commands(former["commands"], now) == expected
    now = public_interface.keys()
    del now["world.gravity"]
    now["world.water.density"]["default"] = 1.0
    now["world.water.law"]["allowed"].remove("= isotropic")
    assert sorted(broken_keys(former["keys"], now)) == [
        "world.gravity",
        "world.water.density: another default",
        "world.water.law: = isotropic is no longer allowed",
    ]


def loaded(path):
    """Load a configuration of 1.0. Only keys with a former name may warn."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        config = load_config(path)
    assert all("is now called" in str(each.message) for each in caught)
    return config


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_configuration_of_1_0_loads(path):
    assert loaded(path).name == path.stem


@pytest.mark.slow
@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_configuration_of_1_0_builds(path):
    """The genome has the same length as now in the configuration of this name, which 1.0 had."""
    former, now = (
        build_experiment(loaded(each), each).simulation.genome.count
        for each in (path, shipped(path.stem).path)
    )
    assert former == now > 0


def test_all_configurations_of_1_0_are_here():
    assert len(CONFIGS) == 18
