"""Import of our own exports and of foreign models, against MuJoCo, and refusals."""

import dataclasses
import importlib
from typing import get_args

import jax
import mujoco
import numpy as np
import pytest

from benchmarks.imported_mjcf import Imports, differences
from benchmarks.imported_models import largest_difference
from creatures import STRUCTURES, random_creature
from evo_cpg.creature.creature import NO_LIMIT, Actuator, TorqueMotor
from evo_cpg.creature.tree import Tree, build_tree
from evo_cpg.io.build import build_creature
from evo_cpg.io.load import check_config, load_config
from evo_cpg.io.models.mjcf_export import mjcf_model, mjcf_text
from evo_cpg.io.models.mjcf_import import read_model
from evo_cpg.io.models.refusals import ExchangeError
from evo_cpg.io.models.rigid import _top
from evo_cpg.physics.contact.contact_model import Combination, Ground, combine
from evo_cpg.physics.water.water import Water
from imported import creature_of
from shipped_configs import some_configs
from tiny_run import REPOSITORY

CONFIGS = sorted((REPOSITORY / "configs").glob("*.yaml"))
GRAVITY = 9.81

# Features that MuJoCo resolves: classes, degrees, a root rotated by 90 degrees, fromto, a geom
# rotated in its body, joints away from the origin, ref, gear, and mass instead of density.
OTHERS = """
<mujoco model="cat">
  <compiler angle="degree"/>
  <option gravity="0 0 -3.7"/>
  <default>
    <joint damping="0.2" armature="0.01" range="-40 50"/>
    <default class="leg"><geom type="capsule" size="0.03" density="700" friction="0.9"/></default>
  </default>
  <worldbody>
    <light pos="0 0 3"/><light pos="1 0 3"/><camera name="side"/>
    <geom name="floor" type="plane" size="5 5 1" pos="0 0 0.1" friction="0.7"/>
    <body name="torso" pos="0 0 0.7" euler="0 0 90">
      <joint name="root" type="free" damping="0" armature="0"/>
      <geom type="box" size="0.1 0.3 0.05" pos="0 0.02 0.01" mass="4" rgba="0.2 0.4 0.6 1"/>
      <body name="hip" pos="0.1 0.2 0">
        <joint name="swing" axis="0 0 1" pos="-0.01 0 0.02" stiffness="3" ref="10" springref="10"/>
        <joint name="lift" axis="0 1 1" pos="-0.01 0 0.02" stiffness="3"/>
        <geom class="leg" fromto="0 0 0 0.2 0.1 -0.2"/>
        <body pos="0.2 0.1 -0.2">
          <joint name="knee" axis="0 -1 0"/>
          <geom type="ellipsoid" size="0.02 0.04 0.15" pos="0 0 -0.15" euler="30 0 20"/>
        </body>
      </body>
      <body name="tail" pos="0 -0.3 0" euler="20 10 0">
        <joint name="tail" axis="1 0 0"/>
        <geom type="sphere" size="0.05" pos="0 -0.1 0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="kick" joint="knee" gear="5" ctrlrange="-2 2"/>
    <position joint="tail" kp="3" kv="0.5" gear="2" forcerange="-4 4"/>
  </actuator>
</mujoco>
"""

# Slides and hinges at different places, a ball, a welded limb, two tendons, a servo without a
# damper, an actuator with dynamics, and inertia in numbers. It hangs on the world.
HUNG = """
<mujoco model="crane">
  <compiler angle="radian"/>
  <option gravity="0 0 -9.81"/>
  <worldbody>
    <body name="cart" pos="0 1 1.8">
      <joint name="x" type="slide" axis="1 0 0" range="-1 1" ref="0.2" damping="2"/>
      <joint name="roll" axis="1 0 0" pos="0 0.1 0" armature="0.1"/>
      <joint name="pitch" axis="0 1 0" pos="0.2 0 0.1" stiffness="3" springref="0.4"/>
      <geom type="cylinder" size="0.1 0.2" euler="0.3 0.2 0"/>
      <body name="arm" pos="0 0 -0.3" euler="0 0.4 0">
        <geom type="capsule" size="0.05" fromto="0 0 0 0 0.3 -0.2"/>
        <body name="hand" pos="0 0.3 -0.2">
          <inertial pos="0.01 0.02 0" mass="0.7" fullinertia="0.02 0.03 0.04 0.001 0 -0.002"/>
          <joint name="wrist" type="ball" range="0 1" stiffness="0.5" damping="0.1"/>
          <body name="finger" pos="0.1 0 0">
            <joint name="finger" axis="0 0 1"/><geom size="0.03" pos="0.1 0 0"/>
          </body>
        </body>
      </body>
    </body>
    <body name="post" pos="3 0 0"><geom name="post" size="0.2"/></body>
  </worldbody>
  <tendon>
    <fixed name="t" stiffness="4" damping="0.3" springlength="0.1 0.2">
      <joint joint="roll" coef="1"/><joint joint="finger" coef="-0.5"/></fixed>
    <fixed name="u"><joint joint="pitch" coef="2"/><joint joint="x" coef="1"/></fixed>
  </tendon>
  <actuator>
    <position name="p" joint="finger" kp="2"/>
    <general name="g" tendon="u" gainprm="3" biastype="affine" biasprm="0.5 -2 -0.4" gear="2"/>
    <motor name="m" joint="roll" gear="-2" ctrlrange="0 1"/>
    <intvelocity name="i" joint="x" kp="3" actrange="-1 1"/>
  </actuator>
</mujoco>
"""


