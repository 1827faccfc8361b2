"""A creature comes back as it went out, other people's models move as in MuJoCo, or are refused."""

import dataclasses
import importlib

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
import yaml

from creatures import STRUCTURES, quick_jit, random_creature
from evo_cpg.config.build import build_creature
from evo_cpg.config.load import dump_creature, load_config
from evo_cpg.config.schema.creature import CreatureConfig
from evo_cpg.creature.creature import Actuator, Creature
from evo_cpg.creature.shapes import Capsule
from evo_cpg.creature.tree import build_tree
from evo_cpg.exchange.mjcf_export import mjcf_model, mjcf_text
from evo_cpg.exchange.mjcf_import import read_mjcf
from evo_cpg.exchange.refusals import ExchangeError
from evo_cpg.physics.articulated import solve
from evo_cpg.physics.body_equations import body_equations
from evo_cpg.physics.joint_torque import passive_torque
from evo_cpg.physics.kinematics import kinematics
from evo_cpg.physics.state import resting_state
from evo_cpg.physics.water import Water
from evo_cpg.physics.world import World
from evo_cpg.spatial.linear import expand_dims_like
from tiny_run import REPOSITORY

CONFIGS = sorted((REPOSITORY / "configs").glob("*.yaml"))
GRAVITY = 9.81

# Everything that MuJoCo resolves: classes, degrees, a root turned by 90 degrees, fromto, a geom
# turned in its body, joints beside the origin, ref, gear, mass in place of density.
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
    <geom name="floor" type="plane" size="5 5 1"/>
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


@pytest.fixture
def read(tmp_path):
    """What a model's text comes to."""

    def call(text: str, **options):
        path = tmp_path / "model.xml"
        path.write_text(text, encoding="utf-8")
        return read_mjcf(path, **options)

    return call


def as_written(config: CreatureConfig) -> Creature:
    """The creature that is in its file."""
    return CreatureConfig.model_validate(yaml.safe_load(dump_creature(config))).build()


def assert_same(found: Creature, expected: Creature) -> None:
    """Two creatures have the same bodies, in any order: to 10 digits."""

    def close(a, b):
        np.testing.assert_allclose(a, b, rtol=1e-10, atol=1e-10)

    assert {body.name for body in found.bodies} == {body.name for body in expected.bodies}
    for theirs in expected.bodies:
        ours = found.bodies[found.body_index(theirs.name)]
        assert type(ours.shape) is type(theirs.shape)
        close(ours.shape.half_extents, theirs.shape.half_extents)
        close(ours.material.density, theirs.material.density)
        close(ours.material.dynamic_friction, theirs.material.dynamic_friction)
        assert ours.color == theirs.color
        if theirs.joint is None:
            assert ours.joint is None
            continue
        assert ours.joint is not None and ours.joint.parent == theirs.joint.parent
        for field in dataclasses.fields(theirs.joint):
            mine, given = getattr(ours.joint, field.name), getattr(theirs.joint, field.name)
            if field.name == "actuator":
                assert (mine is None) == (given is None)
                if given is not None:
                    close(dataclasses.astuple(mine), dataclasses.astuple(given))
            elif field.name != "parent":
                close(mine, given)


@pytest.mark.parametrize("number", range(len(STRUCTURES)))
def test_a_creature_comes_back_as_it_went_out(read, number):
    rng = np.random.default_rng(number)
    motor = (None, Actuator(2.0, 3.0, stiffness=5.0), Actuator(0.5))[number % 3]
    creature = random_creature(rng, STRUCTURES[number], 1.2, motor, axes_seed=number)
    painted = dataclasses.replace(creature.bodies[1], color="#12ab9f")
    creature = dataclasses.replace(
        creature, bodies=(creature.bodies[0], painted, *creature.bodies[2:])
    )
    found, left_out = read(mjcf_text(mjcf_model(creature, 0.0)))
    assert_same(as_written(found), creature)
    assert (found.name, left_out) == ("random", ())


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_shipped_animals_come_back_as_they_went_out(read, path):
    creature = build_creature(load_config(path), path)
    water = Water(1000.0)
    found, left_out = read(mjcf_text(mjcf_model(creature, GRAVITY, water=water)))
    assert_same(as_written(found), creature)
    assert left_out == (
        "gravity (0, 0, -9.81) m/s^2",
        "the buoyancy of a fluid of 1000 kg/m^3",
    )


