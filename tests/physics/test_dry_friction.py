"""Dry friction of joints against closed forms: slowing, sticking, sliding, lost energy."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import hinge
from evo_cpg.creature.creature import NO_LIMIT, Body, Creature, Material, TorqueMotor
from evo_cpg.creature.shapes import Box
from evo_cpg.creature.tree import build_tree
from evo_cpg.native.jax_internals import quick_jit
from evo_cpg.physics.step.step import step
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.joint_torque import MotorCommand
from evo_cpg.physics.tree.state import resting_state

pytestmark = pytest.mark.usefixtures("x64")

H = 1 / 120
LOSS = 0.4


def wheel(armature: float = 0.0) -> tuple[World, float]:
    """Return a wheel on the centre of a free hub, and the inertia that its motor sees, kg m^2."""
    material, hub, rim = Material(1000.0), Box((0.2, 0.2, 0.2)), Box((0.3, 0.3, 0.02))
    given = {"armature": armature, "actuator": TorqueMotor(), "friction_loss": LOSS}
    joint = hinge("hub", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), limit=NO_LIMIT, **given)
    bodies = Body("hub", hub, material), Body("wheel", rim, material, joint)
    inertias = [body.shape.inertia(body.mass)[2, 2] for body in bodies]
    alone = 1 / (1 / inertias[0] + 1 / inertias[1])
    return World(build_tree(Creature("wheel", bodies)), 0.0), float(alone + armature)


def moved(world: World, torque: float, rate: float, count: int):
    """Return angles and rates of a motion under a constant torque."""
    command = MotorCommand(jnp.zeros(1), torque=jnp.array([torque]))

    @quick_jit
    def motion(state):
        def advance(carry, _):
            s, warmstart = carry
            s, effort = step(world, s, command, H, warmstart)
            return (s, effort.warmstart), (s.q[0], s.qd[0])

        first = step(world, state, command, H)
        rest = (first[0], first[1].warmstart)
        return (first[0].q[0], first[0].qd[0]), jax.lax.scan(advance, rest, None, count - 1)[1]

    start = dataclasses.replace(resting_state(world.tree, (), jnp.float64), qd=jnp.array([rate]))
    first, rest = jax.tree.map(np.atleast_1d, motion(start))
    return [np.concatenate(pair) for pair in zip(first, rest, strict=True)]


@pytest.mark.parametrize("armature", [pytest.param(0.0, marks=pytest.mark.slow), 0.02])
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
def test_a_torque_above_the_loss_accelerates_by_the_rest(sign):
    world, inertia = wheel()
    _, qd = moved(world, sign * 1.5 * LOSS, 0.0, 60)
    np.testing.assert_allclose(qd[-1], sign * 0.5 * LOSS / inertia * 60 * H, rtol=1e-9)