def assert_same_tree(found: Tree, expected: Tree) -> None:
    """Compare the numbers of two trees to 1e-9 of the largest one in each array."""
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for ours, theirs in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        finite = np.isfinite(theirs)
        scale = np.abs(np.where(finite, theirs, 0.0)).max(initial=0.0)
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9 * scale)


@pytest.mark.parametrize("number", range(len(STRUCTURES)))
def test_export_and_import_preserve_a_creature(read, number):
    rng = np.random.default_rng(number)
    servos = Actuator(2.0, 3.0, stiffness=5.0), Actuator(0.5)
    motor = (None, *servos, TorqueMotor(-2.0, 0.5), TorqueMotor(3.0))[number % 5]
    creature = random_creature(rng, STRUCTURES[number], 1.2, motor, axes_seed=number)
    found = read(mjcf_text(mjcf_model(creature, 0.0)))
    assert_same_tree(build_tree(creature_of(found)), build_tree(creature))
    assert (found.experiment["name"], found.left_out) == ("random", ())


@some_configs
def test_export_and_import_preserve_shipped_animals(read, path):
    """Bodies, axes and colours, and mass and friction of each body to 1e-6."""
    creature = build_creature(load_config(path), path)
    found = read(mjcf_text(mjcf_model(creature, GRAVITY)))
    again = creature_of(found)
    trees = [build_tree(own) for own in (again, creature)]
    assert trees[0].names == trees[1].names and trees[0].dof_names == trees[1].dof_names
    np.testing.assert_allclose(trees[0].mass, trees[1].mass, rtol=1e-6)
    found_bodies = {body.name: body for body in again.bodies}
    for given in creature.bodies:
        own = found_bodies[given.name]
        assert own.color == given.color
        frictions = own.material.dynamic_friction, given.material.dynamic_friction
        assert frictions[0] == pytest.approx(frictions[1], rel=1e-9)
    assert found.left_out == ()


def test_unequal_lifts_of_an_export_are_its_water(read):
    """Bodies of two densities in water of 1030 kg/m^3. With one density, gravity is less."""
    creature = random_creature(np.random.default_rng(0), STRUCTURES[1], 1.2)
    first, *others = creature.bodies
    heavy = dataclasses.replace(first, material=dataclasses.replace(first.material, density=2000.0))
    creature = dataclasses.replace(creature, bodies=(heavy, *others))
    found = read(mjcf_text(mjcf_model(creature, GRAVITY, water=Water(1030.0))))
    assert found.experiment["world"] == {"gravity": GRAVITY, "water": {"density": 1030.0}}


@pytest.mark.parametrize("rule", get_args(Combination))
def test_an_exported_ground_keeps_its_friction_rule(read, rule):
    path = REPOSITORY / "configs" / "hexapod.yaml"
    ground = Ground(dynamic_friction=0.7, friction_rule=rule)
    text = mjcf_text(mjcf_model(build_creature(load_config(path), path), GRAVITY, ground=ground))
    found = read(text).experiment
    assert found["world"]["ground"]["friction_rule"] == rule
    assert found["world"]["ground"]["dynamic_friction"] == 0.7


@pytest.mark.parametrize(
    "text", [pytest.param(OTHERS, id="cat"), pytest.param(HUNG, id="crane", marks=pytest.mark.slow)]
)
def test_foreign_models_accelerate_as_in_mujoco(write, text):
    """Random states and controls. The largest error is 1e-13."""
    assert largest_difference(write(text), states=20) < 1e-10


