"""Roots that hang on the fixed world: accelerations, energy and equilibria.

MuJoCo solves the same equations in other coordinates. Pendulums have closed forms.
"""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ellipk

from creatures import (
    accelerations,
    coast,
    hinge,
    in_water,
    quick_jit,
    random_creature,
    random_state,
)
from evo_cpg.creature.algebra.rotation import euler_to_matrix, quaternion_to_matrix
from evo_cpg.creature.axis_kinds import AxisKind, BallComponent, Slide, Turn
from evo_cpg.creature.creature import NO_MASS, WORLD, Actuator, Body, Creature, Joint, Material
from evo_cpg.creature.self_collision import SelfCollision
from evo_cpg.creature.shapes import Box
from evo_cpg.creature.tree import Tree, build_tree
from evo_cpg.io.models.mjcf_export import mjcf_model, mjcf_text
from evo_cpg.io.models.mujoco_state import dof_order, load_state
from evo_cpg.physics.contact.contact_model import Ground, make_contact_model
from evo_cpg.physics.contact.pairs import make_pairs
from evo_cpg.physics.step.step import step
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.root import ROOT_DOFS
from evo_cpg.physics.tree.state import State, resting_state
from evo_cpg.simulation.noise import Noise, disturb_motion, disturb_start
from evo_cpg.simulation.settle import Settling
from evo_cpg.simulation.situation import Situation

GRAVITY = 9.81
START, HEADING = (1.0, 2.0, 3.0), 0.4

# A box of this size (m) and density hangs by an end on the world.
SIZE, DENSITY = (0.4, 0.1, 0.1), 1000.0
LENGTH, MASS = SIZE[0] / 2, 4.0
# Its inertia about the hinge, kg m^2.
INERTIA = MASS * ((SIZE[0] ** 2 + SIZE[2] ** 2) / 12 + LENGTH**2)


def hung(creature: Creature, kinds: tuple[AxisKind, ...], rng: np.random.Generator) -> Creature:
    """Return a creature whose root hangs on the world by some axes."""
    count = len(kinds)
    # MuJoCo has the velocity of a ball in the child's own axes.
    axes = (
        np.eye(3) if BallComponent() in kinds else np.linalg.qr(rng.normal(size=(3, 3)))[0][:count]
    )
    joint = Joint(
        WORLD,
        tuple(rng.normal(scale=0.2, size=3)),
        tuple(rng.normal(scale=0.2, size=3)),
        tuple(map(tuple, axes)),
        (-9.0,) * count,
        (9.0,) * count,
        tuple(map(tuple, euler_to_matrix(*rng.normal(size=3)))),
        stiffness=1.0,
        damping=0.2,
        armature=0.01,
        kinds=kinds,
    )
    return dataclasses.replace(creature, root_joint=joint)


def random_hanging_state(tree: Tree, rng: np.random.Generator) -> State:
    """Return a random pose and motion of joints, with the base at the start."""
    turn = Situation(START, HEADING).orientation
    base = resting_state(tree, (), jnp.float64, START, turn).base
    return dataclasses.replace(random_state(tree, rng), base=base).placed(tree)


