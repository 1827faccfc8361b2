"""Creatures as trees: order, neutral pose, arrays and errors."""

import dataclasses

import mujoco
import numpy as np
import pytest

from benchmarks.mujoco_model import mujoco_model
from creatures import STRUCTURES, box_chain, hinge, random_creature
from evo_cpg.creature.creature import (
    Body,
    Creature,
    CreatureError,
    Material,
    lowest_height,
    neutral_pose,
    topological_order,
)
from evo_cpg.creature.shapes import Box
from evo_cpg.creature.tree import build_tree, spatial_inertia


def body(name: str, parent: str | None = None, axes: int = 1) -> Body:
    """Return a box, joined to a parent unless it is the root."""
    joint = parent and hinge(parent, (-0.1, 0.0, 0.0), (0.1, 0.0, 0.0), "xyz"[:axes])
    return Body(name, Box((0.2, 0.1, 0.1)), Material(1000.0), joint)


def creature(*bodies: Body) -> Creature:
    return Creature("test", bodies)


PARENT = ".joint.parent"
ERRORS = {
    "no body": (creature(), "at least one body", "bodies"),
    "same name": (
        creature(body("a"), body("b", "a"), body("b", "a")), "'b'", "bodies.2.name",
    ),
    "two roots": (creature(body("a"), body("b")), "both roots", "bodies.1.joint"),
    "world": (creature(body("world"), body("b", "world")), "fixed world", "bodies.0.name"),
    "no root": (creature(body("a", "b"), body("b", "a")), "a, b form a ring", "bodies.0" + PARENT),
    "missing parent": (creature(body("a"), body("b", "c")), "exist.*a, b", "bodies.1" + PARENT),
    "ring": (
        creature(body("a"), body("b", "c"), body("c", "b")), "b, c form", "bodies.1" + PARENT,
    ),
    "own parent": (creature(body("a"), body("b", "b")), "of b form", "bodies.1" + PARENT),
}  # fmt: skip


@pytest.mark.parametrize(("wrong", "words", "where"), ERRORS.values(), ids=ERRORS.keys())
def test_bodies_that_form_no_tree_raise(wrong, words, where):
    """Each error has a message, and a path to the value."""
    with pytest.raises(CreatureError, match=words) as raised:
        build_tree(wrong)
    assert ".".join(map(str, raised.value.where)) == where


def test_order_is_by_level_then_axes_then_description():
    """The description is in reverse order. Level 1 has joints of 3, 1 and 1 axes."""
    described = creature(
        body("tip", "arm", 2),
        body("arm", "trunk", 3),
        body("tail", "trunk", 1),
        body("trunk"),
        body("head", "trunk", 1),
    )
    names = [described.bodies[i].name for i in topological_order(described)]
    assert names == ["trunk", "tail", "head", "arm", "tip"]
    tree = build_tree(described)
    assert tree.names == tuple(names)
    assert tree.parents == (-1, 0, 0, 0, 3)
    assert [(g.bodies, g.dofs, g.axes, g.parents) for g in tree.groups] == [
        (slice(1, 3), slice(0, 2), 1, (0, 0)),
        (slice(3, 4), slice(2, 5), 3, (0,)),
        (slice(4, 5), slice(5, 7), 2, (3,)),
    ]
    assert tree.dof_names == (
        "tail.x", "head.x", "arm.x", "arm.y", "arm.z", "tip.x", "tip.y",
    )  # fmt: skip
    assert tree.dof_bodies == (1, 2, 3, 3, 3, 4, 4)
    assert (tree.body_count, tree.dof_count) == (5, 7)