@pytest.mark.parametrize("text", [OTHERS, HUNG], ids=["cat", "crane"])
def test_differences_from_mujocos_numbers_are_said(write, text):
    """Mass, inertia, limits and motors. The crane has a motor that only pulls."""
    path = write(text)
    both = Imports(path, read_model(path))
    assert [each.element for each in differences(both) if not both.says(each.element)] == []
    if text == OTHERS:
        body = both.imported.experiment["creature"]["bodies"][1]
        body["joint"]["limits_deg"][0] = [-50.0, 41.0]
        both.imported.experiment["creature"]["bodies"][3]["joint"]["actuator"]["torque_limit"] = 9.0
        both.imported.experiment["creature"]["materials"][body["material"]]["density"] *= 1.01
        found = [each.element for each in differences(Imports(path, both.imported))]
        tail = "actuator number 1 (unnamed)"
        assert found == ["body 'hip'", "body 'hip'", "total mass", "joint 'swing'", tail]


# Motors on a joint or a tendon, the largest force by MuJoCo's laws, and whether its size changes.
# Limits of tendons and actuators hold before the gear, and those of joints after the gear.
INTEGRATED = '<general joint="h" dyntype="integrator"'
LIMITED = [
    ('<motor tendon="t" gear="2"/>', 'tendon="-1 1"', 2.0, False),
    ('<motor tendon="t" gear="-2"/>', 'tendon="-1 3"', 6.0, True),
    ('<motor joint="h" gear="2"/>', 'joint="-1 1"', 1.0, False),
    ('<velocity tendon="t" kv="3" gear="2" forcerange="-1 1"/>', "", 2.0, False),
    ('<position joint="h" kp="10" gear="10" forcerange="-2.5 3.1"/>', "", 31.0, True),
    ('<motor joint="h" forcerange="-3 1"/>', 'joint="-1 2"', 1.0, False),
    ('<motor joint="h" gear="-1" forcerange="-3 1e15"/>', "", np.inf, True),
    ('<velocity joint="h" kv="1" forcerange="-inf inf"/>', "", np.inf, False),
    ('<motor joint="h" gear="-4" ctrlrange="0 1"/>', "", 4.0, True),
    ('<general joint="h" gear="2" gainprm="-5" ctrlrange="-1 1"/>', "", 10.0, False),
    (f'{INTEGRATED} gainprm="3" actlimited="true" actrange="-2 2"/>', "", 6.0, False),
    # The command is a rate that is integrated.
    (f'{INTEGRATED} ctrlrange="-2 2"/>', "", np.inf, False),
]


@pytest.mark.parametrize(("motor", "whole", "largest", "changed"), LIMITED)
def test_the_largest_force_equals_mujocos(write, motor, whole, largest, changed):
    """Limits of unequal size become the larger one, and are named with both values."""
    kind, _, limits = whole.partition("=")
    attribute = f" actuatorfrcrange={limits}"
    hinge = HINGE.replace("/>", attribute * (kind == "joint") + "/>")
    tendon = f'<fixed name="t"{attribute * (kind == "tendon")}><joint joint="h" coef="1"/></fixed>'
    named = motor.replace(" ", ' name="m" ', 1)
    path = write(model(joints=hinge, extra=f"<tendon>{tendon}</tendon>", actuators=named))
    both = Imports(path, read_model(path))
    laws = both.tree.tendons if both.tree.tendons and "tendon=" in motor else both.tree
    assert laws.torque_limit.tolist() == [largest]
    assert [each.element for each in differences(both)] == ["actuator 'm'"] * changed
    assert both.says("actuator 'm'") == changed


FLOOR = '<geom name="floor" type="plane" size="5 5 1" friction="0.6" {}/>'
# Attributes of the floor, of the limb's geom, and contacts.
FRICTIONS = {
    "larger": ("", "", ""),
    "priority of the floor": ('priority="1"', "", ""),
    "priority of the limb": ("", 'friction="0.3" priority="2"', ""),
    "geoms without friction": ('condim="1"', 'condim="1"', ""),
    "one geom with friction": ("", 'condim="1"', ""),
    "pair": ("", "", '<pair geom1="g" geom2="floor" friction=".2 .2"/>'),
    "pair of a class": ("", "", '<pair geom1="g" geom2="floor" class="ice"/>'),
    "pair without friction": ("", "", '<pair geom1="g" geom2="floor" condim="1"/>'),
    "pair without types": (
        "",
        'contype="0" conaffinity="0"',
        '<pair geom1="g" geom2="floor" friction="3 3"/>',
    ),
    "excluded": ("", "", '<exclude body1="world" body2="limb"/>'),
    "excluded, with a pair": (
        "",
        "",
        '<exclude body1="world" body2="limb"/><pair geom1="floor" geom2="g" friction=".1 .1"/>',
    ),
}