def test_a_massless_fixed_root_stops_limbs():
    """It counts like the limb that touches it."""
    elbow = hinge("root", (0.3, 0, 0), (-0.3, 0, 0), limit=3.0)
    wrist = dataclasses.replace(elbow, parent="arm")
    limb = Body("arm", Box((0.4, 0.1, 0.1)), Material(1000.0), elbow)
    fixed = Joint(WORLD, (0, 0, 0), (0, 0, 0), (), (), ())
    stiffness = []
    for inertial in (NO_MASS, None):
        root = Body("root", limb.shape, limb.material, inertial=inertial)
        bodies = root, limb, dataclasses.replace(limb, name="hand", joint=wrist)
        creature = Creature("reacher", bodies, root_joint=fixed)
        pairs = make_pairs(creature, build_tree(creature), SelfCollision())
        assert pairs is not None and (pairs.first, pairs.second) == ((0,), (2,))
        stiffness.append(pairs.stiffness)
    np.testing.assert_array_equal(*stiffness)
    assert (stiffness[0] > 0).all()


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(
    "kinds",
    [
        pytest.param((), id="fixed"),
        pytest.param((Turn(),), id="hinge"),
        pytest.param((Turn(),) * 3, id="three hinges"),
        pytest.param((Slide(), Slide(), Turn()), id="planar"),
        pytest.param((BallComponent(),) * 3, id="ball"),
    ],
)
def test_hanging_trees_accelerate_as_in_mujoco(kinds):
    """Roundings give 1e-14."""
    rng = np.random.default_rng(len(kinds))
    creature = hung(random_creature(rng, ((0, 1), (1, 2)), axes_seed=2), kinds, rng)
    tree = build_tree(creature)
    state, tau = random_hanging_state(tree, rng), rng.normal(size=tree.dof_count)
    element = mjcf_model(creature, GRAVITY, start=START, heading=HEADING)
    model = mujoco.MjModel.from_xml_string(mjcf_text(element))
    flags = mujoco.mjtDisableBit
    model.opt.disableflags |= flags.mjDSBL_LIMIT | flags.mjDSBL_CONTACT
    data, order = mujoco.MjData(model), dof_order(model, tree)
    load_state(model, data, tree, state)
    data.qfrc_applied[order] = tau
    mujoco.mj_forward(model, data)
    theirs = data.qacc[order]
    by_bodies, by_matrix = accelerations(tree, state, jnp.asarray(tau))
    largest = np.abs(theirs).max()
    np.testing.assert_allclose(by_bodies[ROOT_DOFS:], theirs, rtol=0, atol=1e-9 * largest)
    np.testing.assert_allclose(by_matrix[ROOT_DOFS:], theirs, rtol=0, atol=1e-9 * largest)
    assert not by_bodies[:ROOT_DOFS].any() and not by_matrix[:ROOT_DOFS].any()
    # The root's pose and velocity in the state are those of its frame in MuJoCo.
    body, velocity = model.body(tree.names[0]).id, np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, body, velocity, 0)
    np.testing.assert_allclose(state.velocity, velocity, rtol=0, atol=1e-12)
    np.testing.assert_allclose(state.position, data.xipos[body], rtol=0, atol=1e-12)
    turned = quaternion_to_matrix(state.orientation).ravel()
    np.testing.assert_allclose(turned, data.xmat[body], rtol=0, atol=1e-12)


def pendulum(stiffness: float = 0.0, actuator: Actuator | None = None) -> World:
    """Return a box that hangs by its end on a hinge along y."""
    given = {"actuator": actuator, "stiffness": stiffness}
    joint = hinge(WORLD, (0.0, 0.0, 0.0), (LENGTH, 0.0, 0.0), "y", 9.0, **given)
    body = Body("bob", Box(SIZE), Material(DENSITY))
    return World(build_tree(Creature("pendulum", (body,), root_joint=joint)), GRAVITY)


def test_the_state_of_a_hanging_root_needs_its_base():
    tree = pendulum().tree

    def without():
        return kinematics(tree, dataclasses.replace(resting_state(tree), base=None))

    with pytest.raises(ValueError, match="its state needs a base"):
        jax.eval_shape(without)


@pytest.mark.usefixtures("x64")
@pytest.mark.slow
def test_pendulum_swings_with_its_period():
    """The period at any amplitude is ``4 K(sin^2(a/2)) sqrt(I/(m g l))``.

    The error of the step of 1 ms is some 1e-6.
    """
    world, amplitude, h = pendulum(), 1.0, 1e-3
    # The box points down at -90 degrees.
    start = resting_state(world.tree, (), jnp.float64, angles=[amplitude - np.pi / 2])

    states = coast(world, start, 2500 * h, h)
    angle, place = states.q[:, 0] + np.pi / 2, states.position
    down = np.flatnonzero((angle[:-1] > 0) & (angle[1:] <= 0))
    crossing = down + angle[down] / (angle[down] - angle[down + 1])
    period = 4 * ellipk(np.sin(amplitude / 2) ** 2) * np.sqrt(INERTIA / (MASS * GRAVITY * LENGTH))
    assert np.diff(crossing)[0] * h == pytest.approx(period, rel=1e-5)
    np.testing.assert_allclose(np.linalg.norm(place, axis=1), LENGTH, rtol=1e-12)
    assert not place[:, 1].any()


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_pendulum_settles_where_its_spring_carries_it():
    """The torques balance: ``k q = m g l cos(q)``."""
    world = pendulum(stiffness=5.0)
    found = Settling(world, 1 / 240).settle(Situation(START, HEADING)).state
    q = brentq(lambda q: 5.0 * q - MASS * GRAVITY * LENGTH * np.cos(q), 0, 2)
    assert abs(found.q[0]) == pytest.approx(q, rel=1e-9)
    across = np.array([-np.sin(HEADING), np.cos(HEADING), 0.0])
    assert (found.position - START) @ across == pytest.approx(0.0, abs=1e-12)


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_a_motor_holds_a_root_that_settles():
    """A velocity servo holds its joint, so nothing is free to move."""
    world = pendulum(actuator=Actuator(5.0))
    assert Settling(world, 1 / 240).settle(Situation(START, HEADING)).state.q == [0.0]


