"""Import of our own exports and of foreign models, against MuJoCo, and refusals."""

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
from evo_cpg.creature.creature import NO_LIMIT, Actuator, Creature, Muscle, TorqueMotor
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
    """Import a model from text."""

    def call(text: str, **options):
        path = tmp_path / "model.xml"
        path.write_text(text, encoding="utf-8")
        return read_mjcf(path, **options)

    return call


def as_written(config: CreatureConfig) -> Creature:
    """Return the creature after it is written to YAML and read again."""
    return CreatureConfig.model_validate(yaml.safe_load(dump_creature(config))).build()


def assert_same(found: Creature, expected: Creature) -> None:
    """Compare the bodies of two creatures, in any order, to 10 digits."""

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
                for own, other in zip(ours.joint.motors, theirs.joint.motors, strict=True):
                    assert type(own) is type(other)
                    if own is not None and other is not None:
                        close(dataclasses.astuple(own), dataclasses.astuple(other))
            elif field.name in ("parent", "kinds", "places"):
                assert mine == given
            else:
                close(mine, given)


@pytest.mark.parametrize("number", range(len(STRUCTURES)))
def test_export_and_import_preserve_a_creature(read, number):
    rng = np.random.default_rng(number)
    servos = Actuator(2.0, 3.0, stiffness=5.0), Actuator(0.5)
    motor = (None, *servos, TorqueMotor(-2.0, 0.5), TorqueMotor(3.0))[number % 5]
    creature = random_creature(rng, STRUCTURES[number], 1.2, motor, axes_seed=number)
    painted = dataclasses.replace(creature.bodies[1], color="#12ab9f")
    creature = dataclasses.replace(
        creature, bodies=(creature.bodies[0], painted, *creature.bodies[2:])
    )
    found, left_out = read(mjcf_text(mjcf_model(creature, 0.0)))
    assert_same(as_written(found), creature)
    assert (found.name, left_out) == ("random", ())


def with_servos(creature: Creature) -> Creature:
    """Replace muscles by servos: MJCF has no muscles like ours."""
    bodies = [
        dataclasses.replace(body, joint=dataclasses.replace(body.joint, actuator=Actuator(1.0)))
        if body.joint and isinstance(body.joint.actuator, Muscle)
        else body
        for body in creature.bodies
    ]
    return dataclasses.replace(creature, bodies=tuple(bodies))


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_export_and_import_preserve_shipped_animals(read, path):
    creature = with_servos(build_creature(load_config(path), path))
    water = Water(1000.0)
    found, left_out = read(mjcf_text(mjcf_model(creature, GRAVITY, water=water)))
    assert_same(as_written(found), creature)
    assert left_out == (
        "gravity (0, 0, -9.81) m/s^2",
        "the buoyancy of a fluid of 1000 kg/m^3",
    )


def test_a_foreign_model_moves_as_in_mujoco(read):
    """Compare joint accelerations at random angles and rates to 1e-10, with the root at rest.

    The largest error of 100 such states is 1.5e-12. The frames of the bodies differ from ours, so
    the test covers every anchor, axis, rotation and inertia.
    """
    config, left_out = read(OTHERS, motor_gain=0.7)
    assert left_out == ("gravity (0, 0, -3.7) m/s^2", "geom 'floor'", "2 lights", "1 camera")
    creature = as_written(config)
    names = ("torso", "hip", "body3", "tail")
    assert tuple(body.name for body in creature.bodies) == names
    torso, hip, knee, tail = creature.bodies
    # The root is rotated by 90 degrees, so it is 0.6 m long.
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
        # Angles within the limits have only the springs' torque.
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


# Two hinges of one body with values of their own.
UNLIKE = """
<joint name="a" limited="false" stiffness="2" springref="0.5" damping="1"/>
<joint name="b" axis="0 1 0" range="-1 1" stiffness="2" armature="0.1" damping="1"
  frictionloss="3"/>
"""


def test_hinges_of_a_body_keep_values_of_their_own(read):
    motors = '<motor joint="a" gear="3"/><velocity joint="b" kv="2"/>'
    joint = as_written(read(model(joints=UNLIKE, actuators=motors)).creature).bodies[1].joint
    assert joint is not None
    assert (joint.stiffness, joint.damping, joint.armature) == (2.0, 1.0, (0.0, 0.1))
    np.testing.assert_allclose(joint.rest, (0.5, 0.0))
    assert joint.friction_loss == (0.0, 3.0)
    np.testing.assert_allclose([joint.lower, joint.upper], [[-NO_LIMIT, -1], [NO_LIMIT, 1]])
    assert joint.motors == (TorqueMotor(3.0), Actuator(2.0))


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
    """Return a trunk with one limb."""
    return (
        '<mujoco><compiler angle="radian"/>'
        f'<worldbody><body name="trunk">{free}{trunk}'
        f'<body name="limb" pos="0.3 0 0" {attributes}>{joints}{geoms}</body></body>{beside}'
        f"</worldbody><actuator>{actuators}</actuator>{extra}</mujoco>"
    )


