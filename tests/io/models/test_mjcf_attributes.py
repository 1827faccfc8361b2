"""Attributes of MJCF one by one: equal to MuJoCo, refused, or left out by name."""

import dataclasses
import re
from collections.abc import Iterable
from fnmatch import fnmatchcase

import mujoco
import numpy as np
import pytest

from benchmarks.imported_models import accelerations
from evo_cpg.creature.creature import NO_LIMIT
from evo_cpg.creature.tree import build_tree
from evo_cpg.io.models import mjcf_fields
from evo_cpg.io.models.mjcf_import import Imported
from evo_cpg.io.models.refusals import ExchangeError
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.joint_torque import MotorCommand
from evo_cpg.physics.tree.state import resting_state
from imported import creature_of


def model(
    joint: str = "",
    geom: str = "",
    actuator: str = "",
    body: str = "",
    option: str = "",
    flag: str = "",
    top: str = "",
    within: str = "",
    drive: str = "velocity",
) -> str:
    """Return a trunk with one limb, with some attributes or elements."""
    # A given attribute replaces the usual one.
    hinge = attributes('name="h" axis="0 1 0.3" range="-60 60" pos="-0.1 0.02 0"', joint)
    limb = attributes('name="g" type="box" size="0.2 0.05 0.03" pos="0.1 0 0"', geom)
    place = attributes('name="limb" pos="0.3 0.1 0"', body)
    motor = attributes('name="m" joint="h" kv="1"', actuator)
    return f"""<mujoco>
      <option {option}><flag {flag}/></option>
      {top}
      <worldbody>
        <body name="trunk"><freejoint name="root"/><geom name="t" type="box" size=".2 .1 .1"/>
          <body {place}>
            <joint {hinge}/>
            <geom {limb}/>
            {within}
          </body>
        </body>
      </worldbody>
      <actuator><{drive} {motor}/></actuator>
    </mujoco>"""


def attributes(usual: str, given: str) -> str:
    """Return attributes of an element. Given ones replace usual ones, and "-" removes them."""
    pairs = [part.split("=", 1) for part in (usual + " " + given).replace('" ', '"\n').split("\n")]
    chosen = {key.strip(): value for key, value in (pair for pair in pairs if len(pair) == 2)}
    return " ".join(f"{key}={value}" for key, value in chosen.items() if value != '"-"')


def moves_as_in_mujoco(text: str, found: Imported) -> None:
    """Compare the joint's acceleration at two states within its limits."""
    theirs = mujoco.MjModel.from_xml_string(text)
    theirs.opt.disableflags |= (
        mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS
    )
    data = mujoco.MjData(theirs)
    creature = creature_of(found)
    tree, joint = build_tree(creature), creature.bodies[1].joint
    assert joint is not None
    limits = np.array([joint.lower[0], joint.upper[0]])
    if abs(limits[0]) < NO_LIMIT:
        np.testing.assert_allclose(limits, theirs.jnt_range[1] - theirs.qpos0[7], rtol=1e-9)
    rest = resting_state(tree, dtype=float)
    for q, qd in ((0.3, 2.0), (-0.2, -5.0)):
        data.qpos = theirs.qpos0
        data.qpos[7] += q
        data.qvel[6] = qd
        mujoco.mj_forward(theirs, data)
        state = dataclasses.replace(rest, q=np.array([q]), qd=np.array([qd]))
        ours = accelerations(World(tree, 9.81), state, MotorCommand(np.zeros(1)))
        np.testing.assert_allclose(ours[6:], data.qacc[6:], rtol=1e-8)


