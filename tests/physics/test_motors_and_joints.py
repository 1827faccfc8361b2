"""Torque limits, soft joint limits and springs."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array

from creatures import (
    STRUCTURES,
    box_chain,
    hinge,
    in_water,
    quick_jit,
    random_creature,
    random_state,
    resting,
    rolled,
)
from evo_cpg.analysis.energy import mechanical_energy
from evo_cpg.creature.creature import NO_LIMIT, Actuator, Body, Creature, Material, TorqueMotor
from evo_cpg.creature.laws import LIMIT_FREQUENCY
from evo_cpg.creature.shapes import Box, Capsule, Sphere
from evo_cpg.creature.tree import build_tree
from evo_cpg.physics.step.step import step
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.joint_torque import MotorCommand
from evo_cpg.physics.tree.state import resting_state
from evo_cpg.simulation.snapshot import Snapshot

H = 1 / 120
INDIVIDUALS, STEPS = 64, 200
SERVO_GAIN, TORQUE_LIMIT = 20.0, 0.3


@pytest.fixture(scope="module")
def thrashing():
    """Return steps of 64 random individuals with weak motors and random targets in every step."""
    with jax.enable_x64(True):
        rng = np.random.default_rng(3)
        motor = Actuator(SERVO_GAIN, TORQUE_LIMIT)
        creature = random_creature(rng, STRUCTURES[1], limits=1.5, motor=motor, axes_seed=1)
        world = in_water(creature)
        state = random_state(world.tree, rng, (INDIVIDUALS,))
        size = (STEPS, world.tree.dof_count, INDIVIDUALS)
        targets = jnp.asarray(rng.normal(size=size) * 10.0 ** rng.uniform(-2, 1, size))
        states, effort = rolled(world, state, targets, H)
        before = jnp.concatenate([state.qd[None], states.qd[:-1]])
        return before, states, effort, targets


@pytest.mark.slow
def test_torque_never_exceeds_its_limit(thrashing):
    """The limit holds to the last bit in 200 steps of 64 individuals, and is often reached."""
    _, states, effort, _ = thrashing
    torque = np.abs(np.asarray(effort.torque))
    assert torque.max() == TORQUE_LIMIT
    assert 0.2 < (torque == TORQUE_LIMIT).mean() < 1.0
    assert np.isfinite(np.asarray(states.q)).all()


def test_torque_is_the_clipped_law_at_the_final_rate(thrashing):
    """tau = clip(g (target - qd+)) within 1 % of the limit, for all but 1 in 200 torques.

    The iterations solve a piecewise linear equation. A few torques of light limbs have not
    converged after the last one, because random targets of up to 50 rad/s change in every step.
    """
    _, states, effort, targets = thrashing
    law = np.clip(SERVO_GAIN * np.asarray(targets - states.qd), -TORQUE_LIMIT, TORQUE_LIMIT)
    residual = np.abs(np.asarray(effort.torque) - law) / TORQUE_LIMIT
    assert (residual > 0.01).mean() < 0.005


def test_energy_is_the_work_of_the_applied_torque(thrashing):
    """E = h |tau (qd + qd+) / 2|, the trapezoidal rule with the applied torque."""
    before, states, effort, _ = thrashing
    expected = H * np.abs(effort.torque * (before + states.qd) / 2).sum(1)
    np.testing.assert_allclose(effort.energy, expected, rtol=1e-12, atol=1e-15)


@pytest.mark.slow
def test_a_limit_that_is_not_reached_changes_nothing():
    """An individual below its limits moves as without limits.

    Its neighbours in the batch are overloaded.
    """
    targets = jnp.asarray(np.tile([[0.01, 0.02, 100.0]], (20, 2, 1)))
    results = []
    for limit in (np.inf, 0.05):
        world = in_water(box_chain(3, "z", Actuator(0.5, limit)))
        states, effort = rolled(world, resting_state(world.tree, (3,), jnp.float64), targets, H)
        results.append((states, effort.torque))
    free, limited = results
    for unlimited, tight in zip(jax.tree.leaves(free), jax.tree.leaves(limited), strict=True):
        # A separate solve applies the torques, and it rounds differently.
        np.testing.assert_allclose(unlimited[..., :2], tight[..., :2], rtol=0, atol=1e-14)
    assert np.abs(free[1][..., 2]).max() > 10 * np.abs(limited[1][..., 2]).max()


def spring_pair(
    stiffness: float, damping: float = 0.0, limits: float = 9.0, motor=None, rotor: float = 0.0
) -> Creature:
    """Return two boxes with a common centre that turn against each other about z."""
    material = Material(1000.0)
    given = {"stiffness": stiffness, "damping": damping, "armature": rotor, "actuator": motor}
    joint = hinge("a", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), limit=limits, **given)
    bodies = (
        Body("a", Box((0.3, 0.1, 0.1)), material),
        Body("b", Box((0.2, 0.1, 0.05)), material, joint),
    )
    return Creature("pair", bodies)


def reduced_inertia(creature: Creature) -> float:
    """Return I_a I_b / (I_a + I_b), the inertia of their relative rotation."""
    first, second = (
        b.shape.inertia(b.material.density * b.shape.volume)[2, 2] for b in creature.bodies
    )
    return first * second / (first + second)


@pytest.mark.parametrize("damping", [pytest.param(0.0, marks=pytest.mark.slow), 0.003])
def test_spring_is_the_implicit_euler_oscillator(damping):
    """A spring and damper step by backward Euler: (q, qd)+ = (1 - h A)^-1 (q, qd).

    A = [[0, 1], [-k/I, -c/I]] with I = I_a I_b / (I_a + I_b). 100 steps agree to rounding.
    """
    stiffness, start = 2.0, 0.3
    creature = spring_pair(stiffness, damping)
    inertia = reduced_inertia(creature)
    world = World(build_tree(creature), 0.0)
    state = resting(world.tree, q=jnp.array([start]))
    states, _ = rolled(world, state, jnp.zeros((100, 1)), H)
    rate = np.array([[0.0, 1.0], [-stiffness / inertia, -damping / inertia]])
    expected = [np.array([start, 0.0])]
    for _ in range(100):
        expected.append(np.linalg.solve(np.eye(2) - H * rate, expected[-1]))
    ours = np.concatenate([states.q, states.qd], 1)
    np.testing.assert_allclose(ours, expected[1:], atol=1e-11 * np.abs(expected).max())


@pytest.mark.slow
def test_a_spring_rests_at_its_angle_and_an_axis_without_limits_turns_on():
    """A damped spring comes to rest at its angle, and a rotor beside it keeps its rate."""
    two = box_chain(3, "z")
    first, second = two.bodies[1].joint, two.bodies[2].joint
    assert first is not None and second is not None
    sprung = dataclasses.replace(first, stiffness=4.0, damping=1.0, rest=0.4)
    free = {"lower": (-NO_LIMIT,), "upper": (NO_LIMIT,), "child_anchor": (0.0, 0.0, 0.0)}
    spun = dataclasses.replace(second, **free)
    bodies = [dataclasses.replace(two.bodies[1], joint=sprung)]
    with jax.enable_x64(True):
        world = World(build_tree(dataclasses.replace(two, bodies=(two.bodies[0], *bodies))), 0.0)
        states, _ = rolled(world, resting_state(world.tree, (), float), jnp.zeros((2400, 1)), H)
        assert states.q[-1, 0] == pytest.approx(0.4, abs=1e-6)
        still = Snapshot(world, H, jax.tree.map(lambda x: x[-1], states))
        assert float(mechanical_energy(still)) < 1e-9
        bodies = [dataclasses.replace(two.bodies[1], joint=dataclasses.replace(spun, parent="b0"))]
        world = World(build_tree(dataclasses.replace(two, bodies=(two.bodies[0], *bodies))), 0.0)
        start = resting(world.tree, qd=jnp.array([20.0]))
        states, _ = rolled(world, start, jnp.zeros((120, 1)), H)
        np.testing.assert_allclose(states.qd[:, 0], 20.0, rtol=1e-9)


@pytest.mark.parametrize("gain", [pytest.param(1e-4, marks=pytest.mark.slow), 0.05])
def test_soft_limit_holds_a_constant_push(gain):
    """A joint under a constant torque tau rests tau / k beyond a limit of stiffness k.

    k = I w^2 + g w with w = 2 pi 10 Hz, the reduced inertia I and the motor's gain g. The damping
    is c = 2 I w. A damped spring of ratio z = c / 2 sqrt(I k), at rest at the limit, overshoots by
    exp(-pi z / sqrt(1 - z^2)). The implicit step overshoots less.
    """
    limits, push = 0.5, 0.4
    creature = spring_pair(0.0, limits=limits, motor=Actuator(gain, push))
    world = World(build_tree(creature), 0.0)
    inertia, rate = reduced_inertia(creature), 2 * np.pi * LIMIT_FREQUENCY
    stiffness = inertia * rate**2 + gain * rate
    np.testing.assert_allclose(world.tree.limit_stiffness, stiffness, rtol=1e-12)
    ratio = np.sqrt(inertia * rate**2 / stiffness)
    overshoot = np.exp(-np.pi * ratio / np.sqrt(1 - ratio**2))
    state = resting(world.tree, q=jnp.array([limits]))
    states, effort = rolled(world, state, jnp.full((240, 1), 1e6), H)
    np.testing.assert_array_equal(effort.torque, push)
    beyond = np.asarray(states.q)[:, 0] - limits
    assert beyond[-1] == pytest.approx(push / stiffness, rel=1e-6)
    assert beyond.max() < (1 + overshoot) * push / stiffness


def test_soft_limit_balances_its_own_motor():
    """A servo with a reference of 1 rad/s rests g / (I w^2 + g w) < 0.016 rad beyond its limit.

    The bound 1 / w holds for any gain. The gain here is a thousand times I w.
    """
    limits, rate = 0.5, 2 * np.pi * LIMIT_FREQUENCY
    weak = spring_pair(0.0)
    gain = 1e3 * reduced_inertia(weak) * rate
    creature = spring_pair(0.0, limits=limits, motor=Actuator(gain))
    world = World(build_tree(creature), 0.0)
    state = resting_state(world.tree, dtype=jnp.float64)
    states, _ = rolled(world, state, jnp.ones((240, 1)), H)
    beyond = np.asarray(states.q)[-1, 0] - limits
    expected = gain / (reduced_inertia(creature) * rate**2 + gain * rate)
    assert beyond == pytest.approx(expected, rel=1e-6)
    assert np.asarray(states.q).max() - limits < 1 / rate


@pytest.mark.parametrize("rotor", [0.0, 1.0])
def test_soft_limit_stops_a_swing(rotor):
    """A joint that reaches its limit at speed v passes it by v / (e w), with or without a rotor.

    This is the peak of a critically damped spring, v t exp(-w t) at t = 1/w. The spring returns at
    v / e^2 at most, at t = 2/w. The rotor here has 280 times the inertia of the boxes.
    """
    limits, speed, h = 0.5, 6.0, 1 / 9600
    creature = spring_pair(0.0, limits=limits, rotor=rotor)
    beyond, rate = at_the_limit(creature, speed, h)
    peak = speed / (np.e * 2 * np.pi * LIMIT_FREQUENCY)
    assert beyond.max() == pytest.approx(peak, rel=0.01)
    assert 0 < -rate.min() < 1.01 * speed / np.e**2


@pytest.mark.parametrize(
    "gear", [0.02, *(pytest.param(gear, marks=pytest.mark.slow) for gear in (1.0, 50.0))]
)
def test_soft_limit_of_a_torque_motor_does_not_bounce(gear):
    """The stiffness that balances the motor has a damper. The joint keeps at most v / e^2."""
    speed = 6.0
    creature = spring_pair(0.0, limits=0.5, motor=TorqueMotor(gear))
    beyond, rate = at_the_limit(creature, speed, 1 / 9600)
    assert 0 < beyond.max() < speed / (np.e * 2 * np.pi * LIMIT_FREQUENCY)
    assert -rate.min() < speed / np.e**2


def at_the_limit(creature: Creature, speed: float, h: float):
    """Return angles beyond the limit and rates of a joint that reaches its limit at a speed."""
    world = World(build_tree(creature), 0.0)
    limit = float(world.tree.upper[0])
    state = resting(world.tree, q=jnp.array([limit]), qd=jnp.array([speed]))
    states, _ = rolled(world, state, jnp.zeros((round(0.1 / h), 1)), h)
    return np.asarray(states.q)[:, 0] - limit, np.asarray(states.qd)[:, 0]


def two_boxes(**joint) -> World:
    """Return two equal boxes that turn against each other about z, in vacuum without gravity."""
    box = Box((0.2, 0.1, 0.1))
    joint = hinge("a", (0.1, 0, 0), (-0.1, 0, 0), limit=9.0, **joint)
    material = Material(500.0)
    creature = Creature("pair", (Body("a", box, material), Body("b", box, material, joint)))
    return World(build_tree(creature), 0.0)


@pytest.mark.slow
def test_a_neutral_dashpot_equals_a_passive_spring_and_damper(x64):
    """Both move equally. The dense equation of the step tests other target angles."""
    dashpot = two_boxes(actuator=Actuator(0.05, stiffness=3.0))
    passive = two_boxes(stiffness=3.0, damping=0.05)

    def angles(world: World, target: Array | None):
        state = resting(world.tree, q=jnp.array([-0.4]))
        command = MotorCommand(jnp.zeros((200, 1)), target)
        return rolled(world, state, command, H)[0].q[:, 0]

    moved = angles(dashpot, jnp.zeros((200, 1)))
    assert moved.max() > 0.05  # The boxes swing.
    np.testing.assert_allclose(moved, angles(passive, None), atol=1e-12)
    np.testing.assert_array_equal(moved, angles(dashpot, None))


def test_an_overloaded_dashpot_applies_its_limit(x64):
    """The torque is the limit at angles far from the target, and it accelerates the boxes.

    In the straight pose the hinge moves sideways and the centres of mass do not move. So each box
    turns with half of the joint's acceleration against its own inertia I: qdd = 2 tau / I.
    """
    limit, count = 0.02, 10
    world = two_boxes(actuator=Actuator(0.05, limit, stiffness=300.0))
    state = resting_state(world.tree, dtype=jnp.float64)

    command = MotorCommand(jnp.zeros((count, 1)), jnp.full((count, 1), 2.0))
    states, effort = rolled(world, state, command, H)
    rate, torque = states.qd[:, 0], effort.torque
    np.testing.assert_array_equal(torque, limit)
    mass = 500.0 * 0.2 * 0.1 * 0.1
    inertia = mass * (0.2**2 + 0.1**2) / 12
    fitted = np.polyfit(H * np.arange(1, count + 1), rate, 1)[0]
    assert fitted == pytest.approx(2 * limit / inertia, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("limit", [25.0, 2.5])
def test_a_limited_motor_adds_only_its_work(limit, x64):
    """The leg also turns about its length, where its inertia is small.

    Torques held at their limits would accelerate it to 1400 rad/s in one step. The velocity
    products at that rate would add energy.
    """
    motor = Actuator(0.08 * limit, limit, 3.2 * limit)
    most = np.deg2rad(50)
    joint = hinge("hub", (0.12, 0, 0), (-0.17, 0, 0), "xyz", most, actuator=motor)
    wood = Material(400.0)
    bodies = Body("hub", Sphere(0.12), wood), Body("leg", Capsule(0.025, 0.3), wood, joint)
    world = World(build_tree(Creature("one leg", bodies)), 0.0)
    h, hold, holds, count = 1 / 240, 36, 10, 16
    angles = jnp.asarray(np.random.default_rng(0).uniform(-most, most, (holds, 3, count)))

    @quick_jit
    def run(state):
        def advance(s, k):
            new, effort = step(world, s, MotorCommand(jnp.zeros_like(s.q), angles[k // hold]), h)
            work = h * (effort.torque * 0.5 * (s.qd + new.qd)).sum(0)
            return new, (mechanical_energy(Snapshot(world, h, new)), work, jnp.abs(new.qd).max(0))

        return jax.lax.scan(advance, state, jnp.arange(holds * hold))[1]

    energy, work, rate = map(np.asarray, run(resting_state(world.tree, (count,), jnp.float64)))
    assert rate.max() < 80
    extra = energy - np.cumsum(work, 0)
    rise = (extra - np.minimum.accumulate(extra)).max()
    assert energy.max() > 1.0 and rise < 0.25 * energy.max()


@pytest.mark.slow
def test_a_joint_without_a_motor_keeps_second_order(x64):
    """Another joint has a limited motor within its limit. The step stays of second order."""
    chain = box_chain(3, "z", Actuator(0.5, 5.0))
    loose = dataclasses.replace(chain.bodies[2].joint, actuator=None)
    bodies = (*chain.bodies[:2], dataclasses.replace(chain.bodies[2], joint=loose))
    world = World(build_tree(dataclasses.replace(chain, bodies=bodies)), 0.0)
    free = dataclasses.replace(
        world, tree=dataclasses.replace(world.tree, torque_limit=np.inf * np.ones(2))
    )
    state = random_state(world.tree, np.random.default_rng(2), (INDIVIDUALS,))
    target = jnp.zeros((2, INDIVIDUALS))
    limited, unlimited = (
        quick_jit(lambda s, t, w=w: step(w, s, t, H)[0])(state, target) for w in (world, free)
    )
    np.testing.assert_allclose(limited.qd, unlimited.qd, rtol=1e-9, atol=1e-9)
