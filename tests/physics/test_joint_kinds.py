"""Welds, slides, axes at their own places, universal joints and balls: the motion of MuJoCo."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from creatures import (
    accelerations,
    coast,
    hinge,
    last,
    mujocos_accelerations,
    quick_jit,
    random_shape,
    random_state,
)
from evo_cpg.creature.algebra.rotation import euler_to_matrix
from evo_cpg.creature.axis_kinds import BallComponent, Slide, Turn
from evo_cpg.creature.creature import Body, Creature, Joint, Material, TorqueMotor
from evo_cpg.creature.reach import keeps_apart
from evo_cpg.creature.shapes import Box
from evo_cpg.creature.tree import Tree, build_tree
from evo_cpg.io.models.mjcf_export import mjcf_model, mjcf_text
from evo_cpg.io.models.mujoco_state import joint_state, load_state
from evo_cpg.native.engine import Engine, using
from evo_cpg.physics.step.step import step
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree import joint_kinds
from evo_cpg.physics.tree.joint_torque import MotorCommand
from evo_cpg.physics.tree.state import State, resting_state

TURN, SLIDE, BALL = (Turn(),), (Slide(),), (BallComponent(),) * 3
# Parent, kinds of the axes, and whether turning axes have places of their own.
CASES = {
    "everything": (
        (0, SLIDE + TURN, True),
        (0, BALL, False),
        (1, (), False),
        (2, TURN * 2, True),
        (1, TURN * 2, False),
        (4, SLIDE, False),
        (5, TURN * 3 + SLIDE * 2, True),
        (7, BALL, False),
    ),
    "three hinges": ((0, TURN * 3, False),),
    "a few": ((0, SLIDE + TURN, True), (1, BALL, False)),
    "slide": ((0, SLIDE, False),),
    "slide and hinge": ((0, SLIDE + TURN, False),),
    "hinges at their places": ((0, TURN * 2, True),),
    "ball": ((0, BALL, False),),
    "universal": ((0, TURN * 2, False),),
    "weld": ((0, (), False), (1, TURN, False)),
}
CENTRAL = (0.0, 0.0, 0.0)


def jointed(name: str, rotor: float = 0.0, passive: float = 1.0) -> Creature:
    """Return a creature with random bodies and joints of some kinds, without limits."""
    rng = np.random.default_rng(7)
    bodies = [Body("b0", Box((0.3, 0.2, 0.1)), Material(1000.0))]
    for i, (parent, kinds, own) in enumerate(CASES[name], 1):
        directions = rng.normal(size=(len(kinds), 3))
        axes = directions / np.linalg.norm(directions, axis=1)[:, None]
        places = [
            tuple(rng.normal(scale=0.2, size=3)) if own and kind == Turn() else None
            for kind in kinds
        ]
        joint = Joint(
            parent=f"b{parent}",
            parent_anchor=tuple(rng.normal(scale=0.2, size=3)),
            child_anchor=tuple(rng.normal(scale=0.2, size=3)),
            # The axes of a mirrored ball point the other way.
            axes=tuple(map(tuple, np.diag([-1.0, 1, -1]) if kinds == BALL else axes)),
            lower=(-9.0,) * len(kinds),
            upper=(9.0,) * len(kinds),
            orientation=tuple(map(tuple, euler_to_matrix(*rng.normal(size=3)))),
            stiffness=passive * rng.uniform(0, 5),
            damping=passive * rng.uniform(0, 1),
            armature=rotor,
            kinds=kinds,
            places=tuple(places),
        )
        bodies.append(Body(f"b{i}", random_shape(rng), Material(rng.uniform(500, 2000)), joint))
    return Creature("jointed", tuple(bodies))


def theirs_of(creature: Creature, gravity: float):
    model = mujoco.MjModel.from_xml_string(mjcf_text(mjcf_model(creature, gravity, time_step=1e-4)))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    return model, mujoco.MjData(model)


@pytest.mark.parametrize(
    "name",
    [
        name if i == 1 else pytest.param(name, marks=pytest.mark.slow)
        for i, name in enumerate(CASES)
    ],
)
@pytest.mark.slow
def test_joints_of_every_kind_accelerate_as_in_mujoco(name):
    """Gravity, springs, dampers and torques, with and without rotors: 1e-9."""
    for rotor in (0.0, 0.01):
        creature = jointed(name, rotor)
        tree, rng = build_tree(creature), np.random.default_rng(3)
        model, data = theirs_of(creature, 9.81)
        for _ in range(4):
            state, tau = random_state(tree, rng), rng.normal(size=tree.dof_count)
            # Three hinges at one place turn beyond the plane of their axes.
            state = dataclasses.replace(state, q=2.0 * state.q)
            theirs = mujocos_accelerations(model, data, tree, state, tau)
            # MuJoCo's accelerations of a mirrored ball are in the axes of its body.
            theirs[6:] = joint_state(model, tree, data.qpos, data.qacc)[1]
            for ours in accelerations(tree, state, _in_our_axes(tree, tau)):
                assert np.abs(ours - theirs).max() < 1e-9 * np.abs(theirs).max()
            q, qd = joint_state(model, tree, data.qpos, data.qvel)
            np.testing.assert_allclose(q, state.q, rtol=1e-12)
            np.testing.assert_allclose(qd, state.qd, rtol=1e-12)


def _in_our_axes(tree: Tree, tau: np.ndarray) -> np.ndarray:
    """Return torques in our axes of balls, from torques in their bodies' axes."""
    tau = tau.copy()
    balls = np.array(tree.balls, int)[:, None] + np.arange(3)
    for ball in balls:
        tau[ball] = tree.joint_axes[:, ball].T @ tau[ball]
    return tau