@pytest.mark.parametrize("name", FRICTIONS)
def test_friction_on_the_ground_equals_mujocos(write, name):
    floor, limb, contact = FRICTIONS[name]
    ice = '<default><default class="ice"><pair friction=".02 .02"/></default></default>'
    text = model(geoms=LIMB.replace("/>", f" {limb}/>"), extra=f"<contact>{contact}</contact>{ice}")
    path = write(text.replace("<worldbody>", f"<worldbody>{FLOOR.format(floor)}"))
    theirs = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(theirs)
    mujoco.mj_forward(theirs, data)
    touching = {int(theirs.geom_bodyid[contact.geom[1]]): contact for contact in data.contact}
    found = read_model(path)
    ground, creature = found.experiment["world"]["ground"], creature_of(found)
    for body, own in enumerate(creature.bodies, start=1):
        if body not in touching:
            assert found.left_out[0] == "passage through the ground of geom 'g'"
            continue
        friction = combine(
            ground["friction_rule"], own.material.dynamic_friction, ground["dynamic_friction"]
        )
        contact = touching[body]
        assert friction == pytest.approx(contact.friction[0] if contact.dim > 1 else 0.0)


def test_other_numbers_of_a_pair_are_named(read):
    pair = '<pair name="p" geom1="floor" geom2="g" friction="{}" {}/>'
    left_out = 'margin="0.1" gap="0.01" solref="0.1 1" solimp="0.5 0.6" condim="6"'
    contact = f"<contact>{pair.format('.02 1', left_out)}</contact>"
    text = model(extra=contact).replace("<worldbody>", f"<worldbody>{FLOOR.format('')}")
    found = read(text)
    assert found.changed == ("pair 'p': its friction, 0.02 and 1 in two directions, becomes 0.02",)
    words = ("margin", "gap", "solref", "solimp", "condim above 3")
    assert {f"{word} of pair 'p'" for word in words} <= set(found.left_out)


@pytest.mark.parametrize(
    ("planes", "floor", "named"),
    [
        (["0 0 0", "0 0 0.2 {45}"], {}, "geom 'p1' (a second plane, tilted by 45 degrees)"),
        (["0 0 9", "0 0 -1"], {"height": -1.0}, "geom 'p0' (a second plane, tilted by 0 degrees)"),
        (["0 0 -1", "0 0 -2"], {"height": -1.0}, "geom 'p1' (a second plane, tilted by 0 degrees)"),
        (
            ["0 0 0 {30}", "0 0 0 {-10}"],
            {"slope_deg": 10.0, "downhill_deg": 90.0},
            "geom 'p0' (a second plane, tilted by 30 degrees)",
        ),
        (["0 0 9"], {"height": 9.0}, None),
        (["0 -9 0 {-90}", "0 0 0"], {}, "geom 'p0' (a second plane, tilted by 90 degrees)"),
    ],
)
def test_the_most_level_plane_below_is_the_ground(read, planes, floor, named):
    geoms = ""
    for i, plane in enumerate(planes):
        place, _, angle = plane.partition(" {")
        turn = f'euler="{np.deg2rad(float(angle[:-1] or 0))} 0 0"' if angle else ""
        geoms += f'<geom name="p{i}" type="plane" size="5 5 1" pos="{place}" {turn}/>'
    found = read(model().replace("<worldbody>", f"<worldbody>{geoms}"))
    ground = found.experiment["world"]["ground"]
    keys = {key: x for key, x in ground.get("floor", {}).items() if key != "type"}
    assert keys == pytest.approx(floor)
    planes = [phrase for phrase in found.left_out if "second plane" in phrase]
    assert planes == ([named] if named else [])


def test_a_motor_of_a_tendon_needs_a_free_joint(read):
    """The motor of the first tendon follows the command of the only free joint."""
    tendons = "".join(f'<fixed name="{t}"><joint joint="h" coef="1"/></fixed>' for t in "tu")
    text = model(extra=f"<tendon>{tendons}</tendon>", actuators=MOTOR + '<motor tendon="t"/>')
    words = "tendon 't': it has a motor, but each of its joints has a motor or gives its command"
    with pytest.raises(ExchangeError, match=words):
        read(text)
    found = read(text, drop=True)
    assert words in found.dropped[0] and "tendons" not in found.experiment["creature"]
    text = model(
        extra=f"<tendon>{tendons}</tendon>", actuators='<motor tendon="t"/><motor tendon="u"/>'
    )
    found = read(text, drop=True)
    assert [tendon["name"] for tendon in found.experiment["creature"]["tendons"]] == ["t"]
    assert "tendon 'u': it has a motor" in found.dropped[0]


