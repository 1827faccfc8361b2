"""Meshes and previews."""

import dataclasses

import numpy as np
import pytest
import synthetic

from creatures import hinge
from evo_cpg.creature.creature import (
    Body,
    Creature,
    DepthSensor,
    LightSensor,
    Material,
    neutral_pose,
)
from evo_cpg.creature.shapes import Box, Capsule, Ellipsoid, Sphere
from evo_cpg.physics.contact.contact_model import Ground
from evo_cpg.physics.contact.terrain import Block, Boulder, Plane
from evo_cpg.view.meshes import eye_meshes, head_index, shape_mesh
from evo_cpg.view.output import oversampling
from evo_cpg.view.preview import obstacles_near, preview
from polyhedra import ball_mesh, tetrahedron, wedge


@pytest.mark.parametrize(
    "shape",
    [Box((0.2, 0.1, 0.06)), Ellipsoid((0.3, 0.2, 0.1)), Sphere(0.1), Capsule(0.05, 0.2)],
    ids=lambda shape: type(shape).__name__,
)
def test_a_mesh_is_closed_and_has_the_size_of_its_shape(shape):
    mesh = shape_mesh(shape)
    assert np.allclose(np.array(mesh.bounds_size) / 2, shape.half_extents, rtol=0.02)
    # Rounded edges make a box a little smaller. Chords make the other shapes a little smaller.
    assert mesh.volume == pytest.approx(shape.volume, rel=0.07)
    assert mesh.volume < shape.volume
    assert np.abs(shape.distance(np.asarray(mesh.points))).max() < 0.3 * shape.half_extents.min()
    outward = np.einsum("ij,ij->i", mesh.points, mesh.point_data.active_normals)
    assert (outward > 0).all()
    # Corners run anticlockwise, seen from outside, because sides that face away are not drawn.
    # Triangles between octants that meet without a gap have no area.
    a, b, c = np.moveaxis(np.asarray(mesh.points, float)[mesh.regular_faces], 1, 0)
    volumes = np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c) / 18
    assert volumes.min() > -1e-12 and volumes.sum() == pytest.approx(mesh.volume)


@pytest.mark.parametrize("shape", [tetrahedron(), wedge(), ball_mesh(0.1, 2)], ids="twb")
def test_a_drawn_mesh_matches_its_shape(shape):
    """Volume and bounds are equal. Edges are sharp: triangles have the normals of their planes."""
    mesh = shape_mesh(shape)
    assert mesh.volume == pytest.approx(shape.volume, rel=1e-5)
    np.testing.assert_allclose(np.array(mesh.bounds_size) / 2, shape.half_extents, rtol=1e-5)
    normals = np.asarray(mesh.point_data.active_normals).reshape(-1, 3, 3)
    np.testing.assert_allclose(normals[:, 0], shape.planes[0], atol=1e-5)
    np.testing.assert_array_equal(normals[:, 0], normals[:, 2])
    assert (shape.distance(shape.corners) < 1e-9).all()


@pytest.mark.parametrize("shape", [Box((0.2, 0.1, 0.1)), tetrahedron()], ids="bt")
def test_an_eye_sits_where_its_line_of_sight_leaves_the_body(shape):
    body = Body("b", shape, Material(1000.0))
    inside = LightSensor("b", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), np.pi)
    white, pupil = eye_meshes(Creature("c", (body,), (inside,)), inside)
    place = np.array([[white.center[0], 0, 0]])
    assert abs(shape.distance(place)[0]) < 0.3 * shape.half_extents.min()
    assert white.center[1:] == pytest.approx((0, 0), abs=1e-6)
    assert pupil.bounds.x_max > white.bounds.x_max


def test_the_head_is_the_body_with_eyes_or_else_the_root():
    creature = synthetic.swimmer()
    eye = dataclasses.replace(creature.light_sensors[0], body="b9")
    assert head_index(creature) == 0
    assert head_index(dataclasses.replace(creature, light_sensors=(eye,))) == 9
    assert head_index(dataclasses.replace(creature, light_sensors=())) == 0