def test_limbs_of_the_same_build_are_a_group():
    """A hip has as many axes as the two hands of its level, but also carries a leg."""
    described = creature(
        body("chest"),
        body("left_arm", "chest", 2),
        body("right_arm", "chest", 2),
        body("belly", "chest", 1),
        body("left_hand", "left_arm", 1),
        body("right_hand", "right_arm", 1),
        body("hip", "belly", 1),
        body("leg", "hip", 1),
    )
    tree = build_tree(described)
    groups = [tree.names[group.bodies] for group in tree.groups]
    assert groups == [
        ("belly",),
        ("left_arm", "right_arm"),
        ("left_hand", "right_hand"),
        ("hip",),
        ("leg",),
    ]


def test_oblique_axes_are_named_by_their_components():
    oblique = body("b", "a")
    oblique = dataclasses.replace(
        oblique, joint=dataclasses.replace(oblique.joint, axes=((0.6, 0.0, 0.8),))
    )
    assert build_tree(creature(body("a"), oblique)).dof_names == ("b.(0.6,0,0.8)",)


@pytest.mark.parametrize("number", range(len(STRUCTURES)))
def test_neutral_pose_and_mass_equal_mujocos(number):
    """Compare geom centres and rotations in the reference pose, and the total mass."""
    animal = random_creature(np.random.default_rng(number), STRUCTURES[number], axes_seed=number)
    model = mujoco_model(animal)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    centres, rotations = neutral_pose(animal)
    for i, part in enumerate(animal.bodies):
        index = model.body(part.name).id
        geom = model.body(part.name).geomadr[0]
        np.testing.assert_allclose(centres[i], data.geom_xpos[geom], atol=1e-12)
        np.testing.assert_allclose(rotations[i].ravel(), data.xmat[index], atol=1e-12)
    assert animal.mass == pytest.approx(model.body_subtreemass[0], rel=1e-12)


def test_spatial_inertia_gives_the_kinetic_energy():
    """1/2 V.I V = 1/2 m |v_c|^2 + 1/2 w.I_c w with v_c = v + w x c."""
    rng = np.random.default_rng(0)
    mass, com = 3.0, rng.normal(size=3)
    spin = np.diag([0.1, 0.2, 0.25])
    w, v = rng.normal(size=(2, 3))
    twist = np.concatenate([w, v])
    centre = v + np.cross(w, com)
    expected = 0.5 * mass * centre @ centre + 0.5 * w @ spin @ w
    inertia = spatial_inertia(mass, com, spin)
    assert 0.5 * twist @ inertia @ twist == pytest.approx(expected, rel=1e-13)
    np.testing.assert_array_equal(inertia, inertia.T)


def test_limit_stiffness_uses_the_effective_inertia():
    """Stiffness I w^2 and critical damping 2 I w, w = 2 pi 10 Hz and I = I_1 I_2 / (I_1 + I_2).

    The joint is in the middle of a chain of four boxes. Each half has two boxes of mass m at d and
    3 d from the joint, so I_half = 2 m (l^2 + w^2) / 12 + m (d^2 + 9 d^2).
    """
    tree = build_tree(box_chain(4, "z"))
    mass, reach = 2.0, 0.11
    half = 2 * mass * (0.2**2 + 0.1**2) / 12 + mass * 10 * reach**2
    rate = 2 * np.pi * 10
    np.testing.assert_allclose(tree.limit_stiffness[1], half / 2 * rate**2, rtol=1e-12)
    np.testing.assert_allclose(tree.limit_damping[1], half * rate, rtol=1e-12)


@pytest.mark.parametrize("seed", range(12))
def test_lowest_height_equals_the_lowest_surface_point(seed):
    """Compare random shapes and rotations with a fine quadrature of the surfaces."""
    rng = np.random.default_rng(seed)
    animal = random_creature(rng, STRUCTURES[seed % len(STRUCTURES)], axes_seed=seed)
    heights = [
        (centre + body.shape.surface(40).points @ rotation.T)[:, 2].min()
        for body, centre, rotation in zip(animal.bodies, *neutral_pose(animal), strict=True)
    ]
    # The Gauss points nearest to a corner of a box of 0.4 m are 0.2 mm away on each axis.
    assert min(heights) - 1e-3 < lowest_height(animal) <= min(heights)
