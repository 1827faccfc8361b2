"""Contact against MuJoCo's in cases where the models agree: stiff, without restitution.

MuJoCo's contacts are soft springs, and its friction creeps. Both are made stiff here, with short
steps on both sides.
"""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from benchmarks.mujoco_model import mujoco_model
from creatures import hinge, quick_jit, resting
from evo_cpg.creature.creature import Body, Creature, Material
from evo_cpg.creature.shapes import Box, Capsule
from evo_cpg.creature.tree import build_tree
from evo_cpg.io.models.mujoco_state import dof_order, load_state
from evo_cpg.physics.contact.contact import find_contacts
from evo_cpg.physics.contact.contact_model import Ground, make_contact_model
from evo_cpg.physics.contact.terrain import Block, Plane
from evo_cpg.physics.step.step import first_warmstart, step
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.kinematics import kinematics
from on_ground import GRAVITY

H = 1 / 1000
STIFF = {"timestep": 1 / 4000, "cone": "elliptic", "impratio": 100, "integrator": "implicitfast"}


def both(creature: Creature, ground: Ground, state: dict, seconds: float, limits: bool = False):
    """Return our states, supports and contact offsets along x, and MuJoCo's model and data."""
    tree = build_tree(creature)
    world = World(tree, GRAVITY, contact_model=make_contact_model(creature, tree, ground))
    columns = {name: np.array(x, float)[:, None] for name, x in state.items()}
    start = resting(tree, (1,), **columns)

    @quick_jit
    def run(state):
        def advance(carry, _):
            now, warmstart = carry
            offset = find_contacts(world.contact_model, kinematics(tree, now), H).offset[0]
            now, effort = step(world, now, jnp.zeros_like(now.qd), H, warmstart=warmstart)
            return (now, effort.warmstart), (now, effort.contact_frame_force, offset)

        begin = state, first_warmstart(world, (1,), state.q.dtype)
        return jax.lax.scan(advance, begin, length=round(seconds / H))[1]

    states, support, offset = jax.tree.map(lambda x: np.asarray(x)[..., 0], run(start))
    model = mujoco_model(creature, STIFF, limits=limits, ground=ground)
    model.pair_solref[:] = 0.001, 1.0
    model.pair_solimp[:] = 0.99, 0.999, 1e-4, 0.5, 2.0
    data = mujoco.MjData(model)
    load_state(model, data, tree, jax.tree.map(lambda x: np.asarray(x)[..., 0], start))
    for _ in range(round(seconds / STIFF["timestep"])):
        mujoco.mj_step(model, data)
    return tree, (states, support, offset), model, data


def block(size, friction):
    material = Material(500.0, 0.0, friction, friction)
    return Creature("block", (Body("block", Box(size), material),))


