"""Exported creatures in MuJoCo: masses, inertias, accelerations and ground."""

import dataclasses
import functools
import inspect
from xml.etree import ElementTree

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from benchmarks.imported_models import accelerations
from creatures import STRUCTURES, in_water, quick_jit, random_creature, random_state
from evo_cpg.creature.creature import (
    NO_LIMIT,
    Actuator,
    Body,
    Creature,
    CreatureError,
    Joint,
    Material,
    Motor,
    TorqueMotor,
)
from evo_cpg.creature.shapes import Box, Shape, Sphere
from evo_cpg.creature.tree import build_tree
from evo_cpg.io.models.mjcf_export import mjcf_model, mjcf_text
from evo_cpg.io.models.mujoco_state import dof_order
from evo_cpg.io.models.refusals import ExchangeError
from evo_cpg.physics.contact.contact_model import Ground
from evo_cpg.physics.contact.terrain import Block, Boulder, GroundPart, Plane, Relief, Shore
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.joint_torque import MotorCommand
from evo_cpg.physics.tree.kinematics import kinematics

GRAVITY = 9.81
STATES = 5
MOTORS = {
    "position servos": Actuator(2.0, 3.0, stiffness=5.0),
    "velocity servos": Actuator(2.0, 4.0),
    "torque motors": TorqueMotor(-1.5, 1.0),
}

each_structure = pytest.mark.parametrize("number", range(len(STRUCTURES)))


def animal(number: int, motor: Motor | None = None, seed: int = 0) -> Creature:
    rng = np.random.default_rng([number, seed])
    return random_creature(rng, STRUCTURES[number], motor=motor, axes_seed=number)


def ball(name: str = "ball") -> Creature:
    material = Material(1000.0, dynamic_friction=0.4)
    return Creature("ball", (Body(name, Sphere(0.1), material),))


@each_structure
def test_masses_and_inertias_equal_mujocos(same_inertias, number):
    same_inertias(animal(number), 1e-12)


# Each kind of motor drives one structure in the fast tests.
@pytest.mark.parametrize(
    ("number", "kind"),
    [
        pytest.param(number, kind, marks=[] if number in (0, 2, 4) else pytest.mark.slow)
        for number, kind in zip(range(6), 2 * list(MOTORS), strict=True)
    ],
)
def test_accelerations_equal_mujocos(compiled, mujocos, number, kind):
    """Gravity, buoyancy, springs, rotors, motors at and below their limits: 1e-9.

    The water has buoyancy but no drag. Some of the random commands exceed the torque limit.
    """
    creature = animal(number, MOTORS[kind])
    world = in_water(creature, density=1030.0, form_drag=0.0, skin_drag=0.0)
    tree = world.tree
    data = mujoco.MjData(compiled(creature, GRAVITY, water=world.water))
    rng = np.random.default_rng(number)
    # Water cannot be an argument of a program.
    ours = quick_jit(lambda *given: inspect.unwrap(accelerations)(world, *given))
    strained = 0
    for _ in range(STATES):
        state = random_state(tree, rng)
        rate, angle = rng.normal(size=(2, tree.dof_count))
        springs = kind == "position servos"
        control = angle / MOTORS[kind].gear if kind == "torque motors" else angle
        command = MotorCommand(np.zeros_like(rate) if springs else rate, angle, torque=angle)
        theirs = mujocos(data, tree, state, rate if kind == "velocity servos" else control)
        assert np.abs(ours(state, command) - theirs).max() < 1e-9 * np.abs(theirs).max()
        limit = MOTORS[kind].torque_limit
        strained += np.isclose(np.abs(data.qfrc_actuator), limit, rtol=1e-12).sum()
    assert strained > 0


def unlike_axes(number: int) -> Creature:
    """Return a random creature whose axes have values and motors of their own."""
    creature, rng = animal(number), np.random.default_rng(number)
    choice = [TorqueMotor(2.0, 1.0), Actuator(2.0, 3.0), Actuator(1.0, stiffness=4.0), None]
    bodies = []
    for body in creature.bodies:
        joint = body.joint
        if joint is not None:
            count = len(joint.axes)
            free = rng.random(count) < 0.5
            values = {
                name: tuple(rng.uniform(0, 2, count))
                for name in ("stiffness", "damping", "armature", "rest")
            }
            joint = dataclasses.replace(
                joint,
                **values,
                lower=tuple(np.where(free, -NO_LIMIT, -3.0)),
                upper=tuple(np.where(free, NO_LIMIT, 3.0)),
                actuator=tuple(choice[i] for i in rng.integers(4, size=count)),
            )
        bodies.append(dataclasses.replace(body, joint=joint))
    return dataclasses.replace(creature, bodies=tuple(bodies))