def test_a_model_of_somebody_elses_moves_as_in_mujoco(read):
    """Joint accelerations from random angles and rates, the root at rest: to 1e-10.

    Of 100 such states the worst differs by 1.5e-12; the file has 10 digits.

    Its bodies' frames are not ours, so this asks for every anchor, axis, turn and inertia.
    """
    config, left_out = read(OTHERS, motor_gain=0.7)
    assert left_out == ("gravity (0, 0, -3.7) m/s^2", "geom 'floor'", "2 lights", "1 camera")
    creature = as_written(config)
    names = ("torso", "hip", "body3", "tail")
    assert tuple(body.name for body in creature.bodies) == names
    torso, hip, knee, tail = creature.bodies
    # Turned by 90 degrees it is 0.6 m long.
    np.testing.assert_allclose(torso.shape.half_extents, [0.3, 0.1, 0.05])
    assert (torso.color, hip.material.dynamic_friction) == ("#336699", 0.9)
    assert hip.joint and knee.joint and tail.joint
    np.testing.assert_allclose(np.rad2deg(hip.joint.lower), [-50, -40])
    assert knee.joint.actuator == Actuator(0.7, 10.0)
    assert tail.joint.actuator == Actuator(2.0, 8.0, stiffness=12.0)

    tree = build_tree(creature)
    model = mujoco.MjModel.from_xml_string(OTHERS)
    model.opt.disableflags |= (
        mujoco.mjtDisableBit.mjDSBL_ACTUATION
        | mujoco.mjtDisableBit.mjDSBL_CONTACT
        | mujoco.mjtDisableBit.mjDSBL_LIMIT
    )
    data = mujoco.MjData(model)
    owner = [tree.names[i] for i in tree.dof_bodies]
    assert owner == ["tail", "hip", "hip", "body3"]
    order = 1 + np.array([3, 0, 1, 2])
    rng = np.random.default_rng(0)

    @quick_jit
    def accelerations(state):
        kin = kinematics(tree, state)
        inertia, bias = body_equations(World(tree, 3.7), kin, 0.0)
        torque, derivative = passive_torque(tree, state, 0.0)
        rotor = derivative + expand_dims_like(tree.armature, torque)
        return solve(tree, kin, inertia, bias, torque, rotor).qdd

    for _ in range(5):
        # Within the limits, where there is no torque but the springs'.
        q, qd = rng.uniform(-0.6, 0.6, 4), rng.normal(scale=3.0, size=4)
        rest = resting_state(tree, dtype=float)
        state = dataclasses.replace(rest, q=jnp.asarray(q), qd=jnp.asarray(qd))
        data.qpos = model.qpos0
        data.qpos[6 + order] += q
        data.qvel[5 + order] = qd
        mujoco.mj_forward(model, data)
        theirs = data.qacc[5 + order]
        np.testing.assert_allclose(
            accelerations(state), theirs, rtol=0, atol=1e-10 * np.abs(theirs).max()
        )


HINGE = '<joint name="h" range="-1 1"/>'
SPARE_HINGE = '<joint range="-1 1"/>'
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
    """A trunk with one limb."""
    return (
        '<mujoco><compiler angle="radian"/>'
        f'<worldbody><body name="trunk">{free}{trunk}'
        f'<body name="limb" pos="0.3 0 0" {attributes}>{joints}{geoms}</body></body>{beside}'
        f"</worldbody><actuator>{actuators}</actuator>{extra}</mujoco>"
    )


def rod_inertia(radius: float, length: float) -> np.ndarray:
    """Moments of a capsule of 1 kg across its axis and about it, kg m^2."""
    along, _, across = Capsule(radius, length).inertia(1.0)
    return np.array([across, along])