@pytest.mark.parametrize("friction", [0.2, pytest.param(0.5, marks=pytest.mark.slow)])
def test_a_block_slides_as_far_as_in_mujoco(x64, friction):
    """The distance is v^2 / (2 mu g) within 1 %, and MuJoCo's within 2 %."""
    ground = Ground(0.0, friction, friction)
    state = {"position": (0.0, 0.0, 0.05), "velocity": (0, 0, 0, 2.0, 0, 0)}
    _, (states, *_), _, data = both(block((0.3, 0.2, 0.1), friction), ground, state, 1.2)
    expected = 2.0**2 / (2 * friction * GRAVITY)
    assert states.position[-1, 0] == pytest.approx(expected, rel=0.01)
    assert data.qpos[0] == pytest.approx(expected, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(("degrees", "stands"), [(17.4, True), (19.5, False)])
def test_a_tall_block_tips_over_at_mujocos_angle(x64, degrees, stands):
    """The block tips at atan(1/3) = 18.4 degrees, with its weight over its lower edge."""
    angle = np.deg2rad(degrees)
    normal = (float(np.sin(angle)), 0.0, float(np.cos(angle)))
    ground = Ground(0.0, 1.0, 1.0, floor=Plane(normal))
    turn = (np.cos(angle / 2), 0.0, np.sin(angle / 2), 0.0)
    state = {"position": tuple(0.15 * np.array(normal)), "orientation": turn}
    _, (states, *_), _, data = both(block((0.1, 0.1, 0.3), 1.0), ground, state, 1.5)
    ours, theirs = states.orientation[-1], data.qpos[3:7]
    tilts = [2 * np.arccos(min(1.0, abs(float(np.dot(q, turn))))) for q in (ours, theirs)]
    assert [tilt < np.deg2rad(1.0) for tilt in tilts] == [stands, stands]


@pytest.mark.slow
def test_a_stack_carries_its_load_as_in_mujoco(x64):
    """A plate on a block carries a weight on one side. The supports follow the lever law to 1 %."""
    stiff = {"stiffness": 2000.0, "damping": 20.0}
    joint = hinge("plate", (0.08, 0.0, 0.05), (0.0, 0.0, -0.05), "y", 0.5, **stiff)
    bodies = (
        Body("plate", Box((0.3, 0.3, 0.1)), Material(500.0)),
        Body("weight", Box((0.1, 0.1, 0.1)), Material(4000.0), joint),
    )
    ground = Ground(0.0, obstacles=(Block((0.0, 0.0, 0.1), (0.2, 0.2, 0.1)),))
    tree, (states, support, offset), model, data = both(
        Creature("stack", bodies), ground, {"position": (0.0, 0.0, 0.25)}, 1.0
    )
    assert np.abs(states.velocity[-1]).max() < 1e-3
    assert abs(states.position[-1, 2] - 0.25) < 1e-3
    total = tree.mass.sum() * GRAVITY
    lever = 0.5 + 0.08 * tree.mass[1] / tree.mass.sum() / 0.3
    ours, theirs = {}, {1: 0.0, -1: 0.0}
    for side in (1, -1):
        ours[side] = support[-1, 2][np.sign(offset[-1]) == side].sum()
    force = np.zeros(6)
    for k in range(data.ncon):
        mujoco.mj_contactForce(model, data, k, force)
        theirs[1 if data.contact[k].pos[0] > 0 else -1] += force[0]
    for found in (ours, theirs):
        assert sum(found.values()) == pytest.approx(total, rel=0.01)
        assert found[1] / total == pytest.approx(lever, rel=0.01)


@pytest.mark.slow
def test_a_swinging_leg_hits_the_ground_as_in_mujoco(x64):
    """A trunk falls on a swinging leg. After 0.1 s both move as in MuJoCo, within 3 %."""
    material = Material(500.0, 0.0, 0.8, 0.8)
    turned = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))
    given = {"orientation": turned, "damping": 0.5}
    joint = hinge("trunk", (0.1, 0.0, -0.1), (-0.2, 0.0, 0.0), "y", 2.5, **given)
    bodies = (
        Body("trunk", Box((0.5, 0.3, 0.2)), material),
        Body("leg", Capsule(0.03, 0.34), material, joint),
    )
    creature = Creature("swing", bodies)
    ground = Ground(0.0, 0.8, 0.8)
    state = {
        "position": (0.0, 0.0, 0.47),
        "velocity": (0.0, 0.0, 0.0, 0.5, 0.0, -1.0),
        "q": np.array([0.5]),
        "qd": np.array([-3.0]),
    }
    tree, (states, support, _), model, data = both(creature, ground, state, 0.1)
    assert (support[:, 2] > 0).any()
    order = dof_order(model, tree)
    # The trunk turns about y alone, so its rate is equal in its own axes.
    theirs = np.concatenate([data.qvel[:3], data.qvel[4:5], data.qvel[6 + order]])
    ours = np.concatenate([states.velocity[-1, 3:], states.velocity[-1, 1:2], states.qd[-1]])
    np.testing.assert_allclose(ours, theirs, rtol=0.03, atol=1e-6)
    # The motion differs from free fall.
    assert abs(ours[2] - (-1.0 - GRAVITY * 0.1)) > 0.3


@pytest.mark.slow
def test_a_joint_with_a_rotor_stops_at_its_limit_as_in_mujoco(x64):
    """Both limits are critically damped springs, which return the speed v at v / e^2.

    The rotor has 1000 times the inertia of the boxes, as in gymnasium's ant. The joint reaches its
    limit in free fall, where both programs use the laws of animals on the ground.
    """
    centre, speed = (0.0, 0.0, 0.0), 6.0
    joint = hinge("a", centre, centre, limit=0.5, armature=1.0)
    bodies = (
        Body("a", Box((0.2, 0.1, 0.1)), Material(300.0)),
        Body("b", Box((0.2, 0.1, 0.1)), Material(300.0), joint),
    )
    start = {"position": (0.0, 0.0, 5.0), "q": np.array([0.5]), "qd": np.array([speed])}
    _, (states, *_), _, data = both(Creature("pair", bodies), Ground(), start, 0.2, limits=True)
    theirs, ours = data.qvel[6], states.qd[-1, 0]
    assert theirs == pytest.approx(-speed / np.e**2, rel=0.02)
    assert ours == pytest.approx(theirs, rel=0.1)