def rod_inertia(radius: float, length: float) -> np.ndarray:
    """Return a capsule's two moments of inertia, kg m^2, for a mass of 1 kg.

    The first is about an axis perpendicular to the capsule's axis, the second about its axis.
    """
    along, _, across = Capsule(radius, length).inertia(1.0)
    return np.array([across, along])


def two(first: str = "", second: str = "") -> str:
    return f'<joint name="a" range="-1 1" {first}/><joint name="b" axis="0 1 0" {second}/>'.replace(
        '1 0"', '1 0" range="-1 1"'
    )


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("<mujoco/>", "the worldbody holds no body. Allowed: one"),
        (
            model(beside='<body name="other"><freejoint/><geom size="1"/></body>'),
            "body 'other': it is in the worldbody together with body 'trunk'. Allowed: one body",
        ),
        (model(free=""), "body 'trunk': the root does not float freely. Allowed: a freejoint"),
        (
            model(free='<joint name="root" type="free" damping="2"/>'),
            "joint 'root': it has damping. Allowed: no damping",
        ),
        (model(joints=""), "body 'limb': it is welded to its parent. Allowed: one to three hinges"),
        (
            model(joints="".join(f'<joint axis="1 {i} 0" range="-1 1"/>' for i in range(4))),
            "body 'limb': it has 4 joints. Allowed: one to three hinges",
        ),
        (
            model(joints='<joint name="h" type="ball"/>'),
            "joint 'h': it is a ball joint. Allowed: one to three hinges at one place",
        ),
        (model(joints='<joint type="slide"/>'), "unnamed joint of body 'limb': it is a slide join"),
        (
            model(joints=two(second='pos="0 0 0.1"')),
            "joint 'b': its pos differs from joint 'a'. Allowed: the same pos for all hinges",
        ),
        (
            model(joints=two().replace("0 1 0", "0 0 1")),
            "body 'limb': axes: must be linearly independent and not zero",
        ),
        (model(geoms=LIMB + '<geom size="0.2"/>'), "body 'limb': it has 2 geoms. Allowed: one"),
        (
            model(geoms='<geom name="g" type="cylinder" size="0.1 0.2"/>'),
            "geom 'g': it is a cylinder. Allowed: box, sphere, ellipsoid, capsule",
        ),
        (
            model(trunk='<geom name="t" type="capsule" size="0.1 0.2"/>'),
            "geom 't': the root's capsule is rotated in the world. Allowed: edges and axes along",
        ),
        (
            model(trunk='<geom name="t" type="box" size="0.1 0.2 0.3" euler="0 0 0.3"/>'),
            "geom 't': the root's box is rotated in the world",
        ),
        (
            model(geoms=f'<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>{LIMB}'),
            "body 'limb': its centre of mass or inertia does not match its sphere. Allowed: uni",
        ),
        (
            model(attributes='gravcomp="1"'),
            "body 'limb': its gravcomp is not the buoyancy of a fluid around all bodies. Allowed",
        ),
        (
            model(actuators='<position name="m" joint="h" kp="1"/>'),
            "actuator 'm': it has no damping. Allowed: a kv of more than 0",
        ),
        (
            model(actuators='<intvelocity name="m" joint="h" actrange="-1 1"/>'),
            "actuator 'm': its law is not a servo's. Allowed: position, velocity, motor",
        ),
        (
            model(actuators='<general name="m" joint="h" biastype="affine" biasprm="1 0 -1"/>'),
            "actuator 'm': its law is not a servo's",
        ),
        (
            model(actuators='<velocity name="m" joint="h" kv="1" forcerange="-1 2"/>'),
            "actuator 'm': its limits -1 and 2 differ in size. Allowed: limits of equal size",
        ),
        (
            model(actuators=2 * '<velocity joint="h" kv="1"/>'),
            "actuator number 1 (unnamed): it is the second actuator of joint 'h'. Allowed: one",
        ),
        (
            model(
                geoms=LIMB + '<site name="s"/>', actuators='<motor name="m" site="s" gear="1 0 0"/>'
            ),
            "actuator 'm': it drives no hinge. Allowed: joint=, a hinge",
        ),
        (
            model(extra='<equality><joint name="e" joint1="h"/></equality>'),
            "equality 'e': a creature cannot have it. Allowed: no equality",
        ),
        (
            model(extra='<tendon><fixed name="t"><joint joint="h" coef="1"/></fixed></tendon>'),
            "tendon 't': a creature cannot have it. Allowed: no tendon",
        ),
        (
            model(extra='<option><flag actuation="disable"/></option>'),
            "flag 'actuation': it is disabled. Allowed: enable",
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
            "actuator 'm': actuatorgroupdisable disables its group, 2. Allowed: an enabled group",
        ),
        (
            model(attributes='gravcomp="-1"').replace('="trunk"', '="trunk" gravcomp="-1"'),
            "body 'trunk': its gravcomp is not the buoyancy of a fluid around all bodies. Allowed",
        ),
        (
            # A rod of 1 m by 1 mm, with 1.6 times a capsule's moment about its axis.
            model(
                geoms='<inertial pos="0 0 0" mass="1" diaginertia="{0} {0} {1}"/>'.format(
                    *rod_inertia(0.0005, 1.0) * [1.0, 1.6]
                )
                + '<geom type="capsule" size="0.0005 0.5"/>'
            ),
            "body 'limb': its centre of mass or inertia does not match its capsule. Allowed: uni",
        ),
        (model().replace('"limb"', '"limb{i}"'), "body 'limb{i}': its name contains {i}"),
        ("<mujoco><wolrd/></mujoco>", "unrecognized element Element 'wolrd', line 1"),
    ],
)
def test_unsupported_elements_are_refused_by_name(read, tmp_path, text, expected):
    with pytest.raises(ExchangeError) as refusal:
        read(text)
    assert str(refusal.value).startswith(f"{tmp_path / 'model.xml'}: ")
    assert expected in str(refusal.value)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (model(attributes='quat="nan 0 0 1"'), "body 'limb': its orientation holds nan. Allow"),
        (model(attributes='gravcomp="nan"'), "body 'limb': its gravcomp holds nan"),
        (model().replace("0.3 0 0", "nan 0 0"), "body 'limb': its pos holds nan. Allowed: finite"),
        (model(geoms='<geom name="g" size="inf"/>'), "geom 'g': its size holds inf. Allowed: fin"),
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
            "joint 'h': its actuatorfrcrange holds nan. Allowed: numbers",
        ),
        (
            model(actuators='<velocity name="m" joint="h" kv="1" forcerange="-1 nan"/>'),
            "actuator 'm': its forcerange holds nan. Allowed: numbers",
        ),
        (
            model(actuators='<velocity name="m" joint="h" kv="1" gear="nan"/>'),
            "actuator 'm': its gear holds nan. Allowed: finite numbers",
        ),
    ],
)
def test_elements_without_numbers_are_refused(read, tmp_path, monkeypatch, text, expected):
    # MuJoCo writes warnings to a file in the working folder.
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ExchangeError) as refusal:
        read(text)
    assert str(refusal.value).startswith(f"{tmp_path / 'model.xml'}: {expected}")


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ('gear="4" ctrlrange="-0.5 0.5"', TorqueMotor(4.0, 2.0)),
        ('gear="-4" forcerange="-0.5 0.5"', TorqueMotor(-4.0, 2.0)),
        ('gear="4"', TorqueMotor(4.0)),
    ],
)
def test_a_torque_motor_stays_one(read, given, expected):
    found = read(model(actuators=f'<motor joint="h" {given}/>')).creature.build()
    assert found.bodies[1].joint and found.bodies[1].joint.actuator == expected