def two(first: str = "", second: str = "") -> str:
    return f'<joint name="a" range="-1 1" {first}/><joint name="b" axis="0 1 0" {second}/>'.replace(
        '1 0"', '1 0" range="-1 1"'
    )


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("<mujoco/>", "the worldbody holds no body; allowed: one"),
        (
            model(beside='<body name="other"><freejoint/><geom size="1"/></body>'),
            "body 'other': it stands in the worldbody beside body 'trunk'; allowed: one body there",
        ),
        (model(free=""), "body 'trunk': the root does not float freely; allowed: a freejoint"),
        (
            model(free='<joint name="root" type="free" damping="2"/>'),
            "joint 'root': it has damping; allowed: no damping",
        ),
        (model(joints=""), "body 'limb': it is welded to its parent; allowed: one to three hinges"),
        (
            model(joints="".join(f'<joint axis="1 {i} 0" range="-1 1"/>' for i in range(4))),
            "body 'limb': it has 4 joints; allowed: one to three hinges",
        ),
        (
            model(joints='<joint name="h" type="ball"/>'),
            "joint 'h': it is a ball joint; allowed: one to three hinges at one place",
        ),
        (model(joints='<joint type="slide"/>'), "unnamed joint of body 'limb': it is a slide join"),
        (model(joints='<joint name="h"/>'), "joint 'h': it has no limits; allowed: a range"),
        (
            model(joints='<joint name="h" range="-1 1" frictionloss="0.1"/>'),
            "joint 'h': it has frictionloss; allowed: no frictionloss",
        ),
        (
            model(joints='<joint name="h" range="-1 1" stiffness="1" springref="0.2"/>'),
            "joint 'h': its springref is not its ref; allowed: a spring to the neutral pose",
        ),
        (
            model(joints=two(second='pos="0 0 0.1"')),
            "joint 'b': its pos is not that of joint 'a'; allowed: the same pos for all hinges",
        ),
        (model(joints=two('damping="1"')), "joint 'b': its damping is not that of joint 'a'"),
        (model(joints=two('armature="1"')), "joint 'b': its armature is not that of joint 'a'"),
        (model(joints=two('stiffness="1"')), "joint 'b': its stiffness is not that of joint 'a'"),
        (
            model(joints=two(), actuators='<velocity joint="a" kv="1"/>'),
            "joint 'b': its actuator is not that of joint 'a'",
        ),
        (
            model(joints=two().replace("0 1 0", "0 0 1")),
            "body 'limb': axes: must be linearly independent and not zero",
        ),
        (
            model(
                joints="".join(
                    f'<joint axis="{axis}" range="-1.55 1.55"/>'
                    for axis in ("1 0 0", "0 1 0", "0 0 1")
                )
            ),
            "body 'limb': limits_deg: the three axes lie in one plane if the middle one turns by "
            "-90 degrees",
        ),
        (model(geoms=LIMB + '<geom size="0.2"/>'), "body 'limb': it has 2 geoms; allowed: one"),
        (
            model(geoms='<geom name="g" type="cylinder" size="0.1 0.2"/>'),
            "geom 'g': it is a cylinder; allowed: box, sphere, ellipsoid, capsule",
        ),
        (
            model(trunk='<geom name="t" type="capsule" size="0.1 0.2"/>'),
            "geom 't': the root's capsule stands askew in the world; allowed: edges and axes along",
        ),
        (
            model(trunk='<geom name="t" type="box" size="0.1 0.2 0.3" euler="0 0 0.3"/>'),
            "geom 't': the root's box stands askew in the world",
        ),
        (
            model(geoms=f'<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>{LIMB}'),
            "body 'limb': its centre of mass or inertia is not that of its sphere; allowed: uni",
        ),
        (
            model(attributes='gravcomp="1"'),
            "body 'limb': its gravcomp is not the buoyancy of a fluid around all bodies; allowed",
        ),
        (
            model(actuators=MOTOR),
            "actuator 'm': it gives a torque, and our motors are servos; allowed: position, velo",
        ),
        (
            model(actuators='<position name="m" joint="h" kp="1"/>'),
            "actuator 'm': it is undamped; allowed: a kv of more than 0",
        ),
        (
            model(actuators='<intvelocity name="m" joint="h" actrange="-1 1"/>'),
            "actuator 'm': its law is not that of a servo; allowed: position, velocity, motor",
        ),
        (
            model(actuators='<general name="m" joint="h" biastype="affine" biasprm="1 0 -1"/>'),
            "actuator 'm': its law is not that of a servo",
        ),
        (
            model(actuators='<velocity name="m" joint="h" kv="1" forcerange="-1 2"/>'),
            "actuator 'm': its limits -1 and 2 differ; allowed: equal limits",
        ),
        (
            model(actuators=2 * '<velocity joint="h" kv="1"/>'),
            "actuator number 1 (unnamed): it is the second that drives joint 'h'; allowed: one",
        ),
        (
            model(
                geoms=LIMB + '<site name="s"/>', actuators='<motor name="m" site="s" gear="1 0 0"/>'
            ),
            "actuator 'm': it drives no hinge; allowed: joint=, a hinge",
        ),
        (
            model(extra='<equality><joint name="e" joint1="h"/></equality>'),
            "equality 'e': no creature has such a thing; allowed: no equality",
        ),
        (
            model(extra='<tendon><fixed name="t"><joint joint="h" coef="1"/></fixed></tendon>'),
            "tendon 't': no creature has such a thing; allowed: no tendon",
        ),
        (
            model(extra='<option><flag actuation="disable"/></option>'),
            "flag 'actuation': it is disabled; allowed: enable",
        ),
        (
            model(joints=HINGE.replace("/>", ' damping="-1"/>')),
            "joint of body 'limb': damping: -1.0: input should be greater than or equal to 0",
        ),
        (
            model(geoms='<geom name="g" size="0.1" friction="-1"/>'),
            "geom 'g': static_friction: -1.0: input should be greater than or equal to 0",
        ),
        (
            model(geoms='<geom name="g" size="0.1" density="1e15"/>'),
            "geom 'g': density: 1000000000000000.0: input should be less than or equal to 1000000",
        ),
        *(
            (model(geoms=f'<geom name="g" type="{kind}"/>'), f"geom 'g': {key}: ")
            for kind, key in (
                ('sphere" size="1e13', "radius"),
                ('capsule" size="1e13 1', "radius"),
                ('box" size="1 1e13 1', "size.1"),
                ('ellipsoid" size="1 1e13 1', "radii.1"),
            )
        ),
        *(
            (
                model(actuators=f'<velocity name="m" joint="h" {law}/>'),
                f"actuator 'm': gain: {gain}: input should be ",
            )
            for law, gain in (
                ('kv="1e13"', 1e13),
                ('kv="1" gear="1e200"', "inf"),
                ('kv="1" gear="1e-200"', 0.0),
            )
        ),
        (
            model(geoms=LIMB + 999 * f'<body>{SPARE_HINGE}<geom size="0.1"/></body>'),
            "model 'model': bodies: 1001 bodies with 'body1001'. Allowed: up to 1000",
        ),
        (
            model().replace('"limb"', '"limb&#27;[31m"'),
            r"body 'limb\x1b[31m': name: 'limb\x1b[31m': must be on one line, without control char",
        ),
        (
            model(
                actuators='<velocity name="m" joint="h" kv="1" group="2"/>',
                extra='<option actuatorgroupdisable="1 2"/>',
            ),
            "actuator 'm': actuatorgroupdisable disables its group, 2; allowed: an enabled group",
        ),
        (
            model(attributes='gravcomp="-1"').replace('="trunk"', '="trunk" gravcomp="-1"'),
            "body 'trunk': its gravcomp is not the buoyancy of a fluid around all bodies; allowed",
        ),
        (
            # A rod of 1 m by 1 mm, whose moment about its axis is 1.6 times that of a capsule.
            model(
                geoms='<inertial pos="0 0 0" mass="1" diaginertia="{0} {0} {1}"/>'.format(
                    *rod_inertia(0.0005, 1.0) * [1.0, 1.6]
                )
                + '<geom type="capsule" size="0.0005 0.5"/>'
            ),
            "body 'limb': its centre of mass or inertia is not that of its capsule; allowed: uni",
        ),
        (model().replace('"limb"', '"limb{i}"'), "body 'limb{i}': {i} stands for a number in our"),
        ("<mujoco><wolrd/></mujoco>", "unrecognized element Element 'wolrd', line 1"),
    ],
)
def test_what_no_creature_can_be_is_refused_by_name(read, tmp_path, text, expected):
    with pytest.raises(ExchangeError) as refusal:
        read(text)
    assert str(refusal.value).startswith(f"{tmp_path / 'model.xml'}: ")
    assert expected in str(refusal.value)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (model(attributes='quat="nan 0 0 1"'), "body 'limb': its orientation holds nan; allow"),
        (model(attributes='gravcomp="nan"'), "body 'limb': its gravcomp holds nan"),
        (model().replace("0.3 0 0", "nan 0 0"), "body 'limb': its pos holds nan; allowed: finite"),
        (model(geoms='<geom name="g" size="inf"/>'), "geom 'g': its size holds inf; allowed: fin"),
        (
            model(geoms='<geom name="g" size="0.1" friction="nan"/>'),
            "geom 'g': its friction holds nan",
        ),
        (
            model(geoms='<geom name="g" size="0.1" rgba="0 nan 0 1"/>'),
            "geom 'g': its rgba holds nan",
        ),
        (model(joints=HINGE.replace("/>", ' pos="0 nan 0"/>')), "joint 'h': its pos holds nan"),
        (model(joints=HINGE.replace("-1 1", "-1 nan")), "joint 'h': its range holds nan"),
        (model(joints=HINGE.replace("/>", ' damping="nan"/>')), "joint 'h': its damping holds nan"),
        (
            model(joints=HINGE.replace("/>", ' actuatorfrcrange="-1 nan"/>')),
            "joint 'h': its actuatorfrcrange holds nan; allowed: numbers",
        ),
        (
            model(actuators='<velocity name="m" joint="h" kv="1" forcerange="-1 nan"/>'),
            "actuator 'm': its forcerange holds nan; allowed: numbers",
        ),
        (
            model(actuators='<velocity name="m" joint="h" kv="1" gear="nan"/>'),
            "actuator 'm': its gear holds nan; allowed: finite numbers",
        ),
    ],
)
def test_what_is_no_number_is_refused(read, tmp_path, monkeypatch, text, expected):
    # MuJoCo warns in a file of the working folder.
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ExchangeError) as refusal:
        read(text)
    assert str(refusal.value).startswith(f"{tmp_path / 'model.xml'}: {expected}")


