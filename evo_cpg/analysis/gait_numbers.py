"""Numbers that describe the motion of an animal in one trial.

Speed, power, cost of transport, duty factor, airborne fraction and slip cover the whole trial, as
in `evo_cpg.simulation.measures`. Strides, lags and waves cover its second half, after the initial
motion. A number that does not exist comes with a reason.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float

from evo_cpg.analysis.body_wave import BodyWave, body_wave
from evo_cpg.analysis.chains import axis_signs, joint_rows
from evo_cpg.analysis.feet import Feet, contacts
from evo_cpg.analysis.gait import PhaseLags, phase_lags
from evo_cpg.analysis.gait_quantities import Measurement, Quantity, quantities
from evo_cpg.analysis.midline import MidlineMotion, midline_chain, midline_motion, midline_points
from evo_cpg.analysis.stride import stride_frequency
from evo_cpg.creature.axis_kinds import body_and_axis
from evo_cpg.creature.creature import Creature, length_of, neutral_pose
from evo_cpg.simulation.recording import Recording
from evo_cpg.simulation.simulation import Simulation

# Fraction of the trial, at its end, in which strides are measured.
LAST = 0.5

# Amplitude of the joints below which a body has no wave, rad.
_FAINT = math.radians(1.0)


class GaitNumbers(NamedTuple):
    """Description of an animal's motion.

    Attributes:
        quantities: the numbers.
        step: time between samples, s.
        first: first sample of the part in which strides are measured.
        frequency: stride frequency, Hz, or NaN if nothing repeats.
        axis_signs: sign of each degree of freedom, -1 if its axis points against the axis of the
            first in its row. Lags and wave use the joint angles times these signs.
        lags: phase lags between the joints, in the order of the recording's degrees of freedom.
        chain: degrees of freedom along the body, empty if fewer than three are in a row.
        wave: wave of bending along the chain, or None without a chain or below an amplitude of one
            degree.
        midline: sway of the midline in the body's frame, or None without a wave of bending, without
            a midline of three bodies, with less than two strides, or if the body is coiled.
        feet: contacts with the ground, or None without ground.
        power: absolute power of all motors in each control step, W.
        peak_torque: largest absolute torque of each motor, N m, or force of a slide's, N.
        rms_torque: root mean square torque of each motor, N m.
    """

    quantities: tuple[Quantity, ...]
    step: float
    first: int
    frequency: float
    axis_signs: Float[np.ndarray, " d"]
    lags: PhaseLags
    chain: tuple[int, ...]
    wave: BodyWave | None
    midline: MidlineMotion | None
    feet: Feet | None
    power: Float[np.ndarray, " t"]
    peak_torque: Float[np.ndarray, " d"]
    rms_torque: Float[np.ndarray, " d"]

    def as_dict(self) -> dict[str, Any]:
        """Return the contents of ``analysis.json``. Values that do not exist are None."""
        numbers = {
            each.key: {
                "name": each.name,
                "value": each.value if each.exists else None,
                "unit": each.unit,
                "definition": each.definition,
                "missing": each.missing,
                "animals": [animals._asdict() for animals in each.animals],
            }
            for each in self.quantities
        }
        along = None
        if self.midline is not None:
            lags = self.midline.lag.each
            along = {
                "place": self.midline.envelope.place.tolist(),
                "amplitude": self.midline.envelope.amplitude.tolist(),
                "quadratic": self.midline.envelope.quadratic.tolist(),
                "bending_lag": [float(lag) if math.isfinite(lag) else None for lag in lags],
            }
        return {"quantities": numbers, "along_the_body": along}

    def value(self, key: str) -> float:
        """Return the value of a quantity, or NaN if it does not exist."""
        return next((each.value for each in self.quantities if each.key == key), math.nan)


def gait_numbers(
    simulation: Simulation,
    creature: Creature,
    frames: Mapping[str, Array | np.ndarray],
    recording: Recording,
) -> GaitNumbers:
    """Return the numbers that describe a recorded motion.

    Args:
        simulation: the trial.
        creature: the animal.
        frames: frames of one individual, see `evo_cpg.simulation.recording.Recorder`.
        recording: recording of the same trial, in the order of the creature.
    """
    step = 1.0 / simulation.control_rate
    first = round(len(recording.time) * (1 - LAST))
    angle = np.array(recording.joint_angle, float)[first:]
    # Slides have another unit than angles, and those of a root drift.
    if not recording.slides.all():
        angle[:, recording.slides] = 0.0
    frequency = stride_frequency(angle, step)
    power = np.asarray(frames["energy"], float)[:, 0] / step
    tree = simulation.world.tree
    rows = joint_rows(simulation.world.tree)
    signs = axis_signs(tree, rows)
    angle *= signs
    # The longest row of three or more turning axes along the body. Among equally long rows, it is
    # the row that bends most. Rows of twist (about x) count only if all rows are twist.
    swing, slides = np.asarray(recording.joint_angle).std(0), recording.slides
    turning = [row for row in rows if len(row) > 2 and not slides[list(row)].any()]
    across = [row for row in turning if body_and_axis(recording.dof_names[row[0]])[1] != "x"]
    chain = max(across or turning, key=lambda r: (len(r), swing[list(r)].sum()), default=())
    wave, length = None, float(length_of(creature))
    if chain:
        place = chain_places(simulation, creature, chain)
        wave = body_wave(angle[:, chain], place, length, step, frequency)
        if frequency > 0 and wave.amplitude.max() < _FAINT:
            wave = None
    feet = contacts(simulation, creature, frames, recording, first, frequency)
    row = None if wave is None else midline_chain(creature)
    midline = None
    if row is not None:
        midline = midline_motion(midline_points(row, recording)[first:], step, frequency)
    numbers = GaitNumbers(
        quantities=(),
        step=step,
        first=first,
        frequency=frequency,
        axis_signs=signs,
        lags=phase_lags(angle, step, frequency),
        chain=chain,
        wave=wave,
        midline=midline,
        feet=feet,
        power=power,
        peak_torque=np.abs(recording.torque).max(0, initial=0.0),
        rms_torque=np.sqrt(np.square(recording.torque).mean(0)),
    )
    motion = Measurement(
        simulation=simulation,
        creature=creature,
        frames=frames,
        recording=recording,
        first=first,
        step=step,
        length=length,
        frequency=frequency,
        wave=wave,
        row=row,
        midline=midline,
        feet=feet,
        power=power,
        peak_torque=numbers.peak_torque,
    )
    return numbers._replace(quantities=quantities(motion))


def chain_places(
    simulation: Simulation, creature: Creature, chain: tuple[int, ...]
) -> Float[np.ndarray, " j"]:
    """Return the places of a row of joints along the body, m behind the first joint."""
    if not chain:
        return np.zeros(0)
    tree = simulation.world.tree
    centres, turns = neutral_pose(creature)
    joints = []
    for dof in chain:
        place = creature.body_index(tree.names[tree.dof_bodies[dof]])
        joint = creature.joint_of(creature.bodies[place])
        assert joint is not None
        joints.append(centres[place] + turns[place] @ np.array(joint.child_anchor, float))
    apart = np.linalg.norm(np.diff(joints, axis=0), axis=-1)
    return np.concatenate([[0.0], np.cumsum(apart)])
