"""References of swimming numbers: displacement by the water, and the tip of the tail."""

import dataclasses

import numpy as np
import pytest

from evo_cpg.analysis import gait_numbers
from evo_cpg.physics.water import Current, Water
from evo_cpg.simulation.recording import Recording
from trials import experiment

STEP = 0.1
TIME = STEP * np.arange(50)


def test_drift_is_the_displacement_by_the_flow():
    """Closed forms for a uniform current and for a shear x' = g y."""
    current = (0.3, -0.1, 0.0)
    carried = TIME[:, None] * current
    drift = gait_numbers._drift(Water(1000.0, streams=(Current(current),)), carried, STEP)
    np.testing.assert_allclose(drift, carried, atol=1e-6)
    gradient = ((0.0, 0.5, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    shear = Water(1000.0, streams=(Current(gradient=gradient),))
    beside = np.column_stack([0.5 * 2.0 * TIME, np.full(50, 2.0), np.zeros(50)])
    np.testing.assert_allclose(gait_numbers._drift(shear, beside, STEP)[:, 0], TIME, atol=1e-6)
    assert not gait_numbers._drift(Water(1000.0), beside, STEP).any()


@pytest.mark.parametrize("anchor", [0.03, 0.08, 0.2])
def test_tail_tip_is_the_end_of_the_shape(anchor):
    """The position of the joint does not matter."""
    made = experiment(20)
    index = made.creature.body_index("tail")
    tail = made.creature.bodies[index]
    joint = dataclasses.replace(tail.joint, child_anchor=(anchor, 0.0, 0.0))
    bodies = [*made.creature.bodies]
    bodies[index] = dataclasses.replace(tail, joint=joint)
    creature = dataclasses.replace(made.creature, bodies=tuple(bodies))
    place = np.arange(6.0).reshape(1, 2, 3)
    lying = Recording(np.zeros(1), place, np.broadcast_to(np.eye(3), (1, 2, 3, 3)), *[None] * 7)
    tip = gait_numbers._tail_tip(made.simulation, creature, lying, (0,))
    expected = place[0, index] - [float(tail.shape.half_extents[0]), 0.0, 0.0]
    np.testing.assert_allclose(tip[0], expected, atol=1e-6)