# Attributes that are read, or that do not affect the motion.
MAPPED = {
    "joint axis": model(joint='axis="1 2 3"'),
    "joint pos": model(joint='pos="0.05 0.1 -0.02"'),
    "joint range": model(joint='range="-30 80"'),
    "joint ref": model(joint='ref="10" springref="10" stiffness="2"'),
    "joint springref": model(joint='stiffness="1" springref="10"'),
    "joint stiffness": model(joint='stiffness="3"'),
    "joint damping": model(joint='damping="0.4"'),
    "joint armature": model(joint='armature="0.05"'),
    "joint springdamper": model(joint='springdamper="0.5 0.8"'),
    "joint group, user": model(joint='group="2" user="1"'),
    "freejoint group": model().replace('name="root"', 'name="root" group="3"'),
    "body pos": model(body='pos="0.1 0.5 -0.3"'),
    "body euler": model(body='euler="20 30 40"'),
    "body quat": model(body='quat="1 0.2 0.3 0.1"'),
    "body axisangle": model(body='axisangle="1 1 0 30"'),
    "body xyaxes": model(body='xyaxes="0 1 0 -1 0 0.2"'),
    "body zaxis": model(body='zaxis="1 0 1"'),
    "body sleep": model().replace('name="trunk"', 'name="trunk" sleep="never"'),
    "geom size": model(geom='size="0.1 0.2 0.05"'),
    "geom fromto": model(geom='type="capsule" size="0.03" pos="-" fromto="0 0 0 0.3 0.1 0.2"'),
    "geom euler": model(geom='euler="0 10 20"'),
    "geom mass": model(geom='mass="3"'),
    "geom density": model(geom='density="300"'),
    "geom friction, 2nd and 3rd": model(geom='friction="1 0.5 0.5"'),
    "geom fluidshape, without a fluid": model(geom='fluidshape="ellipsoid" fluidcoef="1 1 1 1 1"'),
    "geom group, rgba": model(geom='group="3" rgba="1 0 0 1"'),
    "inertial": model(within='<inertial pos="0.1 0.02 0" mass="1" diaginertia=".1 .2 .25"/>'),
    "second geom": model(within='<geom size="0.1" pos="0.1 0.2 0.3"/>'),
    "welded body": model(
        within='<body pos="1 0 0" euler="0 9 0"><geom size="0.1 0.2" type="capsule"/></body>'
    ),
    "cylinder": model(geom='type="cylinder" size="0.1 0.2"'),
    "inertial equal to the geom": model(
        within='<inertial pos="0.1 0 0" mass="3" diaginertia=".0034 .0409 .0425"/>'
    ),
    "compiler angle": model(top='<compiler angle="radian"/>', joint='range="-1 1"'),
    "compiler eulerseq": model(top='<compiler eulerseq="ZYX"/>', body='euler="20 30 40"'),
    "compiler settotalmass": model(top='<compiler settotalmass="7"/>'),
    "default": model(top='<default><joint damping="0.3" stiffness="2"/></default>'),
    "option timestep, solver": model(
        option='timestep="0.01" solver="CG" iterations="5" tolerance="1e-3" jacobian="dense"'
    ),
    "option integrator of our export": model(option='integrator="implicitfast"'),
    "flags without effect": model(
        flag=" ".join(
            f'{flag}="disable"'
            for flag in ("warmstart", "refsafe", "eulerdamp", "midphase", "sensor", "frictionloss")
        )
    ),
    "flags of readings": model(flag='energy="enable" fwdinv="enable"'),
    "geom priority": model(geom='priority="1"'),
    "geom without friction": model(geom='condim="1"'),
    "actuator lengthrange": model(top='<compiler><lengthrange mode="none"/></compiler>'),
    "flags that switch joints off": model(
        flag='limit="disable" spring="disable" damper="disable"', joint='damping="1" stiffness="1"'
    ),
    "flag constraint": model(flag='constraint="disable"', joint='frictionloss="1"'),
    "custom": model(top='<custom><numeric name="n" data="1"/></custom>'),
    "statistic, visual": model(top='<statistic meaninertia="3"/><visual><map znear="1"/></visual>'),
}


@pytest.mark.parametrize("name", MAPPED)
def test_accepted_attributes_move_as_in_mujoco(read, name):
    found = read(MAPPED[name])
    assert found.left_out == ()
    moves_as_in_mujoco(MAPPED[name], found)