def planar(hangs: bool) -> Creature:
    """Return a trunk with two legs that turn about y, free or in the plane y = 0."""
    flesh, bodies = Material(DENSITY), [Body("trunk", Box(SIZE), Material(DENSITY))]
    for name, x in (("fore", 0.15), ("hind", -0.1)):
        leg = hinge("trunk", (x, 0.0, -0.05), (0.0, 0.0, 0.1), "y", 9.0)
        bodies.append(Body(name, Box((0.04, 0.1, 0.2)), flesh, leg))
    if not hangs:
        return Creature("free", tuple(bodies))
    centre, kinds = (0.0, 0.0, 0.0), (Slide(), Slide(), Turn())
    joint = hinge(WORLD, centre, centre, "xzy", 9.0, kinds=kinds)
    return Creature("planar", tuple(bodies), root_joint=joint)


def on_ground(creature: Creature) -> World:
    """Return the creature on level ground with friction."""
    tree = build_tree(creature)
    return World(tree, GRAVITY, contact_model=make_contact_model(creature, tree, Ground()))


def walking(world: World, steps: int):
    """Return a function of kicks of the legs for the motion, and y of all bodies, steps first.

    Each step adds a part of the kick to the rates of the legs, rad/s.
    """
    tree = world.tree
    own = np.array([name.startswith(("fore", "hind")) for name in tree.dof_names], float)
    start = resting_state(tree, (1,), jnp.float64, (0.0, 0.0, 0.26))

    def motion(kick):
        def advance(state, index):
            swing = own * kick * jnp.sin(0.1 * index + np.arange(len(own)) - len(own))
            kin = kinematics(tree, state)
            moved = dataclasses.replace(state, qd=state.qd + swing[:, None])
            state, _ = step(world, moved, jnp.zeros_like(state.q), 1 / 240)
            return state, (state, kin.origin[1])

        return jax.lax.scan(advance, start, jnp.arange(steps))[1]

    return motion


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("medium", [in_water, on_ground], ids=["water", "ground"])
def test_planar_animals_move_like_free_ones_in_a_plane(medium):
    """A free animal of this symmetry stays in its plane. Both solve the same equations."""
    (planar_states, across), (free_states, _) = (
        jax.tree.map(np.asarray, quick_jit(walking(medium(planar(hangs)), 40))(0.3))
        for hangs in (True, False)
    )
    for name in ("position", "velocity", "orientation"):
        ours, theirs = (getattr(states, name) for states in (planar_states, free_states))
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-7)
    np.testing.assert_allclose(planar_states.q[:, 3:], free_states.q, rtol=0, atol=1e-7)
    assert np.ptp(planar_states.q, axis=0).min() > 1e-4
    assert not across.any()


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_gradients_of_a_planar_animal_equal_differences():
    world = in_water(planar(hangs=True))

    motion = walking(world, 20)
    slope_at = quick_jit(jax.value_and_grad(lambda kick: motion(kick)[0].position[-1, 0, 0]))
    (low, _), (_, slope), (high, _) = (slope_at(0.3 + change) for change in (-1e-5, 0.0, 1e-5))
    assert abs(float(slope)) > 1e-5
    assert float(slope) == pytest.approx(float(high - low) / 2e-5, rel=1e-5)


@pytest.mark.slow
def test_pushes_move_a_planar_root_in_its_plane():
    """The slides take the push along them, however the animal is turned."""
    tree = build_tree(planar(hangs=True))
    start = resting_state(tree, (500,), jnp.float32, angles=[0.0, 0.0, 0.7, 0.0, 0.0])
    keys = jax.random.key_data(jax.random.split(jax.random.key(0), 500)).T

    @quick_jit
    def disturbed(start, keys):
        pushed = disturb_motion(Noise(push=0.3), tree, start, keys, jnp.asarray(0), 1.0)
        return pushed, disturb_start(Noise(joint_angle=0.3), World(tree, GRAVITY), start, keys)

    pushed, bent = disturbed(start, keys)
    speed = np.asarray(pushed.velocity)
    np.testing.assert_allclose(speed[[3, 5]].std(1), 0.3, rtol=0.1)
    assert not speed[[0, 1, 2, 4]].any()
    np.testing.assert_allclose(np.asarray(bent.q - start.q).std(1), [0, 0, 0.3, 0.3, 0.3], rtol=0.1)
