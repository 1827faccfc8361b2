"""Import of URDF files: fixed and free bases, meshes in packages, links without mass."""

import numpy as np
import pytest
import trimesh
from trimesh.exchange.stl import export_stl_ascii

from benchmarks.imported_models import largest_difference
from evo_cpg.creature.creature import TorqueMotor
from evo_cpg.exchange import urdf
from evo_cpg.exchange.mjcf_import import read_model
from evo_cpg.exchange.refusals import ExchangeError
from imported import creature_of

# A base, a link without inertia (`plate`) that is fixed to it, an arm on a hinge with an effort,
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
    assert found.left_out == ("missing inertia of body 'plate'",)
    assert found.warnings == (
        "the root 'base' does not move, so use a task of your own. The option --free releases the "
        "first body",
    )


def test_urdf_accelerations_equal_mujocos(robot):
    assert largest_difference(robot, states=10) < 1e-10


def test_the_base_of_a_urdf_can_be_released(robot):
    found = read_model(robot, free=True)
    assert creature_of(found).root_joint is None
    assert found.warnings == ()


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
        ('<robot name="r"><link name="a"/></robot>', "the worldbody holds no body|no body of"),
    ],
)
def test_broken_urdf_files_have_one_clear_message(tmp_path, text, words):
    path = tmp_path / "r.urdf"
    path.write_text(text)
    with pytest.raises(ExchangeError, match=words):
        read_model(path)