def test_three_hinges_keep_their_equations_within_85_degrees():
    for most, kind in ((85.0, "turns"), (86.0, "chain")):
        assert hinge("a", CENTRAL, CENTRAL, "xyz", np.radians(most)).kind == kind


@pytest.fixture(scope="module")
def drifting():
    """Return a tree with a slide, a hinge and a ball in a vacuum, and its motion at two steps."""
    with jax.enable_x64(True):
        creature = jointed("a few", passive=0.0)
        world = World(build_tree(creature), 0.0)
        tree = world.tree
        start = random_state(tree, np.random.default_rng(2), speed=0.5)
        ends = []
        for h in (1 / 1000, 1 / 2000):
            # Velocities are half a step behind the poses.
            moving = start.moved(tree, h / 2)
            end = last(coast(world, moving, 0.1, h))
            ends.append(end.moved(tree, -h / 2))
        return creature, tree, start, ends


def _conserved(model, data, tree: Tree, state: State) -> np.ndarray:
    load_state(model, data, tree, state)
    mujoco.mj_forward(model, data)
    mujoco.mj_subtreeVel(model, data)
    mujoco.mj_energyVel(model, data)
    linear = model.body_subtreemass[1] * data.subtree_linvel[1]
    turning = data.subtree_angmom[1] + np.cross(data.subtree_com[1], linear)
    return np.array([*linear, *turning, data.energy[1]])


@pytest.mark.slow
def test_free_motion_converges_to_mujocos_at_second_order(drifting):
    """Momentum, energy, and the pose after 0.1 s: half the step has a quarter of the error."""
    creature, tree, start, ends = drifting
    model, data = theirs_of(creature, 0.0)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    expected = _conserved(model, data, tree, start)
    changes = [np.abs(_conserved(model, data, tree, end) - expected) for end in ends]
    size = np.array([np.abs(expected[i]).max() for i in (range(3), range(3, 6), [6])])
    errors = [np.array([c[:3].max(), c[3:6].max(), c[6]]) / size for c in changes]
    load_state(model, data, tree, start)
    for _ in range(1000):
        mujoco.mj_step(model, data)
    q, _ = joint_state(model, tree, data.qpos, data.qvel)
    pose = np.concatenate([data.qpos[:3], q])
    found = [np.concatenate([end.position, end.q]) for end in ends]
    errors = [np.append(e, np.abs(x - pose).max()) for e, x in zip(errors, found, strict=True)]
    assert (errors[0] < 2e-2).all()
    assert (errors[1] < 0.3 * errors[0]).all()


