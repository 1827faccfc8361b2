"""Export and import of meshes: masses, inertias, accelerations and refusals."""

import dataclasses
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
import yaml

from benchmarks.imported_models import accelerations
from creatures import random_state
from evo_cpg.creature.algebra.rotation import euler_to_matrix
from evo_cpg.creature.creature import Body, Creature, Joint, Material, neutral_pose
from evo_cpg.creature.mesh import ConvexMesh
from evo_cpg.creature.shapes import Box
from evo_cpg.creature.tree import build_tree
from evo_cpg.io.load import complete_config, load_config
from evo_cpg.io.models.imported_files import write_imported
from evo_cpg.io.models.mjcf_export import mjcf_model, mjcf_text
from evo_cpg.io.models.refusals import ExchangeError
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.joint_torque import MotorCommand
from imported import creature_of
from polyhedra import tetrahedron, wedge

GRAVITY = 9.81


def animal() -> Creature:
    """Return bodies without symmetry at oblique angles, and a box at the end."""
    joint = Joint(
        "a",
        (0.2, 0.01, -0.03),
        (-0.1, 0.04, 0.02),
        ((0, 0, 1.0), (0, 1.0, 0)),
        (-1.0, -0.5),
        (1.0, 0.8),
        tuple(map(tuple, euler_to_matrix(0.3, -0.2, 0.7))),
        damping=0.1,
        stiffness=2.0,
    )
    return Creature(
        "meshes",
        (
            Body("a", wedge(), Material(800.0)),
            Body("b", tetrahedron(), Material(1200.0), joint),
            Body(
                "c", Box((0.1, 0.2, 0.05)), Material(500.0), dataclasses.replace(joint, parent="b")
            ),
        ),
    )


def test_masses_and_inertias_equal_mujocos(same_inertias):
    """MuJoCo integrates the exported mesh, in single precision."""
    same_inertias(animal(), 1e-5)


def test_accelerations_equal_mujocos(compiled, mujocos):
    """Gravity, springs, dampers and rotation in five states: 1e-4 of the largest acceleration."""
    creature = animal()
    tree, model = build_tree(creature), compiled(creature, GRAVITY)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
    data, still = mujoco.MjData(model), np.zeros(tree.dof_count)
    for seed in range(5):
        state = random_state(tree, np.random.default_rng(seed))
        theirs = mujocos(data, tree, state, still)
        ours = accelerations(World(tree, GRAVITY), state, MotorCommand(still))
        assert np.abs(ours - theirs).max() < 1e-4 * np.abs(theirs).max()


def test_export_and_import_preserve_a_creature(read):
    """MuJoCo holds the corners in single precision: 1e-5. Masses are exact numbers."""
    creature = animal()
    found = read(mjcf_text(mjcf_model(creature, 0.0)))
    again = creature_of(found)
    assert found.left_out == ()
    trees = [build_tree(own) for own in (again, creature)]
    np.testing.assert_allclose(trees[0].mass, trees[1].mass, rtol=1e-5)
    for ours, theirs in zip(again.bodies, creature.bodies, strict=True):
        assert (ours.name, type(ours.shape)) == (theirs.name, type(theirs.shape))
        assert ours.shape.volume == pytest.approx(theirs.shape.volume, rel=1e-5)
        expected = theirs.shape.inertia(1.0)
        found = ours.shape.inertia(1.0)
        np.testing.assert_allclose(found, expected, atol=1e-5 * expected.max())
    for ours, theirs in zip(neutral_pose(again), neutral_pose(creature), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-6)


def model(mesh: trimesh.Trimesh) -> str:
    vertices = " ".join(f"{x:.6g}" for x in mesh.vertices.ravel())
    faces = " ".join(map(str, mesh.faces.ravel()))
    return f"""
<mujoco>
  <asset><mesh name="part" inertia="exact" vertex="{vertices}" face="{faces}"/></asset>
  <worldbody>
    <body name="trunk"><freejoint/><geom type="mesh" mesh="part" pos="1 2 3" euler="0 0 30"/></body>
  </worldbody>
</mujoco>
"""


def test_a_rotated_mesh_of_the_root_keeps_its_orientation(read):
    """The mesh of a box at 30 degrees has rotated corners."""
    found = creature_of(read(model(trimesh.creation.box((0.3, 0.2, 0.1)))))
    shape = found.bodies[0].shape
    assert isinstance(shape, ConvexMesh)
    half = np.deg2rad(30)
    corner = [0.15 * np.cos(half) - 0.1 * np.sin(half), 0.15 * np.sin(half) + 0.1 * np.cos(half)]
    assert np.abs(shape.points[:, :2] - corner).max(1).min() < 1e-6