def test_a_foreign_model_keeps_its_numbers(read):
    found = read(OTHERS, motor_gain=0.7)
    assert found.left_out == ("friction between bodies of the animal", "2 lights", "1 camera")
    creature = creature_of(found)
    names = ("torso", "hip", "knee", "tail")
    assert tuple(body.name for body in creature.bodies) == names
    torso, hip, knee, tail = creature.bodies
    # The root is rotated by 90 degrees, so it is 0.6 m long.
    np.testing.assert_allclose(torso.shape.half_extents, [0.3, 0.1, 0.05])
    assert (torso.color, hip.material.dynamic_friction) == ("#336699", 0.9)
    assert hip.joint and knee.joint and tail.joint
    np.testing.assert_allclose(np.rad2deg(hip.joint.lower), [-50, -40])
    assert knee.joint.actuator == Actuator(0.7, 10.0)
    assert tail.joint.actuator == Actuator(2.0, 8.0, stiffness=12.0)


def test_an_import_is_a_whole_experiment(read):
    """The world, the start and the task follow the file."""
    found = read(OTHERS).experiment
    config = check_config(found, "model.xml")
    assert (config.world.gravity, config.world.water) == (3.7, None)
    assert found["world"]["ground"] == {
        "restitution": 0.0,
        "static_friction": 0.7,
        "dynamic_friction": 0.7,
        "friction_rule": "max",
        "floor": {"type": "plane", "height": 0.1},
    }
    # The knee's ellipsoid is the lowest body.
    assert 0.05 < found["simulation"]["start_clearance"] < 0.3
    assert (config.task.type, config.controller.type) == ("walk", "brain_cpg")
    assert found["controller"]["angle_range_deg"] == 40.0
    assert found["creature"]["self_collision"] is True


def test_a_medium_of_mujoco_is_water(read):
    text = model(extra='<option density="1000" viscosity="0.1" wind="1 0 0"/>')
    found = read(text).experiment
    assert found["world"]["water"] == {
        "density": 1000.0,
        "viscosity": 0.1,
        "current": [1.0, 0.0, 0.0],
    }
    assert found["task"] == {"type": "distance", "heading": "forward"}


def test_compensated_gravity_is_less_gravity(read):
    """The same lift on every kg. In a liquid, the lift of a fluid of one density is buoyancy."""
    lifted = model(attributes='gravcomp="0.75"').replace('"trunk"', '"trunk" gravcomp="0.75"')
    assert read(lifted).experiment["world"] == {"gravity": 9.81 / 4, "water": None}
    wet = lifted.replace("<worldbody>", '<option density="750"/><worldbody>')
    assert read(wet).experiment["world"] == {"gravity": 9.81, "water": {"density": 750.0}}


def test_trees_on_the_world_hang_on_a_fixed_root(read):
    beside = '<body name="other" pos="0 1 0"><joint type="slide"/><geom size="0.1"/></body>'
    found = read(model(free='<joint axis="0 1 0"/>', beside=beside))
    bodies = {body["name"]: body for body in found.experiment["creature"]["bodies"]}
    assert list(bodies) == ["base", "trunk", "limb", "other"]
    assert bodies["base"]["joint"]["axes"] == [] and bodies["base"]["shape"] is None
    assert bodies["trunk"]["joint"]["parent"] == bodies["other"]["joint"]["parent"] == "base"
    assert found.warnings[-1].startswith("the root 'base' does not move")


def test_contact_rules_become_exceptions(read):
    """An ``exclude`` parts two limbs, and one limb touches nothing."""
    limb = '<body name="{}" pos="0 {} 0"><joint axis="1 0 0"/><geom size="0.1" {}/></body>'
    none = 'contype="0" conaffinity="0"'
    limbs = "".join(limb.format(f"limb{i}", i, none * (i == 3)) for i in (1, 2, 3))
    text = model().replace("</body></body>", f"</body>{limbs}</body>")
    excluded = '<contact><exclude body1="limb" body2="limb1"/></contact><worldbody>'
    rule = read(text.replace("<worldbody>", excluded)).experiment["creature"]["self_collision"]
    assert rule == {"exclude": [["limb3", "all"], ["limb", "limb1"]]}
    alone = read(text.replace("<worldbody>", f"<default><geom {none}/></default><worldbody>"))
    assert alone.experiment["creature"]["self_collision"] is False


