"""Rhythm on both sides of a cut: do the joints behind it follow those in front?

The joint behind the cut is the joint at which the cord is cut. The joint in front is the next one
towards the root that has the same axis. A cycle begins when an angle crosses its mid-range upwards.
Let t_k be the beginnings behind the cut, and T_j <= t_k < T_(j+1) those in front. The phase is

    p_k = (t_k - T_j) / (T_(j+1) - T_j).

The lag is the circular mean of p_k, and the scatter its circular standard deviation. Two sides with
rhythms of their own have a large scatter.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from evo_cpg.analysis.cycles import cycle_starts, frequency_of, mean_phase
from evo_cpg.analysis.gait_quantities import Quantity
from evo_cpg.analysis.laboratory.bodies import joints_of
from evo_cpg.analysis.laboratory.settings import NOTHING, Setting
from evo_cpg.control.couplings import axis_directions, axis_parents
from evo_cpg.creature.tree import Tree
from evo_cpg.simulation.recording import Recording


class Sides(NamedTuple):
    """Rhythms of the joints in front of a cut and behind it.

    Attributes:
        front: frequency in front, Hz, or NaN without a rhythm.
        behind: frequency behind, Hz.
        lag: phase by which the joint behind follows the one in front, degrees, -180 to 180.
        scatter: circular standard deviation of this phase, cycles.
    """

    front: float
    behind: float
    lag: float
    scatter: float


def cut_of(settings: Sequence[Setting]) -> str:
    """Return the only cut of some settings, where the intact are measured, too, or `NOTHING`."""
    cuts = {setting.get("cut", NOTHING) for setting in settings} - {NOTHING}
    return cuts.pop() if len(cuts) == 1 else NOTHING


def cut_numbers(tree: Tree, recording: Recording, cut: str, first: int) -> list[Quantity]:
    """Return the measures of the two sides of a cut, at its first body if there are several.

    Args:
        tree: the creature.
        recording: the motion.
        cut: body in front of whose joint the cord is cut, or `NOTHING`.
        first: first measured sample.
    """
    found = Sides(math.nan, math.nan, math.nan, math.nan)
    if cut != NOTHING:
        behind = tree.dof_bodies.index(min(joints_of(tree, "cut", cut)))
        front = axis_parents(tree)[behind]
        if front is not None:
            angles = recording.joint_angle[first:] * np.array(axis_directions(tree))
            step = float(recording.time[1] - recording.time[0])
            found = sides(angles[:, front], angles[:, behind], step)
    return [
        Quantity("front_frequency", "frequency in front of the cut", found.front, "Hz",
                 "of the next joint in front of the cut"),
        Quantity("behind_frequency", "frequency behind the cut", found.behind, "Hz",
                 "of the joint at the cut"),
        Quantity("cut_lag", "lag at the cut", found.lag, "degrees",
                 "phase by which the joint behind the cut follows the one in front"),
        Quantity("cut_scatter", "scatter of this lag", found.scatter, "cycles",
                 "circular standard deviation"),
    ]  # fmt: skip


def sides(front: Float[np.ndarray, " t"], behind: Float[np.ndarray, " t"], step: float) -> Sides:
    """Return the rhythms of two angles, and how the second follows the first.

    Args:
        front: angle in front of the cut, rad.
        behind: angle behind the cut, rad.
        step: time between samples, s.
    """
    begins, follows = cycle_starts(front, step), cycle_starts(behind, step)
    own = frequency_of(begins), frequency_of(follows)
    if not np.isfinite(own).all():
        return Sides(*own, math.nan, math.nan)
    within = follows[(follows >= begins[0]) & (follows < begins[-1])]
    if not len(within):
        return Sides(*own, math.nan, math.nan)
    phase = np.interp(within, begins, np.arange(len(begins)))
    mean, scatter = mean_phase(phase)
    return Sides(*own, 360 * mean, scatter)
