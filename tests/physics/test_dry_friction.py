"""Dry friction of joints against closed forms: slowing, sticking, sliding, lost energy."""

import jax.numpy as jnp
import numpy as np
import pytest

import driven
from evo_cpg.creature.creature import TorqueMotor
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.joint_torque import MotorCommand

pytestmark = pytest.mark.usefixtures("x64")

H = 1 / 120
LOSS = 0.4


def wheel(armature: float = 0.0) -> tuple[World, float]:
    """Return a wheel with dry friction, and the inertia that its motor sees, kg m^2."""
    return driven.wheels(TorqueMotor(), armature=armature, friction_loss=LOSS)


def moved(world: World, torque: float, rate: float, count: int):
    """Return angles and rates of a motion under a constant torque."""
    command = MotorCommand(jnp.zeros(1), torque=jnp.array([torque]))
    return (column[:, 0] for column in driven.moved(world, command, count, H, rate=rate)[:2])


@pytest.mark.parametrize("armature", [pytest.param(0.0, marks=pytest.mark.slow), 0.02])
@pytest.mark.slow
def test_a_coasting_wheel_slows_steadily_and_stops(armature):
    """Rate w - F t / I until it stops at w I / F, after an angle of I w^2 / 2 F."""
    world, inertia = wheel(armature)
    rate = 80.5 * H * LOSS / inertia
    q, qd = moved(world, 0.0, rate, 120)
    time = H * np.arange(1, 81)
    np.testing.assert_allclose(qd[:80], rate - LOSS / inertia * time, rtol=1e-9)
    assert np.abs(qd[81:]).max() < 1e-3 * H * LOSS / inertia
    # The angles are sums over steps, so they differ by half of the largest rate times a step.
    assert q[-1] == pytest.approx(inertia * rate**2 / (2 * LOSS), abs=0.51 * rate * H)


def test_a_torque_below_the_loss_moves_nothing():
    """It creeps by a thousandth of the free acceleration in a step."""
    world, inertia = wheel()
    torque = 0.9 * LOSS
    q, qd = moved(world, torque, 0.0, 120)
    np.testing.assert_allclose(qd[-1], torque / inertia * H / 1000, rtol=1e-6)
    assert q[-1] == pytest.approx(torque / inertia * H / 1000, rel=0.01)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.slow
def test_a_torque_above_the_loss_accelerates_by_the_rest(sign):
    world, inertia = wheel()
    _, qd = moved(world, sign * 1.5 * LOSS, 0.0, 60)
    np.testing.assert_allclose(qd[-1], sign * 0.5 * LOSS / inertia * 60 * H, rtol=1e-9)