def test_a_torque_motor_needs_limits_to_be_a_servo(read):
    unlimited = model(actuators=MOTOR.replace('ctrlrange="-1 1"', ""))
    with pytest.raises(ExchangeError, match="'m': it has no limits; allowed: ctrlrange or forcer"):
        read(unlimited, motor_gain=1.0)
    unclamped = model(actuators=MOTOR, extra='<option><flag clampctrl="disable"/></option>')
    with pytest.raises(ExchangeError, match="'m': it has no limits; allowed: ctrlrange or forcer"):
        read(unclamped, motor_gain=1.0)
    weaker = HINGE.replace("/>", ' actuatorfrcrange="-0.5 0.5"/>')
    found = read(model(joints=weaker, actuators=MOTOR), motor_gain=2.0).creature.build()
    assert found.bodies[1].joint and found.bodies[1].joint.actuator == Actuator(2.0, 0.5)


def test_an_inertial_that_is_that_of_the_shape_comes_in(read):
    """Of a rod of 1 m by 1 mm that stands askew, with the digits that a file has."""
    inertial = (
        '<inertial pos="0 0 0" mass="1" euler="1 0.5 0" diaginertia="{0:.9g} {0:.9g} {1:.9g}"/>'
    )
    rod = inertial.format(*rod_inertia(0.0005, 1.0))
    rod += '<geom type="capsule" size="0.0005 0.5" euler="1 0.5 0"/>'
    assert read(model(geoms=rod)).creature.bodies[1].shape.type == "capsule"


