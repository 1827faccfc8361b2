"""Fixed tendons: accelerations of MuJoCo, closed forms of limits, friction and energy."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import driven
from creatures import STRUCTURES, box_chain, hinge, quick_jit, random_creature, random_state, slope
from evo_cpg.creature.creature import (
    NO_LIMIT,
    Actuator,
    Body,
    Creature,
    Material,
    Tendon,
    TorqueMotor,
)
from evo_cpg.creature.shapes import Box
from evo_cpg.creature.tree import build_tree
from evo_cpg.io.models.mjcf_export import mjcf_model, mjcf_text
from evo_cpg.io.models.mujoco_state import dof_order, load_state, motor_order
from evo_cpg.physics.step.equations import prepare, solve_at_once
from evo_cpg.physics.step.statics import joint_torque
from evo_cpg.physics.step.step import step
from evo_cpg.physics.step.step_problem import StepProblem
from evo_cpg.physics.step.step_solver import free_motion
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.joint_torque import MotorCommand
from evo_cpg.physics.tree.state import resting_state

pytestmark = pytest.mark.usefixtures("x64")

GRAVITY, H = 9.81, 1 / 120


def pulled() -> Creature:
    """Return a branching animal with tendons between its limbs, a motor on each tendon."""
    creature = random_creature(np.random.default_rng(1), STRUCTURES[2], axes_seed=2)
    names = build_tree(creature).dof_names
    motors = (Actuator(0.7), Actuator(0.5, 1.2, 2.0), TorqueMotor(-3.0, 1.5), None)
    tendons = []
    for number, motor in enumerate(motors):
        spanned = (number, (number + 2) % len(names), len(names) - 1 - number)
        joints = {names[dof]: c for dof, c in zip(spanned, (0.8, -1.3, 0.4), strict=True)}
        rest = (-0.5, 0.7) if number == 1 else (0.3, 0.3)
        # MuJoCo's mass matrix has no place for a rotor that couples two limbs.
        rotor = 0.02 if number == 2 else 0.0
        values = {"stiffness": 2.0 + number, "damping": 0.3, "armature": rotor}
        tendons.append(
            Tendon(f"t{number}", tuple(joints.items()), rest=rest, actuator=motor, **values)
        )
    return dataclasses.replace(creature, tendons=tuple(tendons))


@pytest.mark.slow
def test_tendons_accelerate_as_in_mujoco():
    """Springs, dead bands, dampers, rotors, motors below and at limits, sliding friction: 1e-9.

    Joints and tendons with friction are compared in steady sliding. MuJoCo's soft friction may push
    onwards in nearly sticking ones.
    """
    creature = pulled()
    first = creature.bodies[1]
    rubbed = dataclasses.replace(first, joint=dataclasses.replace(first.joint, friction_loss=0.2))
    tendons = [dataclasses.replace(tendon, friction_loss=0.1) for tendon in creature.tendons]
    bodies = creature.bodies[0], rubbed, *creature.bodies[2:]
    creature = dataclasses.replace(creature, bodies=bodies, tendons=tuple(tendons))
    tree = build_tree(creature)
    free = dataclasses.replace(
        tree, tendons=dataclasses.replace(tree.tendons, torque_limit=np.full(4, np.inf))
    )
    model = mujoco.MjModel.from_xml_string(mjcf_text(mjcf_model(creature, GRAVITY)))
    data, order, motors = mujoco.MjData(model), dof_order(model, tree), motor_order(model, tree)

    @quick_jit
    def ours(state, command):
        at_once, iterated = World(free, GRAVITY), World(tree, GRAVITY)
        # Motors reach their limits at the end of a step. With so short a step the end is the start,
        # except for rounding. A step of 0 would divide by 0.
        h = 1e-13
        first = solve_at_once(at_once, 0.0, prepare(at_once, 0.0, state, command))
        problem = StepProblem.of(iterated, h, prepare(iterated, h, state, command))
        return jnp.concatenate(first), free_motion(problem)

    rng, channels = np.random.default_rng(3), np.array(tree.tendons.channels)
    over, slid = 0, 0
    for _ in range(100):
        state = random_state(tree, rng)
        target = rng.normal(scale=2.0, size=tree.dof_count)
        rate = np.where(np.arange(tree.dof_count) == channels[1], 0.0, target)
        found = ours(state, MotorCommand(rate, target, torque=target))
        rotation = load_state(model, data, tree, state)
        controls = np.concatenate([target, [target[channels[0]], target[channels[1]], 0, 0]])
        controls[tree.dof_count + 2] = target[channels[2]] / -3.0
        data.ctrl = controls[motors]
        for limited, mine in zip((False, True), found, strict=True):
            model.opt.disableflags = 0 if limited else mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS
            model.actuator_forcelimited[:] = limited * np.isfinite(tree.tendons.torque_limit[:3])
            mujoco.mj_forward(model, data)
            theirs = [rotation @ data.qacc[3:6], data.qacc[:3], data.qacc[6 + order]]
            theirs = np.concatenate(theirs)
            if limited and (data.efc_force * data.efc_vel > 0).any():
                continue
            assert np.abs(mine - theirs).max() < 1e-9 * np.abs(theirs).max()
            slid += limited
        limits = model.actuator_forcerange[:, 1]
        over += int(((np.abs(data.actuator_force) == limits) & (limits > 0)).sum())
    assert over > 20 and slid > 20


def wheels(tendon: Tendon, motor: TorqueMotor | None = None, **values) -> World:
    """Return two like wheels on the centre of a heavy hub, with a tendon."""
    hub, rim = Box((0.2, 0.2, 0.2)), Box((0.3, 0.3, 0.02))
    centre = (0.0, 0.0, 0.0)
    joint = hinge("hub", centre, centre, limit=NO_LIMIT, actuator=motor, **values)
    water = Material(1000.0)
    bodies = [Body(name, rim, water, joint) for name in ("one", "two")]
    whole = Creature("wheels", (Body("hub", hub, water), *bodies), tendons=(tendon,))
    return World(build_tree(whole), 0.0)


@pytest.mark.parametrize("limit", [np.inf, 100.0])
def test_a_limit_of_a_tendon_holds_its_motor(limit):
    """Two joints with springs k_i bend by c_i (F - K d) / k_i, d the length beyond the limit."""
    coefficients, stiffness, pull, upper = np.array([1.0, -0.5]), 2.0, 3.0, 0.4
    given = {"lower": -1.0, "upper": upper, "actuator": TorqueMotor(1.0, limit)}
    tendon = Tendon("t", (("one.z", 1.0), ("two.z", -0.5)), **given)
    world = wheels(tendon, stiffness=stiffness, damping=0.3)
    command = MotorCommand(jnp.zeros(2), torque=jnp.array([pull, 0.0]))
    angle, *_ = driven.moved(world, command, 600, H)
    softness = (coefficients**2).sum() / stiffness
    hard = float(world.tree.tendons.limit_stiffness[0])
    length = softness * (pull + hard * upper) / (1 + softness * hard)
    expected = coefficients * (pull - hard * (length - upper)) / stiffness
    assert length > upper
    np.testing.assert_allclose(angle[-1], expected, rtol=1e-9)


@pytest.mark.slow
def test_springs_share_a_tendon_at_rest():
    """L = k r s / (1 + k s), with the rest length r and s the sum of c_i^2 / k_i."""
    coefficients, own, k, rest = np.array([0.7, 1.2]), 2.0, 5.0, 0.6
    joints = (("one.z", 0.7), ("two.z", 1.2))
    tendon = Tendon("t", joints, stiffness=k, damping=0.1, rest=(rest, 2.0))
    world = wheels(tendon, stiffness=own, damping=0.2)
    softness = (coefficients**2).sum() / own
    length = k * rest * softness / (1 + k * softness)
    expected = coefficients * k * (rest - length) / own
    angle, *_ = driven.moved(world, MotorCommand(jnp.zeros(2)), 600, H)
    np.testing.assert_allclose(angle[-1], expected, rtol=1e-9)
    np.testing.assert_allclose(joint_torque(world.tree, jnp.asarray(expected)), 0.0, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(("torque", "expected"), [(0.36, 0.0), (-0.6, -0.2), (0.6, 0.2)])
def test_friction_of_a_tendon_sticks_up_to_its_loss(torque, expected):
    """It resists the difference of two wheels, and not their common turn."""
    world = wheels(Tendon("t", (("one.z", 1.0), ("two.z", -1.0)), friction_loss=0.4), TorqueMotor())
    spin = float(world.tree.inertia[2, 2, 1])
    command = MotorCommand(jnp.zeros(2), torque=jnp.array([0.1 + torque, 0.1 - torque]))
    _, rate, *_ = driven.moved(world, command, 30, H)
    speed = 30 * H / spin
    apart, hub = (rate[-1, 0] - rate[-1, 1]) / 2, rate[-1].mean()
    assert apart == pytest.approx(expected * speed, abs=1e-3 * speed)
    whole = float(world.tree.inertia[2, 2].sum())
    assert hub == pytest.approx(0.1 * speed * whole / (whole - 2 * spin), rel=1e-9)


@pytest.mark.slow
def test_a_motor_that_pulls_a_tendon_pays_for_its_own_work():
    """Its energy is |force x rate of length|. Work and losses are the change of energy."""
    joints = (("one.z", 1.0), ("two.z", -0.9))
    world = wheels(Tendon("t", joints, stiffness=1.0, damping=0.1, actuator=Actuator(0.5)))
    start = resting_state(world.tree, (), jnp.float64)
    missing = []

    def command(time):
        return MotorCommand(jnp.sin(3.0 * time) * jnp.array([4.0, 9.0]))

    for h in (1 / 240, 1 / 480):
        found, effort = driven.balance(world, start, command, round(1 / h), h)
        assert effort.energy.sum() == pytest.approx(np.abs(found.motors).sum(), rel=1e-12)
        missing.append(np.abs(found.left_over).sum() / found.effort)
    assert found.dampers.sum() < 0 < found.motors.sum()
    # The implicit spring loses energy of first order in the step, like the springs of joints.
    assert missing[1] < 5e-3
    assert missing[1] < 0.55 * missing[0]


@pytest.mark.slow
@pytest.mark.parametrize(("motor", "loss"), [(Actuator(0.3), 0.0), (Actuator(0.3, 0.25), 0.1)])
def test_gradients_by_the_numbers_of_a_tendon(motor, loss):
    """Central differences, in a step of one solve, and with friction and a force limit."""
    joints = (("b1.z", 1.0), ("b2.z", -2.0))
    values = {"stiffness": 0.8, "damping": 0.05, "armature": 0.02, "rest": (0.2, 0.2)}
    names = ("coefficients", "stiffness", "damping", "armature", "longest_rest", "servo_gain")
    tendon = Tendon("t", joints, actuator=motor, friction_loss=loss, upper=0.05, **values)
    chain = dataclasses.replace(box_chain(3, "z"), tendons=(tendon,))
    world = World(build_tree(chain), GRAVITY)

    def moved(numbers, world=world):
        tendons = world.tree.tendons
        given = {name: x[None] for name, x in zip(names[1:], numbers[2:], strict=True)}
        given["shortest_rest"] = given["longest_rest"]
        tendons = dataclasses.replace(tendons, coefficients=numbers[:2], **given)
        own = eqx.tree_at(lambda w: w.tree.tendons, world, tendons)
        state = resting_state(own.tree, (), jnp.float64, angles=jnp.array([0.3, -0.2]))
        command = MotorCommand(jnp.array([2.0, 0.0]))

        def advance(state, _):
            state, effort = step(own, state, command, H)
            return state, effort.tension

        later, tension = jax.lax.scan(advance, state, None, 3)
        return jnp.append(later.q, tension[-1])

    tendons = world.tree.tendons
    numbers = np.concatenate([getattr(tendons, name) for name in names])
    slopes, run = quick_jit(jax.jacrev(moved))(jnp.asarray(numbers)), quick_jit(moved)
    for i, number in enumerate(numbers):
        away = 1e-5 * number * (np.arange(len(numbers)) == i)
        np.testing.assert_allclose(slopes[:, i], slope(run, numbers, away), rtol=1e-6, atol=1e-8)


def test_a_held_root_stays_while_a_tendon_pulls():
    """The joint turns against the whole inertia of its wheel."""
    world = wheels(Tendon("t", (("one.z", 1.0),), actuator=TorqueMotor()))
    held = dataclasses.replace(world, held=True)
    state = resting_state(world.tree, (), jnp.float64)
    after, effort = step(held, state, MotorCommand(jnp.zeros(2), torque=jnp.ones(2)), H)
    spin = float(world.tree.inertia[2, 2, 1])
    np.testing.assert_allclose(after.qd, [H / spin, 0.0], rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(after.velocity, 0.0, atol=0)
    assert effort.holding[2] == pytest.approx(1.0, rel=1e-12)


def test_the_motor_of_a_tendon_idles_with_any_of_its_joints():
    tree = build_tree(pulled())
    idle = tree.without_motors(np.arange(tree.dof_count) == tree.tendons.dofs[0]).tendons
    pairs = zip(tree.tendons.owners, tree.tendons.dofs, strict=True)
    own = np.isin(range(4), [owner for owner, dof in pairs if dof == tree.tendons.dofs[0]])
    np.testing.assert_array_equal(idle.servo_gain, tree.tendons.servo_gain * ~own)
    assert own.any() and not own.all()
