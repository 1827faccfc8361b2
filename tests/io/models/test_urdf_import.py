"""Import of URDF files: fixed and free bases, meshes in packages, masses, limits, odd XML."""

import sys

import numpy as np
import pytest
import trimesh
from trimesh.exchange.stl import export_stl_ascii

from benchmarks.imported_files import compare, read_urdf
from benchmarks.imported_models import largest_difference
from evo_cpg.creature.creature import TorqueMotor
from evo_cpg.io.models import urdf
from evo_cpg.io.models.mjcf_import import read_model
from evo_cpg.io.models.refusals import ExchangeError
from imported import creature_of

# A base, a link without mass (`plate`) that is fixed to it, an arm on a hinge with an effort,
# and a wheel without limits.
ROBOT = """<?xml version="1.0"?><!-- a robot -->
<robot name="arm">
  <link name="base"><inertial><mass value="2"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="package://arm/meshes/drawing.dae"/></geometry></visual>
    <collision><geometry><box size="0.4 0.2 0.1"/></geometry></collision></link>
  <link name="plate"><inertial><mass value="0"/>
    <inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="weld" type="fixed"><parent link="base"/><child link="plate"/>
    <origin xyz="0 0 0.1" rpy="0 0 0.5"/></joint>
  <link name="upper"><inertial><origin xyz="0 0 0.2"/><mass value="1"/>
    <inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0.001" iyz="0"/></inertial>
    <collision><geometry><mesh filename="package://arm/meshes/upper.stl" scale="2 1 1"/></geometry>
    </collision></link>
  <joint name="shoulder" type="revolute"><parent link="plate"/><child link="upper"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="2" effort="7" velocity="3"/>
    <dynamics damping="0.2" friction="0.1"/></joint>
  <link name="wheel"><inertial><mass value="0.5"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><cylinder radius="0.1" length="0.05"/></geometry></collision></link>
  <joint name="axle" type="continuous"><parent link="upper"/><child link="wheel"/>
    <origin xyz="0 0 0.4"/><axis xyz="1 0 0"/></joint>
</robot>
"""


# A body on a hinge, with places for its mass properties and its limits.
PAIR = """<robot name="pair">
  <link name="a"><inertial><mass value="1"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><box size="0.2 0.1 0.1"/></geometry></collision></link>
  <link name="b"><inertial><mass value="0.5"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><box size="0.2 0.1 0.1"/></geometry></collision></link>
  <joint name="j" type="revolute"><parent link="a"/><child link="b"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="3" velocity="5"/></joint>
</robot>
"""


@pytest.fixture
def pair(tmp_path):
    """Import the pair with some text replaced, with a free base."""

    def read(*changes, **options):
        text = PAIR
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "pair.urdf"
        path.write_text(text)
        return read_model(path, free=True, **options)

    return read


@pytest.fixture
def robot(tmp_path):
    """Write a robot with its mesh, an STL file in text form, beside the folder of the URDF."""
    meshes = tmp_path / "arm_description" / "arm" / "meshes"
    meshes.mkdir(parents=True)
    box = trimesh.creation.box((0.05, 0.1, 0.4))
    (meshes / "upper.stl").write_text(export_stl_ascii(box))
    path = tmp_path / "arm_description" / "urdf" / "arm.urdf"
    path.parent.mkdir()
    path.write_text(ROBOT)
    return path


def test_a_urdf_comes_in_with_its_mesh(robot):
    """The base is fixed. An effort becomes a torque motor."""
    found = read_model(robot)
    creature = creature_of(found)
    bodies = {body.name: body for body in creature.bodies}
    assert list(bodies) == ["base", "upper", "wheel"]
    assert creature.root_joint is not None and creature.root_joint.axes == ()
    np.testing.assert_allclose(bodies["upper"].shape.half_extents, [0.05, 0.05, 0.2], atol=1e-7)
    upper, wheel = bodies["upper"].joint, bodies["wheel"].joint
    assert upper and wheel
    assert upper.actuator == TorqueMotor(7.0, 7.0) and wheel.actuator is None
    np.testing.assert_allclose([*upper.lower, *upper.upper], [-1.0, 2.0])
    assert (upper.damping, upper.friction_loss) == (0.2, 0.1)
    assert found.left_out == ("velocity limit of joint 'shoulder'",)
    assert found.changed == ()
    (warning,) = found.warnings
    assert "'base' does not move" in warning and "--free" in warning


