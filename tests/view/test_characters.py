"""How animals look: skins over chains, fins, shells and eyes."""

import dataclasses
import functools

import numpy as np
import pytest
import pyvista as pv
import synthetic

from evo_cpg.creature.creature import Creature, lowest_height, neutral_pose
from evo_cpg.io.build import build_creature
from evo_cpg.io.load import load_config
from evo_cpg.io.shipped import shipped, shipped_names
from evo_cpg.view.fins import Fin, fins
from evo_cpg.view.meshes import drawn_eyes, pieces
from evo_cpg.view.skin import Draped, skins


@functools.cache
def creature(name: str) -> Creature:
    path = shipped(name).path
    return build_creature(load_config(path), path)


def outwards(mesh: pv.PolyData) -> bool:
    """Return whether a surface is closed and its triangles face outwards."""
    closed = mesh.clean(tolerance=1e-9)
    return closed.n_open_edges == 0 and volume(mesh) > 0


def volume(mesh: pv.PolyData) -> float:
    """Return the volume within a surface by Gauss's theorem, m^3."""
    corners = np.asarray(mesh.points, float)[mesh.regular_faces]
    return float(np.linalg.det(corners).sum() / 6)


def test_the_skin_of_a_straight_chain_is_its_outline():
    (skin,) = skins(synthetic.swimmer())
    draped, count = Draped(synthetic.swimmer(), skin), len(synthetic.swimmer().bodies)
    position = np.zeros((count, 3))
    position[:, 0] = -0.22 * np.arange(count)
    draped.move(position, np.broadcast_to(np.eye(3), (count, 3, 3)))
    points = np.asarray(draped.mesh.points)
    np.testing.assert_allclose(points[:, 0].min(), position[-1, 0], atol=1e-6)
    np.testing.assert_allclose(np.abs(points[:, 1:]).max(0), 0.93 * 0.05, rtol=1e-5)
    # The normals point outwards, and so do the triangles.
    normals = np.asarray(draped.mesh.point_data["Normals"])
    assert ((normals[:, 1:] * points[:, 1:]).sum(1) > 0).all()
    corners = points[draped.mesh.regular_faces]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((facing * corners.mean(1))[:, 1:].sum(1) > 0).all()


def test_the_skin_passes_through_bent_bodies_and_moves_rigidly_with_a_rigid_animal():
    animal, recording = synthetic.swimmer(), synthetic.swim(2.0)
    (skin,) = skins(animal)
    draped = Draped(animal, skin)
    position, rotation = recording.position[100], recording.rotation[100]
    draped.move(position, rotation)
    around = len(skin.points) // (1 + 5 * (len(position) - 1))
    rings = np.asarray(draped.mesh.points, float).reshape(-1, around, 3)
    np.testing.assert_allclose(rings[::5].mean(1), position, atol=1e-6)
    # Every ring at a body lies across its axis.
    aside = np.einsum("bki,bi->bk", rings[::5] - position[:, None], rotation[..., 0])
    np.testing.assert_allclose(aside, 0, atol=1e-6)
    centres, rotations = neutral_pose(animal)
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    draped.move(centres @ turn.T + [1, 2, 3], turn @ rotations)
    np.testing.assert_allclose(draped.mesh.points, skin.points @ turn.T + [1, 2, 3], atol=1e-5)


@pytest.mark.parametrize("name", ["fish", "turtle", "starfish"])
def test_fins_are_closed_and_stay_within_their_plates(name):
    animal = creature(name)
    found = fins(animal)
    assert {animal.bodies[i].name for i in found} == {
        body.name
        for body in animal.bodies
        if any(word in body.name for word in ("fin", "pectoral", "flipper", "paddle", "arm"))
    }
    for i, fin in found.items():
        mesh = fin.mesh()
        assert outwards(mesh)
        normals = np.asarray(mesh.point_data["Normals"])
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, rtol=1e-5)
        beyond = np.abs(mesh.points) / np.asarray(animal.bodies[i].shape.half_extents)
        # It is as long as the plate, and nowhere larger.
        np.testing.assert_allclose(beyond.max(), 1, atol=1e-6)


@pytest.mark.parametrize(("height", "swims"), [(-0.2, False), (0.0, True)])
def test_a_plate_that_lies_on_the_ground_is_a_foot(height, swims):
    animal = creature("turtle")
    paddles = [animal.body_index(f"{side}_paddle") for side in ("left", "right")]
    bodies = list(animal.bodies)
    for i in paddles:
        joint = dataclasses.replace(bodies[i].joint, parent_anchor=(-0.28, 0.1, height))
        bodies[i] = dataclasses.replace(bodies[i], joint=joint)
    animal = dataclasses.replace(animal, bodies=tuple(bodies))
    assert (lowest_height(animal, neutral_pose(animal)) >= -0.2) == swims
    assert [i in fins(animal) for i in paddles] == [swims, swims]


def test_a_blind_animal_has_eyes_at_its_front():
    left, right = drawn_eyes(synthetic.walker())
    assert left.body == right.body == "trunk"
    assert left.axis[1] > 0 > right.axis[1] and left.position[0] > 0.2
    # A leg that is welded to the trunk is no head.
    assert {eye.body for eye in drawn_eyes(creature("ant"))} == {"torso"}


def test_every_shipped_animal_has_eyes_ahead_of_its_middle():
    for name in sorted(shipped_names()):
        animal = creature(name)
        centres, rotations = neutral_pose(animal)
        eyes = [
            rotations[i] @ np.asarray(piece.mesh.center) + centres[i]
            for i, own in enumerate(pieces(animal))
            for piece in own
            if piece.name.startswith("pupil")
        ]
        middle = np.asarray(centres)[:, 0].mean()
        assert max(eye[0] for eye in eyes) > middle, name
        assert all(isinstance(fin, Fin) for fin in fins(animal).values())