def test_what_a_command_may_be_is_left_out(read):
    """Limits of servos' commands are named, but not where MuJoCo does not clamp commands."""
    limited = '<velocity name="m" joint="a" kv="1" ctrlrange="-1 1"/>'
    one = model(joints=HINGE.replace('"h"', '"a"'), actuators=limited)
    assert read(one).left_out[1:] == ("the ctrlrange of actuator 'm'",)
    position = '<position joint="{}" kp="10" kv="1" ctrlrange="-0.1 0.1"/>'
    both = model(joints=two(), actuators=position.format("a") + position.format("b"))
    assert read(both).left_out[1:] == ("the ctrlrange of 2 actuators",)
    free = one.replace("<worldbody>", '<option><flag clampctrl="disable"/></option><worldbody>')
    assert read(free).left_out[1:] == ()


def test_where_nothing_has_weight_nothing_floats(read):
    """Neither gravity nor what compensates it is left out where it is disabled."""
    flag = '<option><flag gravity="disable"/></option>'
    assert read(model(attributes='gravcomp="1"', extra=flag)).left_out == ()


def test_limits_beyond_all_that_we_allow_are_none(read):
    """Of a servo, of a torque motor and of its joint; those of one side still count."""
    law = '<velocity joint="h" kv="1" forcerange="{}"/>'
    for limits in ("-1e15 1e15", "-inf inf"):
        found = read(model(actuators=law.format(limits))).creature.build()
        assert found.bodies[1].joint and found.bodies[1].joint.actuator == Actuator(1.0)
        wide = HINGE.replace("/>", f' actuatorfrcrange="{limits}"/>')
        found = read(model(joints=wide, actuators=MOTOR), motor_gain=1.0).creature.build()
        assert found.bodies[1].joint and found.bodies[1].joint.actuator == Actuator(1.0, 1.0)
    with pytest.raises(ExchangeError, match="its limits -1 and inf differ"):
        read(model(actuators=law.format("-1 inf")))