def test_a_servo_for_a_torque_motor_without_limits_is_refused(read):
    words = r"'m': it has no limits\. Allowed: ctrlrange or forcer"
    unlimited = model(actuators=MOTOR.replace('ctrlrange="-1 1"', ""))
    with pytest.raises(ExchangeError, match=words):
        read(unlimited, motor_gain=1.0)
    unclamped = model(actuators=MOTOR, extra='<option><flag clampctrl="disable"/></option>')
    with pytest.raises(ExchangeError, match=words):
        read(unclamped, motor_gain=1.0)
    weaker = HINGE.replace("/>", ' actuatorfrcrange="-0.5 0.5"/>')
    found = read(model(joints=weaker, actuators=MOTOR), motor_gain=2.0).creature.build()
    assert found.bodies[1].joint and found.bodies[1].joint.actuator == Actuator(2.0, 0.5)


def test_an_inertial_equal_to_the_shape_is_accepted(read):
    """The inertial of an oblique rod of 1 m by 1 mm has the digits of a file."""
    inertial = (
        '<inertial pos="0 0 0" mass="1" euler="1 0.5 0" diaginertia="{0:.9g} {0:.9g} {1:.9g}"/>'
    )
    rod = inertial.format(*rod_inertia(0.0005, 1.0))
    rod += '<geom type="capsule" size="0.0005 0.5" euler="1 0.5 0"/>'
    assert read(model(geoms=rod)).creature.bodies[1].shape.type == "capsule"