# Two hinges of one body with values of their own.
UNLIKE = """
<joint name="a" limited="false" stiffness="2" springref="0.5" damping="1"/>
<joint name="b" axis="0 1 0" range="-1 1" stiffness="2" armature="0.1" damping="1"
  frictionloss="3"/>
"""


def test_hinges_of_a_body_keep_values_of_their_own(read):
    motors = '<motor joint="a" gear="3"/><velocity joint="b" kv="2"/>'
    joint = creature_of(read(model(joints=UNLIKE, actuators=motors))).bodies[1].joint
    assert joint is not None
    assert (joint.stiffness, joint.damping, joint.armature) == (2.0, 1.0, (0.0, 0.1))
    np.testing.assert_allclose(joint.rest, (0.5, 0.0))
    assert joint.friction_loss == (0.0, 3.0)
    np.testing.assert_allclose([joint.lower, joint.upper], [[-NO_LIMIT, -1], [NO_LIMIT, 1]])
    assert [dof.actuator for dof in joint.dofs] == [TorqueMotor(3.0), Actuator(2.0)]


HINGE = '<joint name="h" range="-1 1"/>'
LIMB = '<geom name="g" size="0.1"/>'
MOTOR = '<motor name="m" joint="h" ctrlrange="-1 1"/>'


def model(
    joints: str = HINGE,
    geoms: str = LIMB,
    actuators: str = "",
    free: str = "<freejoint/>",
    trunk: str = '<geom size="0.1"/>',
    extra: str = "",
    beside: str = "",
    attributes: str = "",
) -> str:
    """Return a trunk with one limb."""
    return (
        '<mujoco><compiler angle="radian"/>'
        f'<worldbody><body name="trunk">{free}{trunk}'
        f'<body name="limb" pos="0.3 0 0" {attributes}>{joints}{geoms}</body></body>{beside}'
        f"</worldbody><actuator>{actuators}</actuator>{extra}</mujoco>"
    )


OTHER = '<body name="other">{}<geom size="1"/></body>'


SITE = '<site name="s"/>'
VELOCITY = '<velocity name="m" joint="h" kv="1" {}/>'
LEVER = '<tendon><fixed name="t"><joint joint="h" coef="-2"/></fixed></tendon>'
CUT = HINGE.replace("/>", ' actuatorfrcrange="-3 3"/>')
DISABLED = '<option actuatorgroupdisable="1 2"/>'
DAMPED = '<joint name="root" type="free" damping="1" armature="0.1"/>'


@pytest.mark.parametrize(
    ("text", "element", "word"),
    [
        ("<mujoco/>", "body 'world'", "no body"),
        (model(free="", joints=""), "body 'trunk'", "--free"),
        (
            model(beside=OTHER.format('<joint name="j"/>'), actuators='<motor joint="j"/>'),
            *("body 'trunk'", "beside body 'other'"),
        ),
        (model(joints='<joint name="h" type="ball"/><joint type="slide"/>'), "'h'", "ball"),
        (model(joints=2 * '<joint axis="1 0 0"/>'), "unnamed joint of body 'limb'", "independent"),
        (
            model(actuators='<general name="m" joint="h" gaintype="affine" gainprm="1 1 0"/>'),
            *("actuator 'm'", "linear"),
        ),
        (
            model(actuators=2 * '<velocity joint="h" kv="1"/>'),
            *(r"actuator number 1 \(unnamed\)", "second"),
        ),
        (
            model(geoms=LIMB + SITE, actuators='<motor name="m" site="s" gear="1 0 0"/>'),
            *("actuator 'm'", "hinge"),
        ),
        (model(joints=HINGE.replace("/>", ' damping="-1"/>')), "joint 'h'", "damping: -1.0"),
        (model(geoms='<geom size="0.1" friction="-1"/>'), "static_friction", "-1.0"),
        (model(geoms='<geom name="g" type="box" size="1 1e13 1"/>'), "geom 'g'", "size.1"),
        (model(actuators=VELOCITY.format('gear="1e200"')), "joint 'h'", "actuator.gain: inf"),
        (model(actuators=VELOCITY.format('group="2"'), extra=DISABLED), "actuator 'm'", "group, 2"),
        (model(free=DAMPED), "joint 'root'", "damping 1, armature 0.1"),
        (
            model(joints=CUT, extra=LEVER, actuators='<motor tendon="t" ctrlrange="-1.6 1.6"/>'),
            *("joint 'h'", "tendon's motor"),
        ),
        ("<mujoco><wolrd/></mujoco>", "MuJoCo", "'wolrd', line 1"),
    ],
)
def test_unsupported_elements_are_refused_by_name(read, tmp_path, text, element, word):
    with pytest.raises(ExchangeError, match=f"{element}.*{word}") as refusal:
        read(text)
    assert str(refusal.value).startswith(f"{tmp_path / 'model.xml'}: ")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (model(attributes='quat="nan 0 0 1"'), "body 'limb': its quat"),
        (model(attributes='gravcomp="nan"'), "body 'limb': its gravcomp"),
        (model(geoms='<geom name="g" size="0.1" friction="nan"/>'), "geom 'g': its friction"),
        (model(joints=HINGE.replace("/>", ' pos="0 nan 0"/>')), "joint 'h': its pos"),
        (model(joints=HINGE.replace("-1 1", "-1 nan")), "joint 'h': its range"),
        (model(joints=HINGE.replace("/>", ' damping="nan"/>')), "joint 'h': its damping"),
        (model(joints=CUT.replace("-3 3", "-1 nan")), "joint 'h': its actuatorfrcrange"),
        (model(actuators=VELOCITY.format('gear="nan"')), "actuator 'm': its gear"),
    ],
)
def test_elements_without_numbers_are_refused(read, tmp_path, monkeypatch, text, expected):
    # MuJoCo writes warnings to a file in the working folder.
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ExchangeError) as refusal:
        read(text, drop=True)
    assert str(refusal.value).startswith(f"{tmp_path / 'model.xml'}: {expected}")


