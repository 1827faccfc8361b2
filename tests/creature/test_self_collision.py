"""Pairs of bodies that must not pass through each other, against random postures."""

import dataclasses
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from creatures import quick_jit
from evo_cpg.creature.self_collision import SelfCollision, colliding_pairs, touching
from evo_cpg.creature.tree import build_tree
from evo_cpg.io.build import build_creature
from evo_cpg.io.load import load_config
from evo_cpg.physics.contact.pairs import make_pairs, separations
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import resting_state

CONFIGS = Path(__file__).parents[2] / "configs"
POSTURES = 4000


def shipped(name):
    path = CONFIGS / f"{name}.yaml"
    creature = build_creature(load_config(path, []), path)
    return creature, build_tree(creature)


def gaps(creature, tree, pairs):
    """Return gaps of pairs in random postures, m, ``(points, postures)``."""
    rng = np.random.default_rng(0)
    q = rng.uniform(tree.lower[:, None], tree.upper[:, None], (tree.dof_count, POSTURES))
    state = resting_state(tree, (POSTURES,), jnp.float32)
    state = dataclasses.replace(state, q=jnp.asarray(q, jnp.float32))
    found = quick_jit(lambda s: separations(pairs, kinematics(tree, s)).gap)(state)
    return np.asarray(found)


def names(tree, pairs):
    return {frozenset((tree.names[i], tree.names[j])) for i, j in pairs}


def test_pairs_of_a_quadruped():
    creature, tree = shipped("fukui2003_model1")
    found = names(tree, colliding_pairs(creature, tree, SelfCollision()))
    legs = ("upper", "lower")
    expected = {frozenset(("torso", f"{end}_{side}_lower")) for end in ("front", "hind")
              for side in ("left", "right")}  # fmt: skip
    expected |= {
        frozenset((f"front_{side}_{one}", f"hind_{side}_{two}"))
        for side in ("left", "right")
        for one in legs
        for two in legs
        if "lower" in (one, two)
    }
    assert found == expected


HALF = np.array([0.2, 0.1, 0.05])


def touches(place, turn=0.0, radius=0.0):
    """Return whether a box at a place (m), turned about y (rad), touches a box at the origin."""
    c, s = np.cos(turn), np.sin(turn)
    boxes = (
        np.array([np.zeros(3), place]),
        np.array([np.eye(3), [[c, 0, s], [0, 1, 0], [-s, 0, c]]]),
        np.array([HALF, HALF]),
    )
    given = radius, np.array([[0], [1]]), np.array([True])
    known, traced = touching(boxes, *given), touching(tuple(map(jnp.asarray, boxes)), *given)
    assert known == traced
    return bool(known[0])


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("turn", [0.0, 0.01, 0.03, 0.3])
@pytest.mark.slow
def test_bodies_within_a_tenth_of_a_millimetre_touch(turn):
    """The lowest edge of a turned box is above the other box's face."""
    height = 2 * HALF[2] + HALF[0] * np.sin(turn) + HALF[2] * (np.cos(turn) - 1)
    for gap, radius, expected in (
        (-3e-4, 0.0, True), (5e-5, 0.0, True), (5e-4, 0.0, False), (-3e-4, 1e-3, True),
    ):  # fmt: skip
        assert touches([-0.05, 0.02, height + gap], turn, radius) == expected


@pytest.mark.usefixtures("x64")
def test_the_distance_of_round_corners_decides():
    """Gaps along faces are smaller than the distance by the root of 3."""
    for gap, expected in ((5e-4, True), (7e-4, False)):
        assert touches(2 * HALF + gap, radius=1e-3) == expected


@pytest.mark.parametrize("name", ["fukui2003_model3", "hexapod"])
def test_pairs_left_out_never_meet(name):
    """Most of the kept pairs can get close."""
    creature, tree = shipped(name)
    kept = colliding_pairs(creature, tree, SelfCollision())
    neighbours = {(parent, body) for body, parent in enumerate(tree.parents)}
    count = tree.body_count
    others = [(i, j) for j in range(count) for i in range(j)]
    others = [pair for pair in others if pair not in neighbours and pair not in kept]
    as_names = [(tree.names[i], tree.names[j]) for i, j in kept]
    out = make_pairs(creature, tree, SelfCollision(exclude=tuple(as_names)))
    assert out is None
    every = SelfCollision(include=tuple((tree.names[i], tree.names[j]) for i, j in others))
    pairs = make_pairs(creature, tree, every)
    # Pairs that cannot meet change nothing if included.
    assert len(pairs.first) == len(kept)
    least = gaps(creature, tree, pairs).min(1)
    assert (least < 0.02).mean() > 0.5


def test_neighbours_collide_only_if_included():
    creature, tree = shipped("fukui2003_model1")
    plain = colliding_pairs(creature, tree, SelfCollision())
    pair = ("torso", "front_left_upper")
    more = colliding_pairs(creature, tree, SelfCollision(include=(pair,)))
    assert names(tree, set(more) - set(plain)) == {frozenset(pair)}
    less = colliding_pairs(creature, tree, SelfCollision(exclude=(("front_left_lower", "torso"),)))
    assert names(tree, set(plain) - set(less)) == {frozenset(("front_left_lower", "torso"))}