def test_bodies_equal_an_independent_reading(robot):
    text = ROBOT.replace('<inertial><origin xyz="0 0 0.2"/>', '<inertial><origin rpy="1 2 3"/>')
    robot.write_text(text)
    assert compare(robot, read_urdf(text), drop=False) == ([], [])
    robot.write_text(text.replace('ixz="0.001"', 'ixz="0.002"').replace('upper="2"', 'upper="1"'))
    unsaid = ["inertia of upper", "limits of upper"]
    assert compare(robot, read_urdf(text), drop=False) == ([], unsaid)
    text = text.replace('izz="0.01" ixy="0" ixz="0.001"', 'izz="0.05" ixy="0" ixz="0.001"')
    robot.write_text(text)
    assert compare(robot, read_urdf(text), drop=False) == (["inertia of upper"], [])


@pytest.mark.slow
def test_urdf_accelerations_equal_mujocos(robot):
    assert largest_difference(robot, states=10) < 1e-10


def test_an_unreadable_mesh_is_refused_or_dropped(robot, monkeypatch):
    robot.write_text(ROBOT.replace("upper.stl", "upper.dae"))
    with pytest.raises(ExchangeError, match=r"mesh 'package://arm/meshes/upper.dae': it is missi"):
        read_model(robot)
    (robot.parents[1] / "arm" / "meshes" / "upper.dae").write_text("<COLLADA/>")
    for package, problem in ((None, "the package pycollada is not i"), (True, "it cannot be read")):
        monkeypatch.setattr(urdf, "find_spec", lambda _, found=package: found)
        with pytest.raises(ExchangeError, match=rf"upper.dae': .*{problem}.*\. Allowed: a \.stl"):
            read_model(robot)
    found = read_model(robot, drop=True)
    assert found.dropped[0].startswith("mesh 'package://arm/meshes/upper.dae'")
    robot.write_text(ROBOT)
    (robot.parents[1] / "arm" / "meshes" / "upper.stl").write_text("solid x\nfacet")
    with pytest.raises(ExchangeError, match=r"upper.stl': it cannot be read"):
        read_model(robot)
    assert found.experiment["creature"]["bodies"][1]["shape"] is None


def test_drawings_that_cannot_be_read_are_left_out_by_name(robot):
    drawn = '<visual><geometry><mesh filename="package://arm/plate.dae"/></geometry></visual>'
    robot.write_text(ROBOT.replace('<link name="plate">', f'<link name="plate">{drawn}'))
    assert read_model(robot).left_out[0] == "unreadable drawing of body 'plate'"


def test_a_mimic_is_refused_by_its_joint(robot):
    mimic = '<axis xyz="1 0 0"/><mimic joint="shoulder" multiplier="2"/>'
    robot.write_text(ROBOT.replace('<axis xyz="1 0 0"/>', mimic))
    words = r"joint 'axle': it mimics joint 'shoulder'\. Allowed: no mimic"
    with pytest.raises(ExchangeError, match=words):
        read_model(robot)
    assert len(read_model(robot, drop=True).dropped) == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<robot", "MuJoCo cannot load it"),
        ('<robot name="r"><link name="a"></robot>', "it is not XML: mismatched tag"),
        ('<robot name="r"/>', "the worldbody holds no body"),
        (
            PAIR.replace('lower="-1" upper="1"', ""),
            "no body of the file moves .joint 'j': limits none, so 0 to 0 -> fixed; effort 3 -> no",
        ),
        ('<robot name="r"><link name="a"/></robot>', "the worldbody holds no body|no body of"),
    ],
)
def test_broken_urdf_files_have_one_clear_message(tmp_path, text, words):
    path = tmp_path / "r.urdf"
    path.write_text(text)
    with pytest.raises(ExchangeError, match=words):
        read_model(path)


SMALL = 'mass value="0.5"', 'mass value="2e-8"'


def moments(xx, yy, zz):
    old = 'ixx="0.01" iyy="0.01" izz="0.01"'
    return old, f'ixx="{xx}" iyy="{yy}" izz="{zz}"'