def test_refused_parts_can_be_dropped(read):
    """The parts are listed as in the refusal. The tree with the most motors stays."""
    ball = OTHER.format("<freejoint/>")
    text = model(
        actuators=MOTOR, beside=ball, extra='<equality><joint name="e" joint1="h"/></equality>'
    )
    found = read(text, drop=True)
    assert [words.partition(":")[0] for words in found.dropped] == ["equality 'e'", "body 'other'"]
    assert [body["name"] for body in found.experiment["creature"]["bodies"]] == ["trunk", "limb"]
    arm = '<body name="arm"><joint name="j"/><joint name="k" axis="1 0 0"/><geom size="1"/></body>'
    driven = ball.replace("<geom", f"{arm}<geom")
    tendon = '<tendon><fixed name="t"><joint joint="k" coef="1"/></fixed></tendon>'
    for more, kept in (("", "trunk"), ('<motor tendon="t"/>', "other")):
        actuators = f'{MOTOR}<motor joint="j"/>{more}'
        found = read(model(actuators=actuators, beside=driven, extra=tendon), drop=True)
        assert found.experiment["creature"]["bodies"][0]["name"] == kept
        assert len(found.dropped) == 1 and "it moves beside body" in found.dropped[0]


def test_a_chain_of_any_length_has_one_top():
    """Longer than Python's stack."""
    assert _top(np.maximum(np.arange(3000) - 1, 0), 2999) == 1


def test_a_dropped_mocap_body_is_a_fixed_root(read):
    text = model(free="").replace('<body name="trunk">', '<body name="trunk" mocap="true">')
    with pytest.raises(ExchangeError, match="body 'trunk': it is a mocap body, moved from outside"):
        read(text)
    found = read(text, drop=True).experiment["creature"]
    assert [body["name"] for body in found["bodies"]] == ["trunk", "limb"]
    assert found["bodies"][0]["joint"]["axes"] == []


def test_a_dropped_ball_leaves_the_other_joints_of_its_body(read):
    found = read(model(joints=HINGE + '<joint name="b" type="ball"/>'), drop=True)
    assert found.dropped[0].startswith("joint 'b': it shares its body")
    assert found.joints == {"limb": (1,)}
    assert found.experiment["creature"]["bodies"][1]["joint"]["axes"] == ["z"]


def test_a_limit_that_a_motor_of_a_tendon_never_reaches_is_accepted(read):
    """Twice 1.4 N and the joint's own motor of 0.1 N m give 2.9 N m, within 3 N m."""
    text = model(
        joints=HINGE.replace("/>", ' actuatorfrcrange="-3 3"/><joint name="k" axis="1 0 0"/>'),
        extra='<tendon><fixed name="t"><joint joint="h" coef="-2"/><joint joint="k" coef="1"/>'
        "</fixed></tendon>",
        actuators='<motor tendon="t" ctrlrange="-1.4 1.4"/><motor joint="h" ctrlrange="-.1 .1"/>',
    )
    tendon = read(text).experiment["creature"]["tendons"][0]
    assert tendon["actuator"]["torque_limit"] == 1.4
    with pytest.raises(ExchangeError, match="actuatorfrcrange limits the force of a tendon"):
        read(text.replace('ctrlrange="-.1 .1"', 'ctrlrange="-.3 .3"'))