def test_small_numbers_of_small_animals_are_kept(read):
    """Springs, dampers, rotors, motors and densities below what positions are rounded to."""
    tiny = 'stiffness="3e-14" damping="2e-15" armature="1e-16"'
    found = read(
        model(
            joints=HINGE.replace("/>", f" {tiny}/>"),
            geoms='<geom size="100" mass="1e-9"/>',
            actuators='<velocity joint="h" kv="1e-13" forcerange="-4e-14 4e-14"/>',
        )
    ).creature.build()
    joint = found.bodies[1].joint
    assert joint and joint.actuator == Actuator(1e-13, 4e-14)
    assert (joint.stiffness, joint.damping, joint.armature) == (3e-14, 2e-15, 1e-16)
    assert build_tree(found).mass.tolist() == pytest.approx([4.18879, 1e-9])


def test_colours_are_clipped(read):
    found = read(model(geoms='<geom size="0.1" rgba="1.5 -1 0.2 1"/>')).creature
    assert found.bodies[1].color == "#ff0033"


def test_names_are_made_up_where_there_are_none(read, tmp_path):
    """Bodies by their number, the creature by its file; nobody else's name is taken."""
    text = model().replace('name="limb"', "").replace('name="trunk"', 'name="body2"')
    found = read(text).creature
    assert [entry.name for entry in found.bodies] == ["body2", "body2_"]
    assert found.name == "model"


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("nowhere.xml", "no such file"),
        ("", r"cannot be read \(Is a directory\)"),
        (300 * "a", r"cannot be read \(File name too long\)"),
        ("model.xml/model.xml", r"cannot be read \(Not a directory\)"),
    ],
)
def test_a_file_that_cannot_be_read_is_named(tmp_path, name, expected):
    (tmp_path / "model.xml").write_text("<mujoco/>")
    with pytest.raises(ExchangeError, match=f"^{tmp_path / name}: {expected}$"):
        read_mjcf(tmp_path / name)


def test_a_urdf_is_told_from_mjcf(read):
    with pytest.raises(ExchangeError, match=r"it is a URDF; allowed: MJCF"):
        read('<?xml version="1.0"?><!-- a robot --><robot name="r"><link name="l"/></robot>')


@pytest.mark.parametrize(
    ("given", "word"),
    [
        ('<mujoco model="une chèvre">', "chèvre"),
        ('<?xml version="1.0" encoding="ISO-8859-1"?><mujoco model="chèvre">', "chèvre"),
        ('<mujoco><custom><text name="ÿ" data="a"/></custom>', "ÿ"),
        ("<mujoco><chèvre/>", "chèvre"),
    ],
)
def test_what_is_not_utf_8_is_named(tmp_path, given, word):
    path = tmp_path / "model.xml"
    path.write_bytes(model().replace("<mujoco>", given).encode("latin-1"))
    with pytest.raises(ExchangeError) as refusal:
        read_mjcf(path)
    word = word.encode("latin-1")
    assert str(refusal.value) == f"{path}: {word!r} is not UTF-8 text; save it as UTF-8"


def test_without_mujoco_the_extra_is_named(read, monkeypatch):
    def missing(name: str):
        raise ModuleNotFoundError(name=name)

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(ExchangeError, match=r"needs MuJoCo, which `.*\[mujoco\]'` installs"):
        read(model())