def test_a_preview_shows_meshes(tmp_path):
    joint = hinge("a", (0.3, 0, 0), (-0.2, 0, 0))
    head = Body("a", wedge(), Material(500.0))
    tail = Body("b", Box((0.3, 0.1, 0.1)), Material(500.0), joint)
    path = preview(Creature("meshes", (head, tail)), tmp_path / "m.png", (320, 240), ground=True)
    image = synthetic.read(path)
    assert image.shape == (240, 320, 3)
    # The wedge is the orange head, and the box is the blue tail.
    assert (image[..., 0] - image[..., 2] > 120).sum() > 1000
    assert (image[..., 2] - image[..., 0] > 80).sum() > 500


STONES = (Boulder((1.5, 0.8, 0.0), 0.3), Block((-2.0, -1.2, 0.0), (0.2, 0.3, 0.4), 0.5))


@pytest.mark.slow
def test_a_preview_shows_near_stones(tmp_path):
    """Each stone on a slope adds grey to the picture. Stones far away are counted."""
    floor = Plane((0.0, 0.0995, 0.995))
    creature = synthetic.swimmer()
    centres, turns = neutral_pose(creature)
    pose = centres + np.array([0, 0, 0.5]), turns

    def grey(*stones):
        ground = Ground(floor=floor, obstacles=stones)
        path = preview(creature, tmp_path / "x.png", (480, 270), ground=ground, pose=pose)
        image = synthetic.read(path).astype(int)
        return int(((np.ptp(image, axis=-1) < 30) & (image.mean(-1) < 150)).sum())

    none, one, two = grey(), grey(STONES[0]), grey(*STONES)
    assert one > none + 500
    assert two > none + 500
    far = Boulder((500.0, 0.0, 0.0), 1.0)
    assert obstacles_near(Ground(obstacles=(*STONES, far)), centres)[1] == 1
    assert len(obstacles_near(Ground(obstacles=(far,)), centres)[0]) == 0


def blue(image: np.ndarray) -> np.ndarray:
    """Mask of the pixels with more blue than red."""
    return image[..., 2].astype(int) - image[..., 0] > 12


def test_a_preview_under_water_is_blue(tmp_path):
    """It is blue all around the animal. On dry land only the hind end is blue."""
    creature = synthetic.walker()

    def seen(**where):
        return blue(synthetic.read(preview(creature, tmp_path / "x.png", (480, 270), **where)))

    assert seen(ground=True).mean() < 0.15
    assert seen(ground=True, surface=np.inf).mean() > 0.8
    assert seen(surface=2.0).mean() > 0.8


@pytest.mark.slow
def test_a_small_preview_has_no_words(tmp_path):
    """Words are dark. The animal and the arrows of its axes are not."""

    def dark(size):
        image = synthetic.read(preview(synthetic.swimmer(), tmp_path / "x.png", size))
        return int((image.max(-1) < 70).sum())

    assert dark((320, 180)) > 100 > 3 * dark((318, 178))


@pytest.mark.slow
def test_a_preview_shows_pressure_sensors_only_on_ground(tmp_path):
    """Pressure sensors are pink. A depth gauge is blue, and drawn with or without ground."""
    creature = dataclasses.replace(
        synthetic.swimmer(),
        pressure_sensors=("b0", "b1", "b2"),
        depth_sensors=(DepthSensor("b0", (0.0, 0.0, 0.0), 1.0),),
    )

    def counts(creature, **where):
        image = synthetic.read(preview(creature, tmp_path / "x.png", (480, 270), **where))
        return [
            int((np.abs(image.astype(int) - color).max(-1) < 12).sum())
            for color in ((0xCC, 0x79, 0xA7), (0x56, 0xB4, 0xE9))
        ]

    pink, blue = counts(creature)
    assert pink == 0 < blue
    assert counts(creature, ground=True)[0] > 20
    assert counts(dataclasses.replace(creature, depth_sensors=()))[1] < blue


@pytest.mark.parametrize("size", [(16, 16), (8192, 16), (8192, 8192), (7680, 4320), (1280, 720)])
def test_oversampling_stays_within_the_drawable_size(size):
    for desired in (1.25, 2.0, 3.0):
        factor = oversampling(size, desired)
        assert 1 <= factor <= desired
        assert factor * max(size) <= 16384 and factor**2 * size[0] * size[1] <= 2**26 + 1
    assert oversampling((1280, 720), 3.0) == 3.0