MOTOR = "actuator 'm'"
SITES = '<site name="a"/><site name="b" pos="1 0 0"/>'
SPATIAL = '<spatial name="c" stiffness="1"><site site="a"/><site site="b"/></spatial>'
MOCAP = '<body name="k" mocap="true"/></worldbody>'


def general(law: str) -> str:
    """Return a model whose motor has a general law."""
    return model(drive="general", actuator=f'kv="-" {law}')


# A model, and the name and the fault of an element.
REFUSED = [
    (model(joint='actuatorgravcomp="true"'), "joint 'h'", "actuatorgravcomp"),
    (model(body='gravcomp="1"'), "body 'limb'", "gravcomp"),
    (model().replace("</worldbody>", MOCAP), "body 'k'", "mocap"),
    (model(drive="muscle", actuator='kv="-"'), MOTOR, "linear"),
    (general('biastype="affine" biasprm="0 1 0"'), MOTOR, "pushes away"),
    (general('biastype="affine" biasprm="2 0 0"'), MOTOR, "constant force"),
    (general('gainprm="0"'), MOTOR, "gear or gain"),
    (model(top='<equality><joint name="e" joint1="h"/></equality>'), "equality 'e'", "equality"),
    (model(within=SITES, top=f"<tendon>{SPATIAL}</tendon>"), "tendon 'c'", "sites"),
]
# Fields of newer versions of MuJoCo, with attributes that set them, and their words.
NEWER = [
    ("dof_dampingpoly", {"joint": 'damping="1 2 3"'}, "damping polynomial"),
    ("jnt_stiffnesspoly", {"joint": 'stiffness="1 2 3"'}, "stiffness polynomial"),
    ("jnt_springyield", {"joint": 'stiffness="1" springyield="0.1"'}, "springyield"),
    ("actuator_delay", {"actuator": 'delay="0.1" nsample="2"'}, "delay"),
    ("actuator_damping", {"actuator": 'damping="1"'}, "damping"),
    ("actuator_armature", {"actuator": 'armature="1"'}, "armature"),
]


@pytest.mark.parametrize(("text", "element", "word"), REFUSED, ids=lambda text: text[:12])
def test_unsupported_attributes_are_refused(read, text, element, word):
    with pytest.raises(ExchangeError, match=f"{element}: .*{word}"):
        read(text)


@pytest.mark.parametrize(("field", "given", "word"), NEWER)
def test_attributes_of_newer_versions_are_refused(read, field, given, word):
    if not hasattr(mujoco.MjModel, field):
        pytest.skip("this MuJoCo does not have it")
    with pytest.raises(ExchangeError, match=f"'[hm]': it has {word}"):
        read(model(**given))


LEFT_OUT = {
    "joint margin": (model(joint='margin="5"'), "margin of joint 'h'"),
    "joint solreflimit": (model(joint='solreflimit="0.1 1"'), "solreflimit of joint 'h'"),
    "geom margin": (model(geom='margin="0.01"'), "margin of geom 'g'"),
    "geom solref": (model(geom='solref="0.1 1"'), "solref of geom 'g'"),
    "geom solmix": (model(geom='solmix="2"'), "solmix of geom 'g'"),
    "geom condim": (model(geom='condim="6"'), "condim above 3 of geom 'g'"),
    "thin medium": (model(option='density="1.2"'), "drag of the medium (density 1.2)"),
    "viscosity alone": (model(option='viscosity="0.1"'), "viscosity of the medium (0.1)"),
    "wind": (model(option='wind="1 0 0"'), "option wind"),
    "integrator": (model(option='integrator="RK4"'), "option integrator"),
    "cone": (model(option='cone="elliptic"'), "option cone"),
    "flag override": (model(flag='override="enable"', option='o_margin="0.1"'), "flag override"),
    "flag sleep": (model(flag='sleep="enable"'), "flag sleep"),
    "flag filterparent": (model(flag='filterparent="disable"'), "flag filterparent"),
    "flag actuation": (model(flag='actuation="disable"'), "1 actuator"),
    "ctrlrange": (model(actuator='ctrlrange="-1 1"'), "ctrlrange of actuator 'm'"),
    "timeconst": (
        model(drive="position", actuator='kv="-" kp="2" timeconst="0.1"'),
        "time constant of actuator 'm'",
    ),
    "idle tendon": (
        model(top='<tendon><fixed name="c"><joint joint="h" coef="1"/></fixed></tendon>'),
        "tendon without effect of tendon 'c'",
    ),
    "scenery": (
        model().replace("<worldbody>", '<worldbody><geom name="box" size="1"/>'),
        "scenery of geom 'box'",
    ),
    "drawing": (
        model(within='<geom name="d" size="0.1" contype="0" conaffinity="0"/>'),
        "drawing of geom 'd'",
    ),
    "site": (model(within="<site/>"), "1 site"),
    "light": (model(within="<light/>"), "1 light"),
    "sensor": (model(top='<sensor><jointpos joint="h"/></sensor>'), "1 sensor"),
}