def test_a_mesh_becomes_the_hull_of_its_corners(read, tmp_path):
    """A ball of many corners and a ring. The mass is MuJoCo's, and the files are STL."""
    text = model(trimesh.creation.annulus(0.05, 0.1, 0.1, sections=8))
    found = read(text)
    ring = creature_of(found)
    assert ring.bodies[0].shape.volume == pytest.approx(0.002828, rel=1e-3)
    assert ring.mass == pytest.approx(mujoco.MjModel.from_xml_string(text).body_mass[1], rel=1e-12)
    files = write_imported(found, tmp_path / "model.xml", tmp_path / "ring.yaml", alone=False)
    assert files == [tmp_path / "ring.yaml", tmp_path / "ring_meshes" / "trunk.stl"]
    again = load_config(tmp_path / "ring.yaml").creature.build()
    np.testing.assert_allclose(again.bodies[0].shape.volume, ring.bodies[0].shape.volume, rtol=1e-6)
    found = read(model(trimesh.creation.icosphere(4, 0.1)))
    words = "the hull of its mesh, with 2562 corners, becomes one with 100"
    assert found.changed == (f"unnamed geom of body 'trunk': {words}",)
    ball = creature_of(found).bodies[0].shape
    assert isinstance(ball, ConvexMesh) and len(ball.vertices) == 100
    assert ball.volume == pytest.approx(4 / 3 * np.pi * 0.1**3, rel=0.1)


def test_a_mesh_that_cannot_be_a_body_is_refused(read):
    speck = trimesh.creation.box((1e-4, 1e-4, 1e-4))
    with pytest.raises(
        ExchangeError, match="unnamed geom of body 'trunk': its mesh cannot be a body: it"
    ):
        read(model(speck).replace("<geom ", '<geom mass="1" '))


def test_a_mesh_with_needles_becomes_a_coarser_hull(read):
    """Pairs of close corners at the ends of a rod give needles, which fewer corners avoid."""
    angles = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    ring = np.stack([np.cos(angles), np.sin(angles), 0 * angles], 1) * 0.0005
    end, middle = ring + np.array([0, 0, 0.5]), 0.999 * ring + np.array([0, 0, 0.2])
    corners = np.concatenate([ring, end, middle])
    rod = trimesh.Trimesh(corners).convex_hull
    shape = creature_of(read(model(rod))).bodies[0].shape
    assert isinstance(shape, ConvexMesh) and len(shape.vertices) < 100
    assert shape.volume == pytest.approx(rod.volume, rel=0.1)


LOFT = """
name: x
creature:
  name: x
  materials: {m: {density: 800}}
  bodies:
    - name: a
      material: m
      shape:
        type: loft
        sections:
          - {at: [0.1, 0, 0], width: 0.1, height: 0.05}
          - {at: [0, 0.04, 0], width: 0.06, height: 0.05}
          - {at: [-0.1, 0, 0], width: 0.08, height: 0.05}
"""


def test_a_loft_has_mujocos_mass_and_inertia(compiled):
    """A bent loft of two pieces, in single precision: 1e-5."""
    config = complete_config(yaml.safe_load(LOFT), Path("x.yaml"))
    creature = config.creature.build()
    assert len(creature.bodies) == 2
    tree, model = build_tree(creature), compiled(creature, GRAVITY)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    masses = model.body_mass[1:]
    assert masses.sum() == pytest.approx(tree.mass[0], rel=1e-5)
    com, inertia = np.average(data.xipos[1:], 0, masses), np.zeros((3, 3))
    for i, mass in enumerate(masses, start=1):
        turn, arm = data.ximat[i].reshape(3, 3), data.xipos[i] - com
        inertia += turn @ np.diag(model.body_inertia[i]) @ turn.T
        inertia += mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    ours = np.asarray(tree.com[:, 0])
    np.testing.assert_allclose(com - data.xpos[1], ours, atol=1e-6)
    inertia += masses.sum() * (ours @ ours * np.eye(3) - np.outer(ours, ours))
    expected = np.asarray(tree.inertia)[:3, :3, 0]
    np.testing.assert_allclose(inertia, expected, atol=1e-5 * expected.max())