@pytest.mark.slow
def test_gradients_of_a_step_equal_finite_differences():
    """By poses, rates and places of axes: 1e-6."""
    tree = build_tree(jointed("a few", 0.01))
    world = World(tree, 9.81)
    state = random_state(tree, np.random.default_rng(4), speed=0.2)
    rng = np.random.default_rng(5)
    weights = [jnp.asarray(rng.normal(size=tree.dof_count)) for _ in range(2)]
    command = MotorCommand(jnp.zeros(tree.dof_count))

    def outcome(x):
        q, qd, places = x
        changed = dataclasses.replace(
            world, tree=dataclasses.replace(tree, joint_places=tree.joint_places + places)
        )
        moved = dataclasses.replace(state, q=state.q + q, qd=state.qd + qd)
        with using(Engine("jax")):
            end, _ = step(changed, moved, command, 1 / 240)
        return weights[0] @ end.q + weights[1] @ end.qd

    zero = [jnp.zeros(tree.dof_count)] * 2 + [jnp.zeros_like(jnp.asarray(tree.joint_places))]
    direction = jax.tree.map(lambda x: jnp.asarray(rng.normal(size=x.shape)), zero)
    _, slope = quick_jit(lambda d: jax.jvp(outcome, (zero,), (d,)))(direction)
    e = 1e-6
    run = quick_jit(outcome)
    ends = [run(jax.tree.map(lambda d, s=s: s * e * d, direction)) for s in (1.0, -1.0)]
    assert float(slope) == pytest.approx(float(ends[0] - ends[1]) / (2 * e), rel=1e-6)


def on_a_ball(limit: float = 9.0, damping: float = 0.0) -> Tree:
    """Return two boxes joined by a ball at the second box's centre."""
    box, flesh = Box((0.3, 0.2, 0.1)), Material(1000.0)
    given = {"damping": damping, "actuator": TorqueMotor(1.0), "kinds": BALL}
    joint = hinge("a", CENTRAL, CENTRAL, "xyz", limit, **given)
    return build_tree(Creature("pair", (Body("a", box, flesh), Body("b", box, flesh, joint))))


@pytest.mark.slow
def test_the_coordinates_of_a_ball_wrap_at_half_a_turn():
    """Beyond pi the rotation vector points the other way. The rotation is the same."""
    tree = on_a_ball()
    q = jnp.array([0.0, 3.0, 0.0])
    there = joint_kinds.displaced(tree, q, 0.3 * jnp.array([0.0, 1.0, 0.0]))
    np.testing.assert_allclose(there, [0.0, 3.3 - 2 * np.pi, 0.0], atol=1e-12)
    back = joint_kinds.displaced(tree, there, 0.3 * jnp.array([0.0, -1.0, 0.0]))
    np.testing.assert_allclose(back, q, atol=1e-12)


def test_the_limit_of_a_ball_holds_its_whole_angle():
    """At rest against a torque t about any axis, the angle is L + t / k."""
    tree, pull = on_a_ball(0.5, damping=0.5), np.array([0.3, -0.6, 0.2])
    world = World(tree, 0.0)

    @quick_jit
    def rest(state):
        command = MotorCommand(jnp.zeros(3), torque=jnp.asarray(pull))
        return jax.lax.scan(
            lambda s, _: (step(world, s, command, 1 / 240)[0], None), state, None, 1500
        )[0]

    q = np.asarray(rest(resting_state(tree, (), jnp.float64)).q)
    assert tree.ball_limits is not None
    strength = np.linalg.norm(pull)
    expected = 0.5 + strength / tree.ball_limits.limit_stiffness[0]
    np.testing.assert_allclose(q, expected * pull / strength, rtol=1e-6)


def test_a_slide_without_limits_reaches_everything():
    box, flesh = Box((0.1, 0.1, 0.1)), Material(1000.0)
    for limit, apart in ((0.2, True), (1e6, False)):
        joint = hinge("a", (0.5, 0.0, 0.0), CENTRAL, "x", limit, kinds=SLIDE)
        tree = build_tree(Creature("pair", (Body("a", box, flesh), Body("b", box, flesh, joint))))
        edges = np.zeros((3, 2)), np.full((3, 2), 0.05)
        assert bool(keeps_apart(tree, edges)(0, 1)) == apart
