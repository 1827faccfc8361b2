"""Muscles against closed forms: bend, frequency, decay, force and speed, work, gradients."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import driven
from creatures import box_chain, in_water, rolled
from evo_cpg.creature.creature import Actuator, Muscle
from evo_cpg.creature.tree import build_tree
from evo_cpg.native.jax_internals import quick_jit
from evo_cpg.physics.step.step import step
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.joint_torque import MotorCommand
from evo_cpg.physics.tree.muscle import metabolic_rate, pull_of
from evo_cpg.physics.tree.state import resting_state

pytestmark = pytest.mark.usefixtures("x64")

H = 1 / 120
SIZE = (0.2, 0.1, 0.1)
MASS = 2.0
# Inertia of each of two equal boxes about its centre, kg m^2. Bent symmetrically, each box turns by
# half of the joint's angle, and the centres only move apart. The joint sees half of one inertia.
INERTIA = MASS * (SIZE[0] ** 2 + SIZE[1] ** 2) / 12
EKEBERG = Muscle(
    area=1e-3, arm=0.02, fibre_length=0.1, bend_deg=np.rad2deg(0.3), tone=1.5, hill=False
)
HILL = dataclasses.replace(EKEBERG, hill=True)


def pair(muscle: Muscle, bodies: int = 2) -> World:
    return World(build_tree(box_chain(bodies, "z", muscle, SIZE)), 0.0)


def moved(world: World, activation, angle, count: int, h: float = H):
    """Return angles, rates, torques and energies under constant activation, steps first."""
    rest = jnp.zeros(world.tree.dof_count)
    command = MotorCommand(rest, activation=None if activation is None else jnp.array(activation))
    return driven.moved(world, command, count, h, angle=angle)


@pytest.mark.parametrize("both", [(1.0, 0.0), (0.2, 0.7), (0.6, 0.6)])
def test_steady_bend_is_the_quotient_of_pull_and_stiffness(both):
    """Ekeberg: phi = alpha (ML - MR) / (beta (ML + MR + gamma)), towards the first muscle."""
    q, *_ = moved(pair(EKEBERG, 3), [[x, x] for x in both], 0.0, 600)
    alpha, beta = EKEBERG.numbers["strength"], EKEBERG.numbers["stiffening"]
    expected = alpha * (both[0] - both[1]) / (beta * (sum(both) + EKEBERG.tone))
    np.testing.assert_allclose(q[-1], expected, atol=1e-9)


def test_one_side_alone_bends_by_the_given_angle():
    q, *_ = moved(pair(EKEBERG), [[0.0], [1.0]], 0.0, 600)
    assert q[-1] == pytest.approx(-np.deg2rad(EKEBERG.bend_deg), abs=1e-9)


@pytest.mark.parametrize("both", [(0.0, 0.0), (0.4, 0.4)])
def test_undamped_frequency_follows_stiffness_and_inertia(both):
    """Differs from sqrt(k/I) by Newmark's rule alone: tan(w' h / 2) = w h / 2."""
    muscle = dataclasses.replace(EKEBERG, damping_time=0.0, area=2e-4)
    stiffness = muscle.numbers["stiffening"] * (sum(both) + muscle.tone)
    natural = np.sqrt(stiffness / (INERTIA / 2))
    q, *_ = moved(pair(muscle), [[x] for x in both], 1e-3, 1200)
    q = q[:, 0]
    crossings = np.flatnonzero((q[:-1] > 0) & (q[1:] <= 0))
    times = H * (crossings + q[crossings] / (q[crossings] - q[crossings + 1]))
    rate = 2 * np.pi * (len(times) - 1) / (times[-1] - times[0])
    assert rate == pytest.approx(2 / H * np.arctan(natural * H / 2), rel=1e-4)
    assert rate == pytest.approx(natural, rel=0.02)
    # The amplitude neither falls nor grows.
    assert np.abs(q[-120:]).max() == pytest.approx(1e-3, rel=5e-3)


def test_passive_joint_decays_as_a_damped_spring():
    muscle = dataclasses.replace(EKEBERG, damping_time=0.004, area=2e-4)
    natural = np.sqrt(muscle.numbers["rest_stiffness"] / (INERTIA / 2))
    decay = muscle.numbers["damping"] / INERTIA
    ringing = np.sqrt(natural**2 - decay**2)
    errors = []
    for h in (1 / 1200, 1 / 2400):
        q, *_ = moved(pair(muscle), None, 1e-3, round(0.25 / h), h)
        # Angles are half a step ahead of rates.
        time = h * np.arange(1, len(q) + 1) + h / 2
        wave = np.cos(ringing * time) + decay / ringing * np.sin(ringing * time)
        errors.append(np.abs(q[:, 0] / 1e-3 - np.exp(-decay * time) * wave).max())
    assert errors[0] < 0.01
    assert errors[1] < 0.6 * errors[0]


def test_a_closed_passive_cycle_without_damping_does_no_work():
    """Work is the change of k m^2 / 2, where m is the mean of two successive angles."""
    muscle = dataclasses.replace(EKEBERG, damping_time=0.0)
    q, rate, torque, _ = moved(pair(muscle), [[0.3], [0.3]], 0.2, 600)
    stiffness = muscle.numbers["stiffening"] * (0.6 + muscle.tone)
    work = np.cumsum(torque[1:, 0] * H * (rate[1:, 0] + rate[:-1, 0]) / 2)
    stored = stiffness * ((q[1:, 0] + q[:-1, 0]) / 2) ** 2 / 2
    np.testing.assert_allclose(work[1:] - work[0], stored[0] - stored[1:], atol=1e-9 * stored.max())


SPEEDS = (-1.0, -0.4, -0.05, 0.0, 0.05, 0.3, 0.6, 1.0, 1.7)


@pytest.mark.parametrize("k", [0.15, 0.269])
def test_force_follows_hills_curve(k):
    """At the neutral angle the torque of one muscle is alpha fv(q)."""
    muscle = dataclasses.replace(HILL, curvature=k, damping_time=0.0)
    muscles = build_tree(box_chain(2, "z", muscle)).muscles
    q = np.array(SPEEDS)
    shortening = np.maximum((1 - q) / (1 + q / k), 0.0)
    lengthening = 1.8 - 0.8 * (1 + q) / (1 - 7.56 * q / k)
    expected = np.where(q >= 0, shortening, lengthening)
    one, none = jnp.ones((1, len(q))), jnp.zeros((1, len(q)))
    rate = jnp.array(q / muscle.numbers["slowness"])[None]
    for active, sign in ((jnp.stack([one, none]), 1.0), (jnp.stack([none, one]), -1.0)):
        pull = pull_of(muscles, active, none, sign * rate)
        found = sign * pull.torque(none, sign * rate)[0] / muscle.numbers["strength"]
        np.testing.assert_allclose(found, expected, atol=1e-12)
        assert (pull.damping >= 0).all()


def test_power_of_dogfish_muscle_peaks_at_the_measured_speed():
    """Red muscle of dogfish, k = 0.269: most power at 0.30 vmax (J Exp Biol 205:1585)."""
    q = np.linspace(0.01, 0.99, 99)
    power = q * (1 - q) / (1 + q / 0.269)
    muscles = build_tree(box_chain(2, "z", dataclasses.replace(HILL, curvature=0.269))).muscles
    active = jnp.stack([jnp.ones((1, 99)), jnp.zeros((1, 99))])
    rate = jnp.array(q / HILL.numbers["slowness"])[None]
    pull = pull_of(muscles, active, jnp.zeros((1, 99)), rate)
    found = (
        q
        * ((pull.drive - pull.damping * rate)[0] + HILL.numbers["damping"] * rate[0])
        / HILL.numbers["strength"]
    )
    np.testing.assert_allclose(found, power, atol=1e-12)
    assert q[np.argmax(found)] == pytest.approx(0.30, abs=0.03)


def test_force_falls_away_from_the_optimal_length():
    """fl = exp(-((l - 1) / 0.45)^2), l = 1 - e phi for the first muscle and 1 + e phi else."""
    muscles = build_tree(box_chain(2, "z", HILL)).muscles
    for angle in (-0.6, 0.4):
        q, still = jnp.full((1,), angle), jnp.zeros(1)
        for active, side in ((jnp.array([[1.0], [0.0]]), -1), (jnp.array([[0.0], [1.0]]), 1)):
            drive = pull_of(muscles, active, q, still).drive / HILL.numbers["strength"]
            stretch = side * HILL.arm / HILL.fibre_length * angle
            assert drive[0] == pytest.approx(-side * np.exp(-((stretch / 0.45) ** 2)), abs=1e-12)


def test_metabolic_rate_gives_the_published_values():
    """Minetti and Alexander 1997: Phi(0) = 0.054. Efficiency peaks at 0.50, near q = 0.094."""
    q = jnp.linspace(-1.0, 1.0, 2001)
    rate = np.asarray(metabolic_rate(q))
    assert rate.min() > 0
    assert metabolic_rate(jnp.array(0.0)) == pytest.approx(0.054)
    assert metabolic_rate(jnp.array(0.3)) == pytest.approx(0.242, abs=5e-4)
    q, rate = q[q >= 0], rate[q >= 0]
    efficiency = np.asarray(q * (1 - q) / (1 + q / 0.25)) / rate
    assert efficiency.max() == pytest.approx(0.50, abs=0.005)
    assert q[efficiency.argmax()] == pytest.approx(0.094, abs=0.002)


def test_an_isometric_contraction_costs_energy_without_work():
    _, _, _, energy = moved(pair(EKEBERG), [[0.5], [0.5]], 0.0, 3)
    world = pair(EKEBERG)
    idle = dataclasses.replace(world, tree=world.tree.without_motors(np.ones(1, bool)))
    np.testing.assert_array_equal(moved(idle, [[0.5], [0.5]], 0.0, 3)[3], 0.0)
    power = 1e-3 * 2e5 * 5.0 * 0.1
    assert energy[-1] == pytest.approx(H * power * 0.054, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("hill", "damping_time"), [(True, 0.0), (False, 0.01)])
def test_random_activation_is_stable_at_the_shipped_step(hill, damping_time):
    """The muscles are about 1e5 times as strong as these light bodies need."""
    muscle = dataclasses.replace(HILL, hill=hill, damping_time=damping_time, area=1e-2)
    world = in_water(box_chain(5, "z", muscle, (0.02, 0.01, 0.01), 0.002))
    rng = np.random.default_rng(0)
    active = jnp.asarray(rng.uniform(0, 1, (60, 2, 4, 8)), jnp.float32)

    active = jnp.repeat(active, 4, 0)
    command = MotorCommand(jnp.zeros((240, 4, 8), jnp.float32), activation=active)
    states, _ = rolled(world, resting_state(world.tree, (8,), jnp.float32), command, H)
    q, rate = states.q, states.qd
    assert np.isfinite(rate).all()
    # Muscles hold at most their bend, and may overshoot it a little.
    assert np.abs(q).max() < 1.1 * np.deg2rad(muscle.bend_deg)
    assert np.abs(rate).max() < 1.5 * np.deg2rad(muscle.bend_deg) / H


def test_mirrored_activation_gives_the_mirrored_motion():
    one = moved(pair(HILL, 3), [[0.9, 0.1], [0.2, 0.4]], 0.1, 60)
    other = moved(pair(HILL, 3), [[0.2, 0.4], [0.9, 0.1]], -0.1, 60)
    for left, right in zip(one[:3], other[:3], strict=True):
        np.testing.assert_allclose(left, -right, atol=1e-12)
    np.testing.assert_allclose(one[3], other[3], rtol=1e-12)


@pytest.mark.parametrize("hill", [pytest.param(False, marks=pytest.mark.slow), True])
@pytest.mark.slow
def test_gradients_through_muscles_equal_central_differences(hill):
    world = pair(dataclasses.replace(HILL, hill=hill))
    names = ["strength", "stiffening", "damping"] + ["strain", "slowness", "curvature"] * hill

    def swing(numbers):
        active, *own = numbers
        changed = eqx.tree_at(
            lambda w: [getattr(w.tree.muscles, name) for name in names],
            world,
            [jnp.atleast_1d(x) for x in own],
        )

        def advance(s, n):
            wave = jnp.sin(0.3 * n)
            both = active * jnp.stack([jnp.maximum(wave, 0.0), jnp.maximum(-wave, 0.0)])[:, None]
            s, effort = step(changed, s, MotorCommand(jnp.zeros(1), activation=both), H)
            return s, effort.energy

        state, energy = jax.lax.scan(
            advance, resting_state(world.tree, (), jnp.float64), jnp.arange(30)
        )
        return jnp.stack([state.q[0], energy.sum()])

    numbers = np.array([0.7, *(getattr(world.tree.muscles, name)[0] for name in names)])
    slopes = quick_jit(jax.jacrev(swing))(jnp.asarray(numbers))
    forward, run = quick_jit(jax.jacfwd(swing))(jnp.asarray(numbers)), quick_jit(swing)
    for i, number in enumerate(numbers):
        away = 1e-5 * number * (np.arange(len(numbers)) == i)
        difference = (run(numbers + away) - run(numbers - away)) / (2e-5 * number)
        np.testing.assert_allclose(slopes[:, i], difference, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(forward[:, i], difference, rtol=1e-6, atol=1e-9)


def test_motors_and_muscles_mix_in_one_creature():
    """A muscle holds its bend while the motor beside it turns at its commanded rate."""
    chain = box_chain(3, "z", EKEBERG, SIZE)
    last = chain.bodies[2]
    joint = dataclasses.replace(last.joint, actuator=Actuator(5.0))
    chain = dataclasses.replace(
        chain, bodies=(*chain.bodies[:2], dataclasses.replace(last, joint=joint))
    )
    world = World(build_tree(chain), 0.0)
    state = resting_state(world.tree, (), jnp.float64)
    active = jnp.array([[1.0, 1.0], [0.0, 0.0]])
    command = MotorCommand(jnp.array([3.0, 0.05]), activation=active)
    move = quick_jit(lambda s: step(world, s, command, H)[0])
    for _ in range(240):
        state = move(state)
    assert state.q[0] == pytest.approx(np.deg2rad(EKEBERG.bend_deg), abs=1e-3)
    assert state.qd[1] == pytest.approx(0.05, abs=1e-3)


@pytest.mark.slow
def test_energy_balance_of_a_swimming_chain_closes():
    """The work of muscles and water is the change of energy, to second order in the step."""
    world = in_water(box_chain(3, "z", dataclasses.replace(HILL, area=3e-3), SIZE), gravity=0.0)
    missing = []
    for h in (1 / 240, 1 / 480):

        def command(time):
            wave = 0.5 * jnp.sin(12.0 * time - jnp.arange(2.0))
            both = jnp.stack([jnp.maximum(wave, 0.0), jnp.maximum(-wave, 0.0)])
            return MotorCommand(jnp.zeros(2), activation=both)

        start = resting_state(world.tree, (), jnp.float64)
        balance, _ = driven.balance(world, start, command, round(0.5 / h), h)
        missing.append(np.abs(balance.left_over).sum() / balance.effort)
    assert balance.motors.sum() > 0
    assert missing[1] < 1e-3
    assert missing[1] < 0.35 * missing[0]
