"""An individual that breaks a rule is disqualified in that control step."""

import dataclasses
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import quick_jit
from evo_cpg.creature.creature import length_of
from evo_cpg.io.build import build_experiment
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.load import load_config
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.state import resting_state
from evo_cpg.simulation.judge import keeps
from evo_cpg.simulation.limits import Limits, rules_of
from evo_cpg.simulation.recording import Recorder
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.simulation import Rules
from plans import WATER, plans_of, random_genes
from tiny_run import CONFIG, PAIR
from trials import experiment

STEP = 1 / 60


@pytest.fixture(scope="module")
def simulation():
    return experiment(60).simulation


def kept(world: World, state, energy=0.0, **rules):
    count = state.position.shape[1]
    energies = jnp.broadcast_to(jnp.asarray(energy), (count,))
    keep = quick_jit(lambda state, energies: keeps(Rules(**rules), world, state, energies, STEP))
    return np.asarray(keep(state, energies)).tolist()


def test_speed_limits_the_root_in_any_direction(simulation):
    rest = resting_state(simulation.world.tree, (3,), jnp.float32)
    linear = np.array([[0.0, 0, 0], [3.0, 0, 4.0], [3.1, 0, 4.0]]).T
    state = dataclasses.replace(
        rest, velocity=jnp.asarray(np.concatenate([10 + 0 * linear, linear]))
    )
    assert kept(simulation.world, state, speed=5.0) == [True, True, False]
    assert kept(simulation.world, state) == [True, True, True]


def test_the_fastest_turning_axis_counts(simulation):
    rest = resting_state(simulation.world.tree, (3,), jnp.float32)
    rates = np.zeros(rest.qd.shape)
    rates[0] = [9.9, -10.1, np.nan]
    state = dataclasses.replace(rest, qd=jnp.asarray(rates))
    assert kept(simulation.world, state, joint_rate=10.0) == [True, False, False]


def test_power_is_the_mean_over_a_control_step(simulation):
    rest = resting_state(simulation.world.tree, (2,), jnp.float32)
    energy = np.array([0.99, 1.01]) * 30.0 * STEP
    assert kept(simulation.world, rest, energy, power=30.0) == [True, False]


def built(*overrides):
    path = CONFIG.with_name("hexapod.yaml")
    return build_experiment(load_config(path, overrides), path)


@pytest.mark.slow
def test_the_deepest_penetration_and_overlap_count():
    hexapod = built("audit.disqualify=[penetration, overlap]", "audit.overlap=0.002")
    rules, world = hexapod.simulation.rules, hexapod.simulation.world
    assert rules.penetration == 0.01 and rules.overlap == 0.002 and rules.speed is None
    start = hexapod.simulation.situations[0].start_position
    rest = resting_state(world.tree, (2,), jnp.float32, start)
    sunk = rest.position - jnp.array([[0.0, 0.0], [0.0, 0.0], [0.009, 0.011]])
    state = dataclasses.replace(rest, position=sunk)
    assert kept(world, state, penetration=rules.penetration) == [True, False]
    # Turn legs through their neighbours.
    swung = dataclasses.replace(rest, q=rest.q.at[:, 1].set(1.5))
    assert kept(world, swung, overlap=0.002, pairs=rules.pairs) == [True, False]


@pytest.mark.parametrize("engine", ["auto", pytest.param("jax", marks=pytest.mark.slow)])
def test_one_step_beyond_the_speed_limit_disqualifies(engine):
    path = CONFIG
    config = load_config(path, [*PAIR, f"engine={engine}", "simulation.seconds=0.6667"])
    free = build_experiment(config, path).simulation
    genes = free.genome.random(jax.random.key(3), (6,), jnp.float32)
    frames = quick_jit(lambda g: rollout(free, g, observers=Recorder(6)))(genes)
    place = np.asarray(frames["position"])[:, :, 0]
    speed = np.linalg.norm(np.diff(place, axis=0), axis=1).max(0) / STEP
    assert np.asarray(quick_jit(lambda g: rollout(free, g).alive)(genes)).all()
    # The limit lies between the third and the fourth speed of six.
    limit = float(np.sort(speed)[2:4].mean())
    bound = dataclasses.replace(free, rules=Rules(speed=limit))
    alive = np.asarray(quick_jit(lambda g: rollout(bound, g).alive)(genes))
    # Recorded places give mean speeds, but the rule checks speeds at the ends of control steps.
    np.testing.assert_array_equal(alive, speed <= limit)


def test_limits_scale_with_the_size_and_mass_of_the_animal():
    swimmer = build_experiment(
        load_config(CONFIG, [*PAIR, "audit.disqualify=[speed, power]", "audit.power=50"]), CONFIG
    )
    rules = swimmer.simulation.rules
    assert rules.speed == pytest.approx(np.sqrt(40 * 9.81 * length_of(swimmer.creature)))
    assert length_of(swimmer.creature) == pytest.approx(0.42)
    assert rules.power == pytest.approx(50 * swimmer.creature.mass)
    limb = rules_of(("joint_rate",), Limits(), 0.42, 1.0, None)
    assert limb.joint_rate == pytest.approx(10 * np.sqrt(9.81 / 0.42)) and limb.speed is None


@pytest.mark.slow
def test_rules_of_plans_are_a_tenth_stricter():
    plans = plans_of(WATER, 3, 0.1)
    found, inputs = plans.developed(random_genes(plans, 1)), plans.inputs(3)
    _, values = plans.given(found, np.arange(1), 3)

    @quick_jit
    def limits_of(value):
        rules = inputs.put(inputs.common, [value]).rules
        return rules.speed, rules.overlap

    speed, overlap = limits_of(values[:, 0])
    length = float(found[2].length[0])
    limits = Limits().of_length(length)
    assert float(speed) == pytest.approx(0.9 * limits.speed * length)
    assert float(overlap) == pytest.approx(0.9 * limits.overlap)


@pytest.mark.parametrize(
    ("name", "rules"),
    [
        ("virtual_creatures_water", ["speed", "joint_rate", "overlap"]),
        ("virtual_creatures_land", ["speed", "joint_rate", "overlap", "penetration"]),
        ("evolving_walker", ["speed", "joint_rate"]),
    ],
)
def test_evolving_bodies_have_rules_by_default(name, rules):
    path = CONFIG.with_name(f"{name}.yaml")
    assert load_config(path).audit.disqualify == rules
    assert load_config(path, ["audit.disqualify=[]"]).audit.disqualify == []


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["audit.disqualify=[power]"], "audit.power: is missing"),
        (["audit.disqualify=[penetration]"], "audit.disqualify: 'penetration' needs ground"),
        (["audit.disqualify=[sped]"], "audit.disqualify.0: 'sped'"),
        (["audit.half_stp=1"], "did you mean 'half_step'?"),
        (["audit.half_step=-1"], "audit.half_step: -1"),
    ],
)
def test_wrong_rules_are_refused(overrides, words):
    with pytest.raises(ConfigError, match=re.escape(words)):
        build_experiment(load_config(CONFIG, overrides), CONFIG)


def test_configurations_of_the_papers_have_no_rules():
    # The salamander is not included: a paper shows it, but its experiments are not from the paper.
    names = "iwadate2010_swimmer", *(f"fukui2003_model{i}" for i in (1, 2, 3))
    for name in names:
        assert load_config(CONFIG.with_name(f"{name}.yaml")).audit.disqualify == []
