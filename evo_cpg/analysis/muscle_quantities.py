"""Mechanical work of muscles in a recorded motion."""

import numpy as np

from evo_cpg.analysis.quantity import Quantity
from evo_cpg.creature.tree import Tree
from evo_cpg.simulation.recording import Recording


def muscle_quantities(tree: Tree, recording: Recording) -> list[Quantity]:
    """Return the work of the muscles up to the last recorded position, or nothing without muscles.

    Args:
        tree: the animal.
        recording: its motion.
    """
    if tree.muscles is None:
        return []
    turn = np.diff(np.asarray(recording.joint_angle, float), axis=0)
    work = (np.asarray(recording.torque, float)[:-1] * turn)[:, np.array(tree.muscles.driven)]
    return [
        Quantity("muscle_work", "work of muscles", float(work.sum()), "J",
                 "torque x change of the joint's angle, summed over the joints with muscles"),
        Quantity("positive_muscle_work", "positive work of muscles",
                 float(np.maximum(work, 0.0).sum()), "J",
                 "the same, of muscles that turn their joints"),
        Quantity("absolute_muscle_work", "absolute work of muscles", float(np.abs(work).sum()), "J",
                 "the same, |torque x change of the angle|, as motors are counted"),
    ]  # fmt: skip