@pytest.mark.parametrize("name", LEFT_OUT)
def test_other_settings_are_left_out_by_name(read, name):
    text, expected = LEFT_OUT[name]
    assert expected in read(text).left_out


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (model(actuator='forcerange="-1 2"'), "'m': .*-1 and 2 .*become -2 and 2"),
        (model(actuator='forcerange="-1 1e15"'), "'m': .*-1 and 1e.15 .*become no limits"),
        (
            model(top='<compiler angle="radian"/>', joint='range="-1 1e6"'),
            r"'h': limits -1 to 1e\+06 -> -1 to 10000",
        ),
    ],
)
def test_changed_numbers_are_said(read, text, words):
    (said,) = read(text).changed
    assert re.search(words, said)


# Treatment of every field of the compiled model that `mjcf_fields` does not refuse, so that a new
# field of MuJoCo fails the test. A "*" stands for any characters.
READ = (
    "opt names qpos0 nbody njnt ngeom body_mocapid body_weldid body_dofnum "
    "body_parentid body_pos body_quat body_gravcomp body_mass "
    "body_ipos body_iquat body_inertia body_jntnum body_jntadr "
    "jnt_type jnt_pos jnt_axis jnt_range jnt_limited jnt_stiffness jnt_qposadr jnt_dofadr "
    "jnt_bodyid jnt_actfrclimited jnt_actfrcrange dof_damping dof_armature dof_jntid "
    "dof_frictionloss "
    "geom_bodyid geom_type geom_size geom_pos geom_quat geom_friction geom_rgba geom_dataid "
    "geom_contype geom_conaffinity geom_matid mat_rgba eq_active0 "
    "exclude_signature tendon_length0 tendon_adr tendon_num tendon_limited wrap_type wrap_objid "
    "tendon_actfrclimited tendon_actfrcrange text_adr text_size text_data mesh_pos mesh_quat "
    "ntendon mesh_vert mesh_vertadr mesh_vertnum "
    "actuator_trnid actuator_trntype actuator_dyntype actuator_gaintype "
    "actuator_gainprm actuator_biastype actuator_biasprm actuator_gear actuator_forcelimited "
    "actuator_forcerange actuator_actlimited actuator_ctrllimited actuator_ctrlrange "
    "actuator_group pair_geom1 pair_geom2 "
)