@pytest.mark.slow
@pytest.mark.parametrize("number", [1, 3])
def test_axes_with_values_of_their_own_accelerate_as_in_mujoco(compiled, mujocos, number):
    """Springs with rest angles, dampers, rotors and motors, each of one axis: 1e-9."""
    creature = unlike_axes(number)
    world = World(build_tree(creature), GRAVITY)
    tree, data = world.tree, mujoco.MjData(compiled(creature, GRAVITY))
    rng = np.random.default_rng(number)
    assert tree.torque_motors is not None
    springs, gear = tree.servo_stiffness > 0, tree.torque_motors.gear
    of_torque = np.array(tree.torque_motors.driven)
    assert of_torque.any() and springs.any() and (tree.upper == NO_LIMIT).any()
    for _ in range(STATES):
        state = random_state(tree, rng)
        target = rng.normal(size=tree.dof_count)
        rate = np.where(springs, 0.0, target)
        control = np.where(of_torque, target / np.where(of_torque, gear, 1.0), target)
        theirs = mujocos(data, tree, state, control)
        found = accelerations(world, state, MotorCommand(rate, target, torque=target))
        assert np.abs(found - theirs).max() < 1e-9 * np.abs(theirs).max()


def test_joint_limits_are_exported(compiled):
    creature = animal(3)
    tree, model = build_tree(creature), compiled(creature, GRAVITY)
    joints = dof_order(model, tree) + 1
    np.testing.assert_array_equal(model.jnt_range[joints], np.stack([tree.lower, tree.upper], -1))
    assert model.jnt_limited[1:].all()
    assert model.jnt(joints[0]).name == f"{tree.names[1]}.1"


def test_initial_place_and_heading_are_exported(compiled):
    model = compiled(ball(), GRAVITY, start=(1.0, -2.0, 0.3), heading=0.4)
    np.testing.assert_allclose(model.qpos0[:3], (1.0, -2.0, 0.3))
    np.testing.assert_allclose(model.qpos0[3:], (np.cos(0.2), 0, 0, np.sin(0.2)), atol=1e-12)


@pytest.mark.slow
@each_structure
def test_an_initial_pose_is_a_keyframe(compiled, number):
    """Poses equal our kinematics to 1e-12. The reference pose stays neutral."""
    creature = animal(number)
    tree, rng = build_tree(creature), np.random.default_rng(number)
    state = random_state(tree, rng)
    start = tuple(np.asarray(state.position).tolist())
    pose = {"orientation": state.orientation.tolist(), "angles": state.q.tolist()}
    model = compiled(creature, GRAVITY, start=start, **pose)
    np.testing.assert_allclose(model.qpos0, [*start, 1, 0, 0, 0, *[0] * tree.dof_count])
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    mujoco.mj_forward(model, data)
    kin = quick_jit(functools.partial(kinematics, tree))(state)
    centres = kin.origin + (kin.rotation * tree.com[None]).sum(1)
    theirs = np.stack([data.body(name).xipos for name in tree.names], -1)
    np.testing.assert_allclose(theirs, centres, rtol=0, atol=1e-12)
    turns = np.stack([data.body(name).xmat.reshape(3, 3) for name in tree.names], -1)
    np.testing.assert_allclose(turns, kin.rotation, rtol=0, atol=1e-12)


def test_contact_with_the_ground_has_the_combined_friction(compiled):
    """The pair has sqrt(0.4 x 0.9). MuJoCo alone would take the larger friction."""
    ground = Ground(dynamic_friction=0.9, floor=Plane(height=0.5))
    model = compiled(ball(), GRAVITY, ground, start=(0.0, 0.0, 0.6), time_step=0.01)
    assert model.opt.timestep == 0.01
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.ncon == 1
    assert data.contact[0].dist == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(data.contact[0].friction[:2], 0.6)


def test_places_of_slope_boulder_and_block(compiled):
    """Compare the distance of MuJoCo's geoms from a ball with `GroundPart.distance`."""
    slope = (0.28, 0.0, 0.96)
    parts = (
        Plane(slope, 0.1),
        Boulder((0.4, 0.2, 0.3), 0.25),
        Block((0.0, 0.6, 0.2), (0.1, 0.3, 0.4), heading=0.5),
    )
    ground = Ground(floor=parts[0], obstacles=parts[1:])
    model = compiled(ball("ground"), GRAVITY, ground, start=(0.0, 0.0, 0.45))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    own = model.geom("ground").id
    for part, name in zip(parts, ("ground_", "obstacle1", "obstacle2"), strict=True):
        found = mujoco.mj_geomDistance(model, data, model.geom(name).id, own, 10.0, None)
        centre, _ = part.distance(jnp.array([0.0, 0.0, 0.45]))
        assert found == pytest.approx(float(centre) - 0.1, abs=1e-6)


