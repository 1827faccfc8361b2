"""Meshes in pictures."""

import numpy as np
import pytest
import synthetic

from evo_cpg.creature.creature import Body, Creature, Joint, LightSensor, Material
from evo_cpg.creature.shapes import Box
from evo_cpg.view.meshes import eye_meshes, shape_mesh
from evo_cpg.view.preview import preview
from evo_cpg.view.shadows import soles
from polyhedra import ball_mesh, tetrahedron, wedge


@pytest.mark.parametrize("shape", [tetrahedron(), wedge(), ball_mesh(0.1, 2)], ids="twb")
def test_a_drawn_mesh_matches_its_shape(shape):
    """Volume and bounds are equal. Edges are sharp: triangles have the normals of their planes."""
    mesh = shape_mesh(shape)
    assert mesh.volume == pytest.approx(shape.volume, rel=1e-5)
    np.testing.assert_allclose(np.array(mesh.bounds_size) / 2, shape.half_extents, rtol=1e-5)
    normals = np.asarray(mesh.point_data.active_normals).reshape(-1, 3, 3)
    np.testing.assert_allclose(normals[:, 0], shape.planes[0], atol=1e-5)
    np.testing.assert_array_equal(normals[:, 0], normals[:, 2])
    assert (shape.distance(soles(shape)) < 1e-9).all()


def test_an_eye_looks_out_of_a_mesh():
    """White and pupil lie near the point where the line of sight leaves the body."""
    shape = tetrahedron()
    body = Body("b", shape, Material(1000.0))
    sensor = LightSensor("b", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 3.0)
    white, pupil = eye_meshes(Creature("c", (body,), (sensor,)), sensor)
    place = np.array([[white.center[0], 0, 0]])
    assert abs(shape.distance(place)[0]) < 0.3 * shape.half_extents.min()
    assert pupil.center[0] > white.center[0]


def test_a_preview_shows_meshes(tmp_path):
    joint = Joint("a", (0.3, 0, 0), (-0.2, 0, 0), ((0, 0, 1.0),), (-1.0,), (1.0,))
    creature = Creature(
        "meshes",
        (
            Body("a", wedge(), Material(500.0)),
            Body("b", Box((0.3, 0.1, 0.1)), Material(500.0), joint),
        ),
    )
    path = preview(creature, tmp_path / "meshes.png", (320, 240), ground=True)
    image = synthetic.read(path)
    # The wedge is the orange head, and the box is the blue tail.
    assert (image[..., 0] - image[..., 2] > 120).sum() > 1000
    assert (image[..., 2] - image[..., 0] > 80).sum() > 500