def test_command_ranges_are_left_out(read):
    """Limits of servos' commands are named, except if MuJoCo does not clamp commands."""
    limited = '<velocity name="m" joint="a" kv="1" ctrlrange="-1 1"/>'
    one = model(joints=HINGE.replace('"h"', '"a"'), actuators=limited)
    assert read(one).left_out[1:] == ("the ctrlrange of actuator 'm'",)
    position = '<position joint="{}" kp="10" kv="1" ctrlrange="-0.1 0.1"/>'
    both = model(joints=two(), actuators=position.format("a") + position.format("b"))
    assert read(both).left_out[1:] == ("the ctrlrange of 2 actuators",)
    free = one.replace("<worldbody>", '<option><flag clampctrl="disable"/></option><worldbody>')
    assert read(free).left_out[1:] == ()


def test_gravcomp_without_gravity_is_not_reported(read):
    """Disabled gravity leaves neither gravity nor buoyancy to report."""
    flag = '<option><flag gravity="disable"/></option>'
    assert read(model(attributes='gravcomp="1"', extra=flag)).left_out == ()


def test_limits_beyond_the_largest_allowed_are_none(read):
    """Cover a servo, a torque motor and its joint. One-sided limits still count."""
    law = '<velocity joint="h" kv="1" forcerange="{}"/>'
    for limits in ("-1e15 1e15", "-inf inf"):
        found = read(model(actuators=law.format(limits))).creature.build()
        assert found.bodies[1].joint and found.bodies[1].joint.actuator == Actuator(1.0)
        wide = HINGE.replace("/>", f' actuatorfrcrange="{limits}"/>')
        found = read(model(joints=wide, actuators=MOTOR), motor_gain=1.0).creature.build()
        assert found.bodies[1].joint and found.bodies[1].joint.actuator == Actuator(1.0, 1.0)
    with pytest.raises(ExchangeError, match="its limits -1 and inf differ"):
        read(model(actuators=law.format("-1 inf")))


def test_small_numbers_are_kept(read):
    """Values are smaller than the rounding of positions."""
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


def test_missing_names_are_generated(read, tmp_path):
    """A body takes its number, and the creature its file. Existing names are avoided."""
    text = model().replace('name="limb"', "").replace('name="trunk"', 'name="body2"')
    found = read(text).creature
    assert [entry.name for entry in found.bodies] == ["body2", "body2_"]
    assert found.name == "model"


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("missing.xml", "no such file"),
        ("", r"cannot be read \(Is a directory\)"),
        (300 * "a", r"cannot be read \(File name too long\)"),
        ("model.xml/model.xml", r"cannot be read \(Not a directory\)"),
    ],
)
def test_a_file_that_cannot_be_read_is_named(tmp_path, name, expected):
    (tmp_path / "model.xml").write_text("<mujoco/>")
    with pytest.raises(ExchangeError, match=f"^{tmp_path / name}: {expected}$"):
        read_mjcf(tmp_path / name)


def test_a_urdf_is_refused(read):
    with pytest.raises(ExchangeError, match=r"it is a URDF\. Allowed: MJCF"):
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
def test_text_that_is_not_utf_8_is_named(tmp_path, given, word):
    path = tmp_path / "model.xml"
    path.write_bytes(model().replace("<mujoco>", given).encode("latin-1"))
    with pytest.raises(ExchangeError) as refusal:
        read_mjcf(path)
    word = word.encode("latin-1")
    assert str(refusal.value) == f"{path}: {word!r} is not UTF-8 text. Save the file as UTF-8"


def test_without_mujoco_the_extra_is_named(read, monkeypatch):
    def missing(name: str):
        raise ModuleNotFoundError(name=name)

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(ExchangeError, match=r"needs MuJoCo\. Install it with `.*\[mujoco\]'`"):
        read(model())
