"""Ancestors that become each other in one shot, in which limbs grow."""

import numpy as np
import pytest

from evo_cpg.analysis.descent import Milestone, matched
from evo_cpg.creature.algebra.rotation import euler_to_matrix
from evo_cpg.simulation.planned import SINK
from evo_cpg.training.crowd import CrowdMotion
from evo_cpg.view.growth import _CHANGE, _MOVES, RATE, grown
from plans import hand_plan, paired

TAIL = {"label": 7, "place": (-0.2, 0, 0), "rotation": np.diag([-1.0, -1, 1])}
FIRST, SECOND = (
    hand_plan({}, TAIL),
    hand_plan({"half": (0.3, 0.1, 0.1)}, *paired(3, (0, 0.1, 0)), TAIL | {"place": (-0.3, 0, 0)}),
)
TIME = np.arange(0, 8, 1 / 60)


def motion(plan, heading, speed):
    """Return the motion of a plan along a straight way, whose limbs beat by 0.3 rad."""
    beat = 0.3 * np.sin(2 * np.pi * TIME)
    turn = np.array([euler_to_matrix(0.0, 0.0, angle) for angle in heading + 0 * beat])
    position, rotation = [speed * TIME[:, None] * turn[:, :, 0]], [turn]
    for i in range(1, len(plan.parent)):
        swing = np.array([euler_to_matrix(0.0, 0.0, angle) for angle in beat])
        rotation.append(turn @ plan.rotation[i] @ swing)
        joint = position[0] + SINK * turn @ plan.place[i]
        position.append(joint + SINK * plan.half[i, 0] * rotation[-1][:, :, 0])
    place, turns = (np.stack(x, 1)[:, None] for x in (position, rotation))
    return CrowdMotion(TIME, place, turns, np.full(3, np.nan)).recording(0, 0)


@pytest.fixture(scope="module")
def film():
    steps = [
        Milestone(None, FIRST, np.array([-1, -1]), 0, ()),
        Milestone(None, SECOND, matched(FIRST, SECOND), 1, ()),
    ]
    return grown(steps, [motion(FIRST, 0.4, 0.1), motion(SECOND, -1.0, 0.1)], False)


BEGIN, END = round(_MOVES * RATE), round((_MOVES + _CHANGE) * RATE)


def test_new_limbs_grow_from_nothing(film):
    union, _, growth = film
    assert len(union.parent) == 4
    new = growth.scale[:, 2:]
    assert (new[: BEGIN + 1] <= 1.01e-3).all() and (new[END:] > 0.999).all()
    assert (np.diff(new, axis=0) >= 0).all()
    # The trunk goes from two thirds of its last length to all of it, and the tail keeps its size.
    assert growth.scale[[0, -1], 0, 0] == pytest.approx([2 / 3, 1])
    assert growth.scale[:, 1] == pytest.approx(1)
    assert growth.begins == (0, BEGIN / RATE)


def test_limbs_stay_at_their_joints(film):
    union, motion, growth = film
    place, turn = motion.position, motion.rotation
    half = growth.scale * union.half
    for i in range(1, 4):
        at = union.place[i] / union.half[0] * half[:, 0]
        joint = place[:, 0] + SINK * (turn[:, 0] @ at[..., None])[..., 0]
        end = place[:, i] - SINK * half[:, i, :1] * turn[:, i, :, 0]
        there = growth.scale[:, i, 0] > 0.01
        np.testing.assert_allclose(end[there], joint[there], atol=1e-9)
    np.testing.assert_allclose(turn @ turn.mT, np.eye(3) + 0 * turn, atol=1e-9)
    assert (np.linalg.det(turn) > 0).all()


def test_ancestors_move_as_recorded_between_changes(film):
    _, shown, _ = film
    recorded = motion(FIRST, 0.4, 0.1)
    first = round(1.0 * RATE)
    np.testing.assert_allclose(
        shown.position[:BEGIN, :2], recorded.position[first : first + BEGIN], atol=1e-9
    )


def test_one_ancestor_goes_on_from_the_other(film):
    """The way neither bends nor jumps, although both trials have other places and headings."""
    _, shown, _ = film
    step = np.diff(shown.position[:, 0], axis=0) * RATE
    np.testing.assert_allclose(
        step, 0.1 * np.array([np.cos(0.4), np.sin(0.4), 0]) + 0 * step, atol=0.03
    )
