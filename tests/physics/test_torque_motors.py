"""Torque motors against closed forms: speed, limit, work, and a joint that stays free."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import driven
from creatures import box_chain
from driven import wheels
from evo_cpg.creature.creature import Actuator, TorqueMotor
from evo_cpg.creature.tree import build_tree
from evo_cpg.physics.step.step import step
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.joint_torque import MotorCommand
from evo_cpg.physics.tree.state import resting_state

pytestmark = pytest.mark.usefixtures("x64")

H = 1 / 120


def moved(world: World, torque, count: int, rate: float = 0.0):
    """Return angles, rates, torques and energies under a constant command, steps first."""
    rest = jnp.zeros(world.tree.dof_count)
    command = MotorCommand(rest, torque=None if torque is None else jnp.asarray(torque))
    return driven.moved(world, command, count, H, rate=rate)


@pytest.mark.parametrize(("limit", "expected"), [(np.inf, -0.7), (0.3, -0.3)])
def test_a_constant_torque_gives_a_constant_acceleration(limit, expected):
    """Rate tau t / I, work of the motor I rate^2 / 2."""
    world, inertia = wheels(TorqueMotor(2.0, limit))
    _, rate, torque, energy = moved(world, [-0.7], 60)
    np.testing.assert_allclose(torque, expected, rtol=1e-12)
    np.testing.assert_allclose(rate[-1], expected * 60 * H / inertia, rtol=1e-11)
    assert energy.sum() == pytest.approx(inertia * rate[-1, 0] ** 2 / 2, rel=1e-11)


def test_a_free_torque_motor_does_not_brake():
    world, _ = wheels(TorqueMotor())
    for torque in (None, [0.0]):
        _, rate, applied, energy = moved(world, torque, 60, rate=5.0)
        np.testing.assert_allclose(rate, 5.0, rtol=1e-12)
        assert np.abs(applied).max() == 0 and energy.sum() == 0


@pytest.mark.slow
def test_torque_motors_work_beside_limited_servos():
    """A second wheel stands still on its servo's limit: the step has to be iterated."""
    world, _ = wheels(TorqueMotor(1.0, 0.5), Actuator(5.0, 0.2), None)
    rest = jnp.zeros(3)
    command = MotorCommand(rest.at[1].set(100.0), torque=rest + 9.0)
    one = resting_state(world.tree, (), jnp.float64)
    later, effort = step(world, one, command, H)
    np.testing.assert_allclose(effort.torque, [0.5, 0.2, 0.0], rtol=1e-12)
    spins = later.qd + later.angular_velocity[2]
    own = world.tree.inertia[2, 2, 1:]
    np.testing.assert_allclose(spins * own, np.array([0.5, 0.2, 0.0]) * H, atol=1e-12)


@pytest.mark.slow
def test_gradients_pass_a_torque():
    world, inertia = wheels(TorqueMotor())

    def speed(torque):
        start = resting_state(world.tree, (), jnp.float64)
        return step(world, start, MotorCommand(jnp.zeros(1), torque=torque[None]), H)[0].qd[0]

    assert jax.grad(speed)(jnp.float64(0.3)) == pytest.approx(H / inertia, rel=1e-11)


def test_a_limit_holds_the_full_torque_of_its_motor():
    """The stiffness of a limit grows by the full torque over 1 / (2 pi 10) rad."""
    weak = build_tree(box_chain(2, "z"))
    for motor, push in ((TorqueMotor(3.0), 3.0), (TorqueMotor(-3.0, 2.0), 2.0)):
        strong = build_tree(box_chain(2, "z", motor))
        np.testing.assert_allclose(
            strong.limit_stiffness - weak.limit_stiffness, push * 2 * np.pi * 10
        )


def test_a_tree_loses_the_torque_of_some_axes():
    tree = wheels(TorqueMotor(1.0), Actuator(5.0, 0.2), None)[0].tree
    idle = tree.without_motors(np.ones(3, bool))
    np.testing.assert_array_equal(idle.torque_limit, [0.0, 0.2, 0.0])
    same = tree.without_motors(np.zeros(3, bool))
    np.testing.assert_array_equal(same.torque_limit, tree.torque_limit)
