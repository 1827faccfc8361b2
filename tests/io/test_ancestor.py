"""A drawn animal becomes a body plan, from which a search starts."""

import copy

import jax
import numpy as np
import pytest

from evo_cpg.creature.creature import neutral_pose
from evo_cpg.creature.development import developed
from evo_cpg.creature.graph import GraphLayout
from evo_cpg.io.ancestor import graph_of_creature
from evo_cpg.io.build import build_experiment
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.load import check_config
from evo_cpg.io.plans import creature_of
from evo_cpg.io.schema.creature import CreatureConfig
from plans import LAND, WATER, plan_config, plans_of, random_genes


def leg(name: str, x: float, y: float) -> dict:
    joint = {"parent": "torso", "at": [x, y, -0.02], "child_at": [-0.1, 0, 0], "axes": ["y"]}
    joint |= {"rotation_deg": [0, 90, 0], "limits_deg": [-40, 40], "actuator": {"gain": 1}}
    shape = {"type": "capsule", "radius": 0.03, "length": 0.2}
    return {"name": name, "shape": shape, "material": "flesh", "joint": joint}


DOG = {
    "name": "dog",
    "materials": {"flesh": {"density": 500}},
    "bodies": [
        {
            "name": "torso",
            "shape": {"type": "box", "size": [0.35, 0.16, 0.09]},
            "material": "flesh",
        },
        leg("front_left", 0.13, 0.09),
        leg("front_right", 0.13, -0.09),
        leg("hind_left", -0.13, 0.09),
        leg("hind_right", -0.13, -0.09),
    ],
}


def experiment(creature: dict, **plan):
    config = plan_config(LAND, 8, 1, **plan) | {"creature": creature}
    config["evolution"] |= {"population": 40, "elites": 8}
    return build_experiment(check_config(config, "dog.yaml"), "dog.yaml")


def grown(creature: dict, layout: GraphLayout, bounds):
    graph = graph_of_creature(CreatureConfig.model_validate(creature).build(), layout, bounds)
    plan = jax.jit(lambda x: developed(x, layout, bounds))(graph)
    return graph, jax.tree.map(np.asarray, plan)


@pytest.mark.slow
def test_legs_become_one_part_on_both_sides():
    plans = experiment(DOG).simulation.plans
    graph, plan = grown(DOG, plans.layout, plans.bounds)
    assert graph.used.sum() == 2 and graph.reflect.sum() == 2
    np.testing.assert_array_equal(plan.present, np.arange(8) < 5)
    # Legs point down, are as long as drawn, and turn about y.
    np.testing.assert_allclose(plan.rotation[1:5, :, 0], [[0, 0, -1]] * 4, atol=1e-3)
    np.testing.assert_allclose(plan.half[0], [0.175, 0.08, 0.045], rtol=0.01)
    np.testing.assert_allclose(plan.half[1:5], [[0.13, 0.03, 0.03]] * 4, rtol=0.01)
    np.testing.assert_array_equal(plan.axes[1:5], [[False, True, False]] * 4)
    np.testing.assert_allclose(plan.limit[1:5, 1], np.radians(40), rtol=0.01)
    np.testing.assert_array_equal(np.sign(plan.place[1:5, 1]).sum(), 0)


@pytest.mark.slow
def test_the_first_individuals_descend_from_the_animal():
    simulation = experiment(DOG).simulation
    genes = np.asarray(simulation.genome.random(jax.random.key(0), (40,)))
    count, _, numbers = simulation.plans.developed(genes)
    torso = numbers.half[:, 0]
    drawn = np.array([0.175, 0.08, 0.045])[:, None]
    assert (count == 5).sum() > 10 and (count != 5).any()
    assert (np.abs(torso / drawn - 1) < 0.02).all(0).sum() > 10
    # Oscillators are random.
    layout = simulation.plans.layout
    assert np.unique(np.asarray(layout.unpack(genes).control)[0, 0, 0]).size > 20


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_the_own_creature_of_a_plan_gives_its_plan(seed):
    plans = plans_of(WATER, 8, 1, volume=1.0)
    layout = GraphLayout(12, 4, kinds=plans.layout.kinds)
    for genes in random_genes(plans, 6, seed).T:
        plan = plans.plan(genes)
        ours = creature_of(plan, plans.section)
        _, again = grown(ours, layout, plans.bounds)
        theirs = creature_of(again, plans.section)
        (here, half), (there, other) = map(boxes, (ours, theirs))
        match = np.linalg.norm(here[:, None] - there[None], axis=-1).argmin(1)
        assert sorted(match) == list(range(plan.present.sum()))
        # A step of a size is 0.7 %, and steps of places and turns add up along a limb.
        np.testing.assert_allclose(there[match], here, atol=0.02)
        np.testing.assert_allclose(other[match], half, rtol=0.01)


def boxes(creature: dict) -> tuple[np.ndarray, np.ndarray]:
    """Return the centres of boxes in the neutral pose, and their edges, m."""
    built = CreatureConfig.model_validate(creature).build()
    return neutral_pose(built)[0], np.array([body["shape"]["size"] for body in creature["bodies"]])


def _welded(creature):
    creature["bodies"][1]["joint"] |= {"axes": [], "limits_deg": []}
    del creature["bodies"][1]["joint"]["actuator"]


def _crowded(creature):
    creature["bodies"][1]["joint"]["at"] = [-0.12, 0.09, -0.02]


@pytest.mark.parametrize(
    ("change", "plan", "words"),
    [
        (_welded, {}, "has a joint that does not only turn"),
        (_crowded, {}, "its plan grows"),
        (lambda creature: None, {"parts": 1}, "needs 2 parts as a plan"),
    ],
)
def test_animals_that_are_no_plans_are_refused(change, plan, words):
    creature = copy.deepcopy(DOG)
    change(creature)
    with pytest.raises(ConfigError, match=words):
        experiment(creature, **plan)