# Fields that do not affect the motion, by reason.
WITHOUT_EFFECT = {
    "counts of elements with their own fields": "n*",
    "storage of matrices": "B_* D_* M_* map* efm*",
    "search for contacts": "bvh_* oct_* body_bvhadr body_bvhnum",
    "storage of names": "name_* names_map",
    "paths of assets": "path*",
    "compiler": "signature",
    "sizes for the solver and for pictures": "stat",
    "trees for the flag sleep": "tree_*",
    "presence of properties that are read or refused": "flg_*",
    "computed from geoms, which are read": "body_contype body_conaffinity",
    "computed from geoms, whose margin is left out": "body_margin",
    "addresses": (
        "body_rootid body_geomnum body_geomadr body_dofadr dof_Madr actuator_actadr "
        "actuator_ctrladr actuator_outadr"
    ),
    "computed from joints, which are read": "dof_bodyid dof_parentid",
    "computed from masses and joints": "body_invweight0 dof_M0 dof_invweight0",
    "computed from masses": "body_subtreemass body_simple dof_simplenum",
    "computed from places": "body_sameframe geom_sameframe",
    "trees": "body_treeid dof_treeid",
    "plugins are refused": "body_plugin geom_plugin actuator_plugin plugin*",
    "computed from actuators, which are read": "jnt_actuatorid",
    "computed from sizes, for the flag sleep": "dof_length",
    "computed from sizes": "geom_aabb geom_rbound",
    "fluid, which is left out by name": "geom_fluid",
    "computed from masses and gears": "actuator_acc0",
    "computed from gears": "actuator_length0",
    "muscles, whose law is refused": "actuator_lengthrange",
    "dynamics of actuators, left out by name": (
        "actuator_actnum actuator_actearly actuator_dynprm"
    ),
    "slider-cranks, which are refused": "actuator_cranklength",
    "1 for an actuator of a hinge with an accepted law": "actuator_ctrlnum",
    "name of the control in an accepted law": "actuator_ctrlspec",
    "1 for an actuator of a hinge": "actuator_outnum",
    "delay, which is refused": "actuator_history actuator_historyadr",
    "vertices and faces, which are read, in other forms": "mesh_*",
    "pictures": "vis geom_castshadow mat_* tex_* tendon_matid tendon_rgba tendon_width",
    "user data": "*_user numeric_* text_* tuple_*",
    "groups for display": "*_group",
    "lights are left out by name": "light_*",
    "cameras are left out by name": "cam_*",
    "sites are left out by name, and their actuators refused": "site_*",
    "sensors are left out by name": "sensor_*",
    "skins are left out by name": "skin_*",
    "keyframes are left out by name": "key_*",
    "height fields, left out as ground and refused as a shape": "hfield_*",
    "softness and friction of pairs": "pair_*",
    "equalities are refused": "eq_*",
    "computed from tendons": "ten_* tendon_type tendon_actuatorid tendon_invweight0 tendon_tree*",
    "spatial tendons are refused": "wrap_*",
    "flexes are refused": "flex*",
}

OPTIONS_WITHOUT_EFFECT = {
    "the configuration sets the time step": "timestep",
    "tolerances of the solver": (
        "iterations tolerance ls_iterations ls_tolerance noslip_tolerance"
    ),
    "tolerances of contacts": ("ccd_iterations ccd_tolerance sdf_initpoints sdf_iterations"),
    "method of the solver": "solver",
    "storage": "jacobian",
    "sensors only": "magnetic",
    "the flag sleep is left out by name": "sleep_tolerance",
    "the flag override is left out by name": "o_margin o_solref o_solimp o_friction",
    "part of the world": "gravity density viscosity wind",
    "see flags": "disableflags enableflags",
    "see actuators": "disableactuator",
}

FLAGS_WITHOUT_EFFECT = {
    "sensors are left out by name": "sensor",
    "start of the solver": "warmstart",
    "bound of softness": "refsafe",
    "search for contacts": "midphase nativeccd multiccd",
    "integration": "eulerdamp",
    "reset after divergence": "autoreset",
    "method of the solver": "island",
    "readings": "energy fwdinv",
    "inverse dynamics": "invdiscrete",
}

# Flags that the import leaves out by name.
FLAGS_LEFT_OUT = {"override", "sleep", "diagexact", "ipc", "speculative", "filterparent"}


def undecided(names: Iterable[str], *decided: Iterable[str]) -> list[str]:
    """Return the names that match no word of the lists. ``*`` in a word matches anything."""
    patterns = {word for words in decided for group in words for word in group.split()}
    return [name for name in names if not any(fnmatchcase(name, each) for each in patterns)]