def test_all_joints_that_no_creature_has_are_listed(read):
    """MuJoCo takes parallel axes in one body. The other faults are in the same list."""
    parallel = HINGE + '<joint/><site name="a"/><site name="b"/>'
    tendon = '<spatial name="t" stiffness="1"><site site="a"/><site site="b"/></spatial>'
    others = f'<equality><joint joint1="h"/></equality><tendon>{tendon}</tendon>'
    text = model(joints=parallel, extra=others)
    with pytest.raises(ExchangeError) as refusal:
        read(text)
    assert "tendon 't': it runs through sites" in str(refusal.value)
    assert "unnamed equality of joint 'h': a creature cannot have it" in str(refusal.value)
    assert "joint 'h': axes: must be linearly independent and not zero" in str(refusal.value)


def test_a_servo_for_a_torque_motor_without_limits_is_refused(read):
    words = r"'m': it has no limits\. Allowed: ctrlrange or forcer"
    unlimited = model(actuators=MOTOR.replace('ctrlrange="-1 1"', ""))
    with pytest.raises(ExchangeError, match=words):
        read(unlimited, motor_gain=1.0)
    weaker = HINGE.replace("/>", ' actuatorfrcrange="-0.5 0.5"/>')
    found = creature_of(read(model(joints=weaker, actuators=MOTOR), motor_gain=2.0))
    assert found.bodies[1].joint and found.bodies[1].joint.actuator == Actuator(2.0, 0.5)


def test_small_numbers_are_kept(read):
    """Values are smaller than the rounding of positions."""
    tiny = 'stiffness="3e-14" damping="2e-15" armature="1e-16"'
    found = creature_of(
        read(
            model(
                joints=HINGE.replace("/>", f" {tiny}/>"),
                geoms='<geom size="100" mass="1e-9"/>',
                actuators='<velocity joint="h" kv="1e-13" forcerange="-4e-14 4e-14"/>',
            )
        )
    )
    joint = found.bodies[1].joint
    assert joint and joint.actuator == Actuator(1e-13, 4e-14)
    assert (joint.stiffness, joint.damping, joint.armature) == (3e-14, 2e-15, 1e-16)
    assert build_tree(found).mass.tolist() == pytest.approx([4.18879, 1e-9])


def test_names_are_made_unique(read):
    """A body without a name has its joint's. Names with a meaning of ours are changed."""
    text = model().replace('name="limb"', "").replace('name="trunk"', 'name="h"')
    names = [body["name"] for body in read(text).experiment["creature"]["bodies"]]
    assert names == ["h", "h_"]
    odd = model().replace('"limb"', '"li&#10;mb{i}"').replace('"trunk"', '"all"')
    names = [body["name"] for body in read(odd).experiment["creature"]["bodies"]]
    assert names == ["all_", "li_mb_i_"]
    escaped = model().replace("<mujoco>", '<mujoco model="cat&#27;[31m">')
    assert read(escaped).experiment["creature"]["name"] == "cat_[31m"


@pytest.mark.parametrize("name", ["missing.xml", "", 300 * "a", "model.xml/model.xml"])
def test_a_file_that_cannot_be_read_is_named(tmp_path, name):
    (tmp_path / "model.xml").write_text("<mujoco/>")
    with pytest.raises(ExchangeError, match=f"^{tmp_path / name}: (no such|cannot be read)"):
        read_model(tmp_path / name)


def test_text_that_is_not_utf_8_is_named(write):
    path = write("")
    head = '<?xml version="1.0" encoding="ISO-8859-1"?><mujoco model="chèvre">'
    path.write_bytes(model().replace("<mujoco>", head).encode("latin-1"))
    with pytest.raises(ExchangeError, match=r"b'ch\\xe8vre' is not UTF-8 text"):
        read_model(path)


def test_without_mujoco_the_extra_is_named(read, monkeypatch):
    def missing(name: str):
        raise ModuleNotFoundError(name=name)

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(ExchangeError, match=r"needs MuJoCo\. Install it with `.*\[mujoco\]'`"):
        read(model())