@pytest.mark.parametrize(
    ("changes", "mass", "inertia", "said"),
    [
        ([SMALL, moments(2e-15, 2e-15, 1e-16)], 2e-8, (2e-15, 2e-15, 1e-16), ()),
        # A thin plate, rounded when it was printed.
        ([moments(8.53333e-07, 8.53333e-07, 1.706667e-06)], 0.5, (8.53333e-7,) * 2, ()),
        ([moments(1, 1, 2.003)], 0.5, (1.001, 1.001, 2.002), ("1, 1, 2.003 -> 1.001",)),
        ([moments(0, 0, 0)], 0.5, (1e-9,) * 3, ("0, 0, 0 -> 1e-09",)),
        (
            [('mass value="0.5"', 'mass value="0"'), moments(0, 0, 0)],
            *(1e-6, (1e-9,) * 3, ("mass 0 -> 1e-06 kg", "0, 0, 0 -> 1e-09")),
        ),
    ],
)
def test_mass_and_moments_stay_or_are_named(pair, changes, mass, inertia, said):
    found = pair(*changes)
    body = creature_of(found).bodies[1]
    assert body.mass == pytest.approx(mass, rel=1e-12)
    expected = inertia if len(inertia) == 3 else (*inertia, 1.706667e-6)
    np.testing.assert_allclose(np.diag(body.inertia), expected, rtol=1e-9)
    assert len(found.changed) == len(said)
    assert all(words in sentence for words, sentence in zip(said, found.changed, strict=True))


def test_links_without_inertial_weigh_nothing(pair):
    """A link that is fixed to another one adds no mass. One that moves gets a small one."""
    link = '<link name="c"><collision><geometry><sphere radius="1"/></geometry></collision></link>'
    weld = '<joint name="w" type="{}"><parent link="b"/><child link="c"/></joint></robot>'
    found = pair(("</robot>", link + weld.format("fixed")))
    assert sum(body.mass for body in creature_of(found).bodies) == pytest.approx(1.5, rel=1e-14)
    words = "body 'c': mass none -> 0 kg, because it has no inertial"
    assert found.changed == (words,)
    found = pair(("</robot>", link + weld.format("continuous")))
    assert creature_of(found).bodies[2].mass == 1e-6
    assert words in found.changed and len(found.changed) == 3


@pytest.mark.parametrize(
    ("limit", "limits", "said"),
    [
        ('lower="-1" upper="1" effort="3"', (-1, 1), ()),
        ('upper="0.8" effort="3"', (0, 0.8), ()),
        ('lower="0" upper="0.0" effort="3"', None, ("limits 0 to 0 -> fixed; effort 3",)),
        ('effort="3"', None, ("limits none, so 0 to 0 -> fixed; effort 3 -> no mot",)),
        ('lower="-1e16" upper="1e16" effort="3"', (-1e6, 1e6), ("limits -1e+16 to 1e+16 -> none",)),
        ('lower="-1" upper="1" effort="0"', (-1, 1), ("effort 0 -> no motor",)),
        ('lower="-1" upper="1"', (-1, 1), ("effort none -> no motor",)),
        ('lower="-1" upper="1" effort="-3"', (-1, 1), ("effort -3 -> 3",)),
    ],
)
def test_limits_and_efforts_stay_or_are_named(pair, limit, limits, said):
    second = PAIR.partition('<link name="b">')[2].partition("</robot>")[0]
    second = second.replace('"j"', '"k"').replace('"b"', '"c"').replace('"a"', '"b"')
    old = 'lower="-1" upper="1" effort="3"'
    found = pair((old, limit), ("</robot>", f'<link name="c">{second}</robot>'))
    bodies = {body.name: body for body in creature_of(found).bodies if not body.whole}
    assert ("b" in bodies) == (limits is not None)
    if limits:
        joint = bodies["b"].joint
        assert joint
        np.testing.assert_allclose([*joint.lower, *joint.upper], limits, rtol=1e-12)
        assert (joint.actuator is None) == any("no motor" in words for words in said)
    assert len(found.changed) == len(said)
    for words, sentence in zip(said, found.changed, strict=True):
        assert sentence.startswith(f"joint 'j': {words}")
    assert "velocity limit" in found.left_out[0]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('mass value="0.5"', 'mass value="-1"', "body 'b': its mass is -1 kg. Allowed: 0 or more"),
        (*moments(-1, 1, 1), "body 'b': its moments of inertia are -1, 1, 1 kg m"),
        ('lower="-1"', 'lower="2"', "joint 'j': its limits are 2 to 1. Allowed: lower below upper"),
        ('link name="b"', 'link name="${b}"', r"link '${b}': '${b}' is an expression of xacro"),
        ('size="0.2', 'size="$(arg size)', "link 'a', link 'b': '$(arg size) 0.1 0.1'"),
        ("</robot>", "<xacro:leg/></robot>", "element <xacro:leg>: it is a macro of xacro. Allow"),
        ('value="0.5"', 'value="0,5"', "MuJoCo cannot load it: XML Error: bad format"),
        ("<mass ", "<Mass ", "MuJoCo cannot load it: XML Error: missing element: 'mass'"),
    ],
)
def test_impossible_values_have_one_clear_message(pair, old, new, words):
    with pytest.raises(ExchangeError) as refusal:
        pair((old, new))
    assert words in str(refusal.value).splitlines()[0]