@pytest.mark.parametrize(
    "floor",
    [
        Shore("x", -0.5, 1.0, 0.2, -0.4),
        Shore("y", -1.0, 0.5, -0.3, 0.3),
        Relief(np.outer(np.arange(4.0), np.ones(6)) / 9 - 0.1, (-1.0, -1.5), 0.5),
        Relief(np.outer(np.ones(5), np.array([0.2, 0.0, 0.1, 0.4])), (-1.0, -0.75), 0.5),
        Relief(np.full((3, 3), 0.2), (-1.0, -1.0), 1.0),
    ],
    ids=["shore", "shore along y", "relief", "relief along y", "level relief"],
)
def test_heights_of_uneven_ground(compiled, floor):
    """Rays from above end where `GroundPart.distance` is 0, to 1e-6 m (float32 heights)."""
    model = compiled(ball(), GRAVITY, Ground(floor=floor), start=(0.0, 0.0, 10.0))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for x, y in np.random.default_rng(0).uniform(-0.5, 0.45, (20, 2)):
        found = np.zeros(1, np.int32)
        down = np.array([0.0, 0.0, -1.0])
        fall = mujoco.mj_ray(model, data, np.array([x, y, 5.0]), down, None, 1, -1, found)
        gap, _ = floor.distance(jnp.array([x, y, 5.0 - fall]))
        assert abs(float(gap)) < 1e-6


def test_the_text_is_readable_and_exact():
    """The text has short numbers, nested elements and colours."""
    material = Material(850.0, dynamic_friction=0.3)
    body = Body("trunk", Box((0.1, 0.2, 0.3)), material, color="#ff8000")
    text = mjcf_text(mjcf_model(Creature("toy", (body,)), GRAVITY, start=(0.0, 0.0, 0.1)))
    root = ElementTree.fromstring(text)
    assert root.get("model") == "toy"
    geom = root.find("worldbody/body[@name='trunk']/geom")
    assert geom is not None
    assert geom.attrib == {
        "name": "trunk",
        "type": "box",
        "size": "0.05 0.1 0.15",
        "density": "850",
        "friction": "0.3",
        "rgba": "1 0.5019607843137255 0 1",
    }
    assert '\n    <body name="trunk" pos="0 0 0.1">\n' in text


class Ring(Shape):
    """A shape unknown to MJCF."""

    volume = 1.0
    half_extents = np.ones(3)
    inertia = distance = support = surface = cells = None


class Mud(GroundPart):
    def distance(self, point):
        return point[2], point


def test_parts_that_mjcf_cannot_hold_are_refused():
    ring = dataclasses.replace(ball().bodies[0], shape=Ring())
    with pytest.raises(ExchangeError, match=r"a Ring cannot be written as MJCF\. Allowed: Box"):
        mjcf_model(Creature("x", (ring,)), GRAVITY)
    with pytest.raises(ExchangeError, match=r"ground with a Mud cannot be written.*Allowed: Plane"):
        mjcf_model(ball(), GRAVITY, Ground(floor=Mud()))
    with pytest.raises(CreatureError, match="two bodies are called 'ball'"):
        mjcf_model(Creature("x", ball().bodies * 2), GRAVITY)


def test_pairs_of_bodies_collide_without_friction(compiled):
    """Two balls on a trunk overlap when the joints bend, and MuJoCo finds their contact."""
    material = Material(1000.0)
    arm = {"axes": ((0.0, 0.0, 1.0),), "lower": (-2.0,), "upper": (2.0,)}
    bodies = [Body("trunk", Box((0.1, 0.1, 0.1)), material)]
    for name, side in (("left", 1.0), ("right", -1.0)):
        joint = Joint("trunk", (0.0, side * 0.2, 0.0), (-0.3, 0.0, 0.0), **arm)
        bodies.append(Body(name, Sphere(0.1), material, joint))
    creature = Creature("pair", tuple(bodies))
    model = compiled(creature, GRAVITY, pairs=[("left", "right")])
    data = mujoco.MjData(model)
    found = []
    for bend in (0.0, 0.5):
        data.qpos[7:] = -bend, bend
        mujoco.mj_forward(model, data)
        found.append(data.ncon)
    assert found == [0, 1]
    assert data.contact[0].dim == 1
