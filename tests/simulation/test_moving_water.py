"""Water that changes in time, against sums of vortices, closed forms and the balance of impulse."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from evo_cpg.analysis.energy import ledger
from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import load_config
from evo_cpg.native.engine import Engine
from evo_cpg.physics.water.water import Street, Vortex, Water
from evo_cpg.simulation.control_step import at_time, begin_episode, sense
from evo_cpg.simulation.observers import EachPhysicsStep
from evo_cpg.simulation.rollout import rollout
from evo_cpg.view.flow import carried
from tiny_run import CONFIG, PAIR

SPACING, WIDTH, CIRCULATION, SPEED, HEADING = 0.5, 0.14, 0.3, 0.2, 0.7
STREET = Street(SPACING, WIDTH, CIRCULATION, 1e-4, SPEED, HEADING, (0.1, -0.2), 0.3)
ALONG = np.array([np.cos(HEADING), np.sin(HEADING)])
AXES = np.array([ALONG, [-ALONG[1], ALONG[0]]])


@pytest.fixture
def precise():
    with jax.enable_x64(True):
        yield


def axes_of_street(time, count=2000):
    """Return the axes ``(2, n)`` and the circulations of vortices in the middle of the street."""
    number = np.arange(-count, count)
    left = np.stack([(number + 0.3) * SPACING + SPEED * time, np.full(2 * count, WIDTH / 2)])
    rows = left, left + np.array([[SPACING / 2], [-WIDTH]])
    places = [AXES.T @ row + [[0.1], [-0.2]] for row in rows]
    return np.concatenate(places, 1), np.repeat([CIRCULATION, -CIRCULATION], 2 * count)


def test_a_street_is_a_sum_of_vortices(precise):
    place, time = np.random.default_rng(0).uniform(-0.5, 0.5, (3, 20)), 1.3
    axes, circulations = axes_of_street(time)
    x, y = place[:2, :, None] - axes[:, None]
    rate = circulations / (2 * np.pi) / (x * x + y * y)
    expected = [(-rate * y).sum(-1), (rate * x).sum(-1), np.zeros(20)]
    found = STREET.at(time).velocity(jnp.asarray(place))
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())


def test_a_street_carries_itself(precise):
    """Each axis moves at Gamma / 2a tanh(pi b / a) in the flow of the others (Lamb, art. 156)."""
    axes, _ = axes_of_street(0.0, 2)
    found = STREET.velocity(jnp.asarray(np.append(axes[:, :1], [[0.0]], 0)))[:2, 0]
    speed = CIRCULATION / (2 * SPACING) * np.tanh(np.pi * WIDTH / SPACING)
    np.testing.assert_allclose(found, speed * ALONG, rtol=1e-6)


def test_cores_of_streets_equal_those_of_vortices(precise):
    street = dataclasses.replace(STREET, core=1e-3, width=3.0)
    axis = AXES.T @ [0.3 * SPACING, 1.5] + [0.1, -0.2]
    near = np.append(axis, 0.0)[:, None] + 2e-3 * np.eye(3)[:, :2]
    single = Vortex(tuple(axis), CIRCULATION, 1e-3).velocity(jnp.asarray(near))
    # The other row is a uniform flow here.
    others = street.velocity(jnp.asarray(np.append(axis, 0.0)[:, None]))
    np.testing.assert_allclose(street.velocity(jnp.asarray(near)) - others, single, atol=0.02)


def test_streets_have_no_divergence_and_no_overflow():
    """In float32, at any distance."""
    slope = jax.jit(jax.vmap(jax.jacfwd(lambda x: STREET.velocity(x[:, None])[:, 0])))
    away = jnp.array([[0.3, y, 0.0] for y in (0.0, 1.0, -30.0, 1e4, -1e12)], jnp.float32)
    found = np.asarray(slope(away))
    assert np.isfinite(found).all()
    np.testing.assert_allclose(np.trace(found, axis1=1, axis2=2), 0, atol=1e-5)
    np.testing.assert_allclose(STREET.velocity(away[2:].T), 0, atol=1e-6)


def test_specks_follow_the_water_of_a_drifting_vortex():
    """The reference takes 6000 steps."""
    water = Water(1000.0, streams=(Vortex((0.0, 0.0), 1.5, 0.3, (0.2, -0.1)),))
    radius, now, drift = 0.4, 1.2, np.array([0.2, -0.1])
    start = jnp.array([[radius], [0.0], [0.0]])
    path = carried(water, start, jnp.zeros(1), jnp.ones(1), jnp.float32(now))
    place = np.array([radius, 0.0])
    for time in np.arange(6000) * now / 6000:
        x, y = place - drift * time
        rate = 1.5 / (2 * np.pi) / (x * x + y * y + 0.09)
        place = place + now / 6000 * rate * np.array([-y, x])
    np.testing.assert_allclose(path[-1][:2, 0], place, atol=1e-3)


STREAMS = (
    "world.water.street={spacing: 0.6, width: 0.2, circulation: 0.3, core: 0.05, speed: 0.2}",
    "world.water.oscillations=[{velocity: [0, 0.2, 0], period: 0.7, phase_deg: 30}]",
    "world.water.vortices=[{circulation: 0.4, core: 0.1, velocity: [0.2, 0.1]}]",
)


def trial(*settings):
    config = load_config(CONFIG, (*PAIR, *settings))
    return build_experiment(config, CONFIG).simulation


@pytest.mark.slow
def test_native_code_agrees_on_changing_water():
    simulation = trial(*STREAMS, "simulation.seconds=0.5")
    genes = simulation.genome.random(jax.random.key(0), (3,))
    native, plain = (
        rollout(dataclasses.replace(simulation, engine=engine), genes).terms
        for engine in (Engine(), Engine("jax"))
    )
    for name, value in native.items():
        np.testing.assert_allclose(value, plain[name], rtol=1e-3)


@pytest.mark.slow
def test_impulse_of_changing_water_is_explained():
    simulation = trial(*STREAMS, "simulation.seconds=0.5")
    genes = simulation.genome.random(jax.random.key(0), (1,))
    steps = jax.device_get(rollout(simulation, genes, observers=EachPhysicsStep()))
    book = ledger(simulation.world, steps, simulation.step_length)
    assert np.abs(book.impulse).max() < 2e-3 * book.given.max()


def test_flow_sensors_feel_each_control_step():
    swing = "world.water.oscillations=[{velocity: [0.3, 0, 0], period: 0.7, phase_deg: 30}]"
    name, steps = trial().world.tree.names[0], np.array([0, 9, 20])
    simulation = trial(swing, f"creature.sensors=[{{type: flow, body: {name}}}]")
    genes = jnp.zeros((simulation.genome.count, 1))
    constants, animal = begin_episode(simulation, genes, None, None)
    seen = [sense(simulation, constants, animal, step)[0].custom for step in steps]
    expected = 0.3 * np.sin(2 * np.pi * steps / simulation.control_rate / 0.7 + np.pi / 6)
    np.testing.assert_allclose(np.array(seen)[:, 0, 0], expected, rtol=1e-4)


def test_steady_worlds_stay_the_same_object():
    simulation = trial("world.water.vortices=[{circulation: 0.4, core: 0.1}]")
    _, animal = begin_episode(simulation, jnp.zeros((simulation.genome.count, 1)), None, None)
    assert at_time(simulation, 3, animal.state) is simulation