def test_limits_in_wrong_order_can_be_dropped(pair):
    found = pair(('lower="-1"', 'lower="2"'), drop=True)
    joint = creature_of(found).bodies[1].joint
    assert joint and joint.lower == (-1e6,)
    assert "its limits are 2 to 1" in found.dropped[0]


# Text that MuJoCo reads, by what is odd about it.
ODD = {
    "blank first line": lambda text: f'\n\n<?xml version="1.0"?>\n{text}',
    "byte order mark": lambda text: "\ufeff" + text,
    "hyphens in a comment": lambda text: text.replace("</", "<!-- a -- b ---></", 1),
    "default namespace": lambda text: text.replace("<robot", '<robot xmlns="http://ros.org"'),
    "unbound prefix": lambda text: text.replace("</robot>", "<s:camera v:a='1'/></robot>"),
    "bound prefix": lambda text: text.replace(
        "<robot", '<robot xmlns:xacro="http://ros.org/xacro"'
    ),
    "carriage returns": lambda text: text.replace("\n", "\r\n"),
    "document type": lambda text: f'<!DOCTYPE robot [<!ENTITY x "y">]>{text}',
    "capitals": lambda text: text.replace("robot", "ROBOT"),
    "ampersand": lambda text: text.replace("</robot>", "<x v='a & b'>R&D &nbsp;</x></robot>"),
    "control character": lambda text: text.replace("</robot>", "<x>\x01</x></robot>"),
    "text before": lambda text: f"robot\n{text}",
    "second element": lambda text: f"{text}<robot/>",
    "wrong encoding": lambda text: f'<?xml version="1.0" encoding="utf-16"?>{text}<!-- \u00e9 -->',
}


# An MJCF file, whose unknown elements MuJoCo refuses. The word robot stands for mujoco.
MJCF = (
    '<robot model="m"><worldbody><body><freejoint/><geom size="1"/>'
    '<body><joint/><geom size="1"/></body></body></worldbody></robot>'
)
UNKNOWN = {"unbound prefix", "ampersand", "control character", "capitals"}


@pytest.mark.parametrize(
    ("plain", "root", "oddity"),
    [(PAIR, "robot", each) for each in ODD]
    + [(MJCF, "mujoco", each) for each in sorted(ODD.keys() - UNKNOWN)],
)
def test_odd_xml_reads_like_plain_xml(tmp_path, plain, root, oddity):
    path = tmp_path / "odd.xml"
    found = []
    for text in (plain, ODD[oddity](plain)):
        path.write_bytes(text.replace("robot", root).encode())
        found.append(read_model(path, free=True))
    assert found[0] == found[1]


@pytest.mark.parametrize(
    ("encoding", "declared"), [("latin-1", "ISO-8859-1"), ("utf-16", "UTF-16"), ("utf-8", None)]
)
def test_names_have_the_encoding_of_the_file(tmp_path, encoding, declared):
    path = tmp_path / "pair.urdf"
    head = f'<?xml version="1.0" encoding="{declared}"?>' if declared else ""
    path.write_bytes((head + PAIR.replace('"b"', '"ch\u00e8vre"')).encode(encoding))
    assert creature_of(read_model(path, free=True)).bodies[1].name == "ch\u00e8vre"


def test_import_writes_only_its_result(tmp_path, monkeypatch, capfd):
    """MuJoCo's warnings become notes."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pair.urdf").write_text(PAIR.replace(*moments("nan", 0, 0)))
    found = read_model("pair.urdf", free=True)
    assert any("NaN" in words for words in found.warnings)
    assert [file.name for file in tmp_path.iterdir()] == ["pair.urdf"]
    assert capfd.readouterr() == ("", "")


def test_missing_file_is_named_before_missing_mujoco(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ExchangeError, match="no such file"):
        read_model(tmp_path / "nowhere.urdf")
