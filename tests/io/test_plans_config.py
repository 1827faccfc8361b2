"""The section ``evolution.plan``, its errors, and the creature that stands for all plans."""

import numpy as np
import pytest

from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import check_config, dump_config
from plans import WATER, plan_config, plan_experiment
from wrong_values import problem, with_changes

PLAN = "evolution.plan"
BOX = {"name": "a", "shape": {"type": "box", "size": [1, 1, 1]}, "material": "m"}
CREATURE = {"name": "mine", "materials": {"m": {"density": 1000}}, "bodies": [BOX]}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({f"{PLAN}.edges": [0.4, 0.06]}, "evolution.plan: edges: 0.4 is not below 0.06"),
        ({f"{PLAN}.edges": [0.0, 0.06]}, "evolution.plan.edges.0: "),
        ({f"{PLAN}.joints": ["hinge", "slide"]}, "evolution.plan.joints.1: "),
        ({f"{PLAN}.joints": []}, "evolution.plan.joints: "),
        ({f"{PLAN}.bodies": 21}, "evolution.plan.bodies: "),
        ({f"{PLAN}.bodies": 1}, "evolution.plan.bodies: "),
        ({f"{PLAN}.parts": 13}, "evolution.plan.parts: "),
        ({f"{PLAN}.connections": 0}, "evolution.plan.connections: "),
        ({f"{PLAN}.restitution": 1.5}, "evolution.plan.restitution: "),
        ({f"{PLAN}.largest_angle_deg": 90}, "evolution.plan.largest_angle_deg: "),
        ({f"{PLAN}.volume": -1}, "evolution.plan.volume: "),
        ({f"{PLAN}.body": 3}, "evolution.plan.body"),
        ({"evolution.crossed": 0.7, "evolution.grafted": 0.4}, "add up to more than 1"),
        ({"evolution.elites": 4}, "elites: must be fewer than the population of 4, got 4"),
        ({"evolution.body": {"a.length": [1, 2]}}, "plans evolve their whole bodies"),
    ],
)
def test_wrong_values_are_named_once(changes, words):
    message = problem(with_changes(plan_config(WATER, 6, 0.1), changes))
    assert message.count(words) == 1, message
    if words.endswith(": ") and words.startswith(PLAN):
        assert message.count("evolution.plan") == 1, message


def test_a_written_configuration_is_read_again(tmp_path):
    """The file has the creature that stands for all plans, and gives the same experiment."""
    config = check_config(plan_config(WATER, 6, 0.1), "x.yaml")
    again = check_config(config.model_dump(mode="json"), "x.yaml")
    assert again == config and dump_config(again) == dump_config(config)
    one, other = (build_experiment(each, "x.yaml").simulation for each in (config, again))
    assert one.genome.count == other.genome.count


def test_settings_reach_all_plans():
    """Sizes of the genome, axes of the joints, and bounds follow from the section."""
    given = {"parts": 4, "connections": 2, "joints": ["universal"], "edges": [0.1, 0.3]}
    settings = {"largest_angle_deg": 30, "volume": 0.02, "density": 700.0, "motor_gain": 1e3}
    plans = plan_experiment(WATER, 7, 0.1, **given, **settings).simulation.plans
    assert (plans.layout.nodes, plans.layout.connections, plans.layout.kinds) == (4, 2, (2,))
    assert plans.sizes == (3, 6, 8) and plans.physics.axes == (1, 2)
    assert plans.bounds.bodies == 7 and plans.bounds.half == (0.05, 0.15)
    assert plans.bounds.volume == 0.02
    assert (plans.physics.density, plans.physics.motor_gain) == (700.0, 1e3)
    np.testing.assert_allclose(plans.bounds.angles, np.deg2rad(30))