def test_every_field_of_the_compiled_model_is_decided():
    """A new field of MuJoCo fails here instead of being dropped silently."""
    compiled = mujoco.MjModel.from_xml_string(model())
    fields = [name for name in dir(compiled) if not name.startswith("_")]
    fields = [name for name in fields if not callable(getattr(compiled, name))]
    assert len(fields) > 300
    tables = ["READ", "READ_LIMITS", "COMPUTED", "REFUSED", "LEFT_OUT", "REFUSED_COUNTS", "COUNTS"]
    decided = (READ,), WITHOUT_EFFECT.values(), *(getattr(mjcf_fields, x) for x in tables)
    assert undecided(fields, *decided) == []
    assert undecided(["jnt_stickiness", "geom_colour"], *decided) == [
        "jnt_stickiness",
        "geom_colour",
    ]
    options = [name for name in dir(compiled.opt) if not name.startswith("_")]
    decided = OPTIONS_WITHOUT_EFFECT.values(), mjcf_fields.OPTIONS_LEFT_OUT
    assert undecided(options, *decided) == []
    flags = [*mujoco.mjtDisableBit.__members__, *mujoco.mjtEnableBit.__members__]
    flags = [flag.split("_", 1)[1].lower() for flag in flags if "_" in flag]
    decided = FLAGS_LEFT_OUT, FLAGS_WITHOUT_EFFECT.values(), mjcf_fields.FLAGS
    assert undecided(flags, *decided) == []


def test_all_refusals_are_listed_with_lines(read, tmp_path):
    text = model(
        joint='actuatorgravcomp="true"',
        drive="general",
        actuator='kv="-" gainprm="0"',
        top='<equality><joint name="e" joint1="h"/></equality>',
    )
    with pytest.raises(ExchangeError) as refusal:
        read(text)
    head, *lines, hint = str(refusal.value).splitlines()
    assert head.startswith(f"{tmp_path / 'model.xml'}: ") and "--drop" in hint
    words = (r"equality 'e': .*line 3", r"joint 'h': .*line 7", r"actuator 'm': .*line 13")
    assert all(re.search(*pair) for pair in zip(words, lines, strict=True))


def test_elements_with_one_fault_share_a_line(read, tmp_path):
    limbs = "\n".join(
        f'<body name="b{i}"><joint name="j{i}" range="-1 1" actuatorgravcomp="true"/>'
        '<geom size="0.1"/></body>'
        for i in range(7)
    )
    with pytest.raises(ExchangeError) as refusal:
        read(model(within=limbs))
    named = ", ".join(f"joint 'j{i}'" for i in range(5))
    first = str(refusal.value).splitlines()[0]
    assert first.startswith(f"{tmp_path / 'model.xml'}: {named} and 2 more: ")
    assert first.endswith("(lines 9, 10, 11, 12, 13)")


def test_elements_of_included_files_have_no_line(read, tmp_path):
    (tmp_path / "limb.xml").write_text(
        '<mujocoinclude>\n\n<joint name="h" actuatorgravcomp="true"/></mujocoinclude>'
    )
    text = '<mujoco><worldbody><body name="a"><freejoint/><geom size="0.1"/>\n<body name="b">'
    text += '<include file="limb.xml"/><geom size="0.1"/></body></body></worldbody></mujoco>'
    with pytest.raises(ExchangeError, match=r"joint 'h': .*Allowed: no actuatorgravcomp\n"):
        read(text)


def test_unnamed_elements_have_a_number_or_owner(read):
    text = """<mujoco>
    <worldbody><geom type="plane" size="1 1 1"/>
    <body><freejoint/>
    <body><joint name="h"/><joint axis="1 0 0" actuatorgravcomp="true"/>
    <geom size="0.1"/></body>
    <geom size="0.1"/></body></worldbody>
    <actuator>
    <velocity gear="0" joint="h"/></actuator></mujoco>"""
    with pytest.raises(ExchangeError) as refusal:
        read(text)
    words = (r"unnamed joint of body number 2 .*line 4", r"actuator number 0 .*line 8")
    lines = str(refusal.value).splitlines()[1:-1]
    assert all(re.search(*pair) for pair in zip(words, lines, strict=True))
