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

from creatures import STRUCTURES, quick_jit, random_creature, random_state
from evo_cpg.creature.creature import WORLD, Body, Creature, Joint, Material
from evo_cpg.creature.shapes import Box
from evo_cpg.creature.tree import Tree, build_tree
from evo_cpg.exchange.mjcf_export import mjcf_model, mjcf_text
from evo_cpg.exchange.mujoco_state import dof_order, load_state
from evo_cpg.physics.articulated import solve
from evo_cpg.physics.body_equations import body_equations
from evo_cpg.physics.generalized import generalized_force, mass_matrix
from evo_cpg.physics.joint_torque import passive_torque
from evo_cpg.physics.kinematics import kinematics
from evo_cpg.physics.root import ROOT_DOFS
from evo_cpg.physics.spatial_algebra import Wrench
from evo_cpg.physics.state import State, resting_state
from evo_cpg.physics.step import step
from evo_cpg.physics.world import World
from evo_cpg.simulation.settle import Settling
from evo_cpg.simulation.situation import Situation
from evo_cpg.spatial.linear import expand_dims_like
from evo_cpg.spatial.rotation import euler_to_matrix, quaternion_to_matrix

GRAVITY = 9.81
START, HEADING = (1.0, 2.0, 3.0), 0.4

# A box of this size (m) and density hangs by an end on the world.
SIZE, DENSITY = (0.4, 0.1, 0.1), 1000.0
LENGTH, MASS = SIZE[0] / 2, 4.0
# Its inertia about the hinge, kg m^2.
INERTIA = MASS * ((SIZE[0] ** 2 + SIZE[2] ** 2) / 12 + LENGTH**2)


def hung(creature: Creature, kinds: tuple[str, ...], rng: np.random.Generator) -> Creature:
    """Return a creature whose root hangs on the world by some axes."""
    count = len(kinds)
    # MuJoCo has the velocity of a ball in the child's own axes.
    axes = np.eye(3) if "ball" in kinds else np.linalg.qr(rng.normal(size=(3, 3)))[0][:count]
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


@quick_jit
def accelerations(tree: Tree, state: State, tau):
    """Return joint accelerations by bodies, and all accelerations by the mass matrix."""
    kin = kinematics(tree, state)
    inertia, bias = body_equations(World(tree, GRAVITY), kin, 0.0)
    passive, derivative = passive_torque(tree, state, 0.0)
    rotor = derivative + expand_dims_like(tree.armature, tau)
    found = solve(tree, kin, inertia, bias, tau + passive, rotor)
    own = jnp.concatenate([jnp.zeros(ROOT_DOFS), rotor])
    matrix = mass_matrix(tree, kin, inertia) + jnp.diag(own)
    force = generalized_force(tree, kin, Wrench(-bias.moment, -bias.force))
    force = force.at[ROOT_DOFS:].add(tau + passive)
    return found.qdd, jnp.linalg.solve(matrix, force)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(
    "kinds",
    [(), ("turn",), ("turn",) * 3, ("slide", "slide", "turn"), ("ball",) * 3],
    ids=["fixed", "hinge", "three hinges", "planar", "ball"],
)
def test_hanging_trees_accelerate_as_in_mujoco(kinds):
    """Roundings give 1e-14."""
    rng = np.random.default_rng(len(kinds))
    creature = hung(random_creature(rng, STRUCTURES[2], axes_seed=2), kinds, rng)
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
    np.testing.assert_allclose(by_bodies, theirs, rtol=0, atol=1e-9 * largest)
    np.testing.assert_allclose(by_matrix[ROOT_DOFS:], theirs, rtol=0, atol=1e-9 * largest)
    assert not by_matrix[:ROOT_DOFS].any()
    # The root's pose and velocity in the state are those of its frame in MuJoCo.
    body, velocity = model.body(tree.names[0]).id, np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, body, velocity, 0)
    np.testing.assert_allclose(state.velocity, velocity, rtol=0, atol=1e-12)
    np.testing.assert_allclose(state.position, data.xipos[body], rtol=0, atol=1e-12)
    turned = quaternion_to_matrix(state.orientation).ravel()
    np.testing.assert_allclose(turned, data.xmat[body], rtol=0, atol=1e-12)


def pendulum(stiffness: float = 0.0) -> World:
    """Return a box that hangs by its end on a hinge along y."""
    joint = Joint(
        WORLD,
        (0.0, 0.0, 0.0),
        (LENGTH, 0.0, 0.0),
        ((0.0, 1.0, 0.0),),
        (-9.0,),
        (9.0,),
        stiffness=stiffness,
    )
    body = Body("bob", Box(SIZE), Material(DENSITY))
    return World(build_tree(Creature("pendulum", (body,), root_joint=joint)), GRAVITY)


@pytest.mark.usefixtures("x64")
def test_pendulum_swings_with_its_period():
    """The period at any amplitude is ``4 K(sin^2(a/2)) sqrt(I/(m g l))``.

    The error of the step of 1 ms is some 1e-6.
    """
    world, amplitude, h = pendulum(), 1.0, 1e-3
    # The box points down at -90 degrees.
    start = resting_state(world.tree, (), jnp.float64, angles=[amplitude - np.pi / 2])

    @quick_jit
    def motion(state):
        def advance(state, _):
            state, _ = step(world, state, jnp.zeros(1), h)
            return state, (state.q[0] + np.pi / 2, state.position)

        return jax.lax.scan(advance, state, None, 2500)[1]

    angle, place = map(np.asarray, motion(start))
    down = np.flatnonzero((angle[:-1] > 0) & (angle[1:] <= 0))
    crossing = down + angle[down] / (angle[down] - angle[down + 1])
    period = 4 * ellipk(np.sin(amplitude / 2) ** 2) * np.sqrt(INERTIA / (MASS * GRAVITY * LENGTH))
    assert np.diff(crossing)[0] * h == pytest.approx(period, rel=1e-5)
    np.testing.assert_allclose(np.linalg.norm(place, axis=1), LENGTH, rtol=1e-12)
    assert not place[:, 1].any()


@pytest.mark.usefixtures("x64")
def test_pendulum_settles_where_its_spring_carries_it():
    """The torques balance: ``k q = m g l cos(q)``."""
    world = pendulum(stiffness=5.0)
    found = Settling(world, 1 / 240).settle(Situation(START, HEADING)).state
    q = brentq(lambda q: 5.0 * q - MASS * GRAVITY * LENGTH * np.cos(q), 0, 2)
    assert abs(found.q[0]) == pytest.approx(q, rel=1e-9)
    across = np.array([-np.sin(HEADING), np.cos(HEADING), 0.0])
    assert (found.position - START) @ across == pytest.approx(0.0, abs=1e-12)
