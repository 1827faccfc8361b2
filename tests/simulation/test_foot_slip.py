"""Slip of touching points: a block slides to rest, a ball rolls, a plank topples, loads weigh."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import quick_jit
from evo_cpg.analysis.gait_numbers import gait_numbers
from evo_cpg.control.commanded import Commanded
from evo_cpg.creature.creature import Body, Creature, Material
from evo_cpg.creature.shapes import Box, Sphere
from evo_cpg.creature.tree import build_tree
from evo_cpg.physics.contact.contact_model import Ground, make_contact_model
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.state import State
from evo_cpg.simulation.measures import Slip, slip_of_points
from evo_cpg.simulation.recording import Recorder, as_recording
from evo_cpg.simulation.rollout import JUDGE, rollout
from evo_cpg.simulation.sensors import place_sensors
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.simulation.situation import Situation
from evo_cpg.simulation.tasks import Walk

RATE, GRAVITY, SPEED = 240, 9.81, 1.0


def trial_of(
    shape, friction, height, seconds, velocity, orientation=(1.0, 0.0, 0.0, 0.0), rate=RATE
):
    """Return terms and gait numbers of a body that starts with a velocity (m/s, rad/s)."""
    body = Creature("body", (Body("body", shape, Material(300.0, 0.0, friction, friction)),))
    tree = build_tree(body)
    ground = Ground(0.0, friction, friction)
    simulation = Simulation(
        world=World(tree, GRAVITY, contact_model=make_contact_model(body, tree, ground)),
        sensors=place_sensors(body, tree),
        controller=Commanded(tree),
        task=Walk(torso_length=0.2, slip_weight=1.0, cost_weight=1.0),
        control_rate=float(rate),
        substeps=RATE // rate,
        steps=round(seconds * rate),
        situations=(Situation((0.0, 0.0, height)),),
    )

    def begin(state: State) -> State:
        turned, moving = (
            jnp.stack([jnp.full_like(state.position[0], x) for x in values])
            for values in (orientation, velocity)
        )
        return State(state.position, turned, moving, state.q, state.qd)

    watched = (JUDGE, Recorder())
    outcome, frames = quick_jit(
        lambda genes: rollout(simulation, genes, observers=watched, begin=begin)
    )(np.zeros((0, 1), np.float32))
    motion = as_recording(simulation, frames, ["body"])
    numbers = gait_numbers(simulation, body, frames, motion)
    return {name: float(value[0]) for name, value in outcome.terms.items()}, numbers


@pytest.mark.slow
def test_a_block_slips_its_stopping_distance():
    """It stops after v^2 / (2 mu g) - v h / 2, because a step moves it by its final speed."""
    mu = 0.4
    terms, _ = trial_of(Box((0.3, 0.3, 0.1)), mu, 0.05, 0.5, (0, 0, 0, SPEED, 0, 0))
    stopping = SPEED**2 / (2 * mu * GRAVITY) - SPEED / RATE / 2
    assert terms["distance"] == pytest.approx(stopping, rel=3e-3)
    assert terms["slip"] == pytest.approx(stopping, rel=3e-3)
    assert terms["cost"] == 0.0


@pytest.mark.slow
def test_task_and_analysis_have_the_slip_of_a_block_that_lands():
    """Load times speed adds up to m v^2 / (2 mu), and load to m g t, so S = v^2 / (2 mu g).

    Velocities are those at the end of each control step of 1/60 s.
    """
    mu, seconds = 0.3, 0.6
    terms, numbers = trial_of(
        Box((0.3, 0.3, 0.1)), mu, 0.06, seconds, (0, 0, 0, SPEED, 0, 0), rate=60
    )
    path = SPEED**2 / (2 * mu * GRAVITY)
    assert terms["slip"] == pytest.approx(path, rel=0.07)
    assert numbers.value("slip") * seconds == pytest.approx(terms["slip"], rel=1e-5)


@pytest.mark.slow
def test_a_rolling_ball_does_not_slip():
    radius = 0.1
    terms, _ = trial_of(Sphere(radius), 0.8, radius, 0.5, (0, SPEED / radius, 0, SPEED, 0, 0))
    assert terms["distance"] == pytest.approx(0.5 * SPEED, rel=2e-2)
    assert terms["slip"] < 1e-3 * terms["distance"]


@pytest.mark.slow
def test_a_body_that_pivots_on_its_edge_does_not_slip():
    """A plank on its edge, tipped by 15 degrees, topples for 0.3 s and has not landed yet."""
    tip, edge, tall = np.deg2rad(15.0), 0.02, 0.4
    height = tall / 2 * np.cos(tip) + edge / 2 * np.sin(tip)
    half = (np.cos(tip / 2), 0.0, np.sin(tip / 2), 0.0)
    terms, _ = trial_of(Box((edge, 0.3, tall)), 2.0, height, 0.3, (0, 0, 0, 0, 0, 0), half)
    assert terms["distance"] > 0.05
    assert terms["slip"] < 0.02 * terms["distance"]


def test_slip_is_weighted_by_load():
    """Points with 3 N at 5 m/s, 1 N at rest, and a fast one in the air."""
    force = jnp.array([[9.0, 0.0, 0.0], [0.0, 9.0, 0.0], [3.0, 1.0, 0.0]])
    velocity = jnp.array([[3.0, 0.0, 7.0], [4.0, 0.0, 7.0], [8.0, 0.0, 7.0]])
    assert float(slip_of_points(force, velocity).speed()) == pytest.approx(15 / 4)
    assert float(Slip(jnp.float32(0.0), jnp.float32(0.0)).speed()) == 0.0


def test_slip_of_a_point_at_rest_has_a_derivative():
    force = jnp.array([[0.0], [0.0], [2.0]])
    slope = jax.grad(lambda v: slip_of_points(force, v).slide)(jnp.zeros((3, 1)))
    np.testing.assert_array_equal(slope, 0.0)


@pytest.mark.parametrize(("slip", "cost"), [(0.0, 0.0), (0.5, 2.0)])
def test_a_price_is_per_distance_slip_and_energy(slip, cost):
    """Slip ratio s and cost of transport k change the price of a metre from a to a - e s - g k."""
    a, e, g, length, walked = 2.0, 3.0, 0.5, 0.4, 1.5
    task = Walk(torso_length=length, distance_weight=a, slip_weight=e, cost_weight=g)
    terms = {"distance": walked, "forward": walked, "tilt": 0.0, "bounce": 0.0, "airborne": 0.0}
    terms |= {"slip": slip * walked, "cost": cost * walked}
    fitness = float(task.fitness({name: jnp.float32(x) for name, x in terms.items()}, {}))
    assert fitness == pytest.approx((a - e * slip - g * cost) * walked / length, rel=1e-5)
