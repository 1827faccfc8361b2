"""Numbers that describe the motion of an animal in one trial.

Speed, power, cost of transport, duty factor, airborne fraction and slip cover the whole trial, as
in `evo_cpg.simulation.measures`. Strides, lags and waves cover its second half, after the initial
motion. A number that does not exist comes with a reason.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float

from evo_cpg.analysis import stride
from evo_cpg.analysis.allometry import running_cost, swimming_cost
from evo_cpg.analysis.animals import Animals, animals_of
from evo_cpg.analysis.body_wave import BodyWave, body_wave
from evo_cpg.analysis.chains import axis_signs, joint_rows
from evo_cpg.analysis.feet import Feet, contacts
from evo_cpg.analysis.midline import MidlineMotion, midline_motion
from evo_cpg.analysis.midline_points import midline_chain, midline_points
from evo_cpg.analysis.muscle_quantities import muscle_quantities
from evo_cpg.analysis.phase_lags import PhaseLags, phase_lags
from evo_cpg.analysis.quantity import Quantity
from evo_cpg.analysis.swim_quantities import is_dry, water_quantities, wave_quantities
from evo_cpg.analysis.walk_quantities import ground_quantities
from evo_cpg.creature.axis_kinds import body_and_axis
from evo_cpg.creature.creature import Creature, length_of, neutral_pose
from evo_cpg.creature.slender import SlenderChain
from evo_cpg.simulation.recording import Recording
from evo_cpg.simulation.simulation import Simulation

# Fraction of the trial, at its end, in which strides are measured.
LAST = 0.5

# Amplitude of the joints below which a body has no wave, rad.
_FAINT = math.radians(1.0)

_STAYS = "its path in the second half of the trial is shorter than 1 % of its length"
_NO_STRIDE = "the joint angles do not repeat twice in the second half of the trial"


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
        quantities = {
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
        return {"quantities": quantities, "along_the_body": along}

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
        frames: frames of one individual, see `evo_cpg.simulation.rollout.record`.
        recording: recording of the same trial, in the order of the creature.
    """
    step = 1.0 / simulation.control_rate
    first = round(len(recording.time) * (1 - LAST))
    angle = np.array(recording.joint_angle, float)[first:]
    # Slides have another unit than angles, and those of a root drift.
    if not recording.slides.all():
        angle[:, recording.slides] = 0.0
    frequency = stride.stride_frequency(angle, step)
    power = np.asarray(frames["energy"], float)[:, 0] / step
    tree = simulation.world.tree
    rows = joint_rows(simulation.world.tree)
    signs = axis_signs(tree, rows)
    angle *= signs
    chain = _chain(rows, recording)
    wave = None
    if chain:
        place = chain_places(simulation, creature, chain)
        length = float(length_of(creature))
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
    found = _quantities(simulation, creature, frames, recording, numbers, row)
    present = [each._replace(missing="") if each.exists else each for each in found]
    return numbers._replace(quantities=tuple(map(_beside_animals, present)))


def _beside_animals(each: Quantity) -> Quantity:
    """Return a quantity with the ranges of animals, if it does not have any yet."""
    return each if each.animals else each._replace(animals=animals_of(each.key))


def _quantities(
    simulation: Simulation,
    creature: Creature,
    frames: Mapping[str, Array | np.ndarray],
    recording: Recording,
    numbers: GaitNumbers,
    row: SlenderChain | None,
) -> list[Quantity]:
    step, frequency = numbers.step, numbers.frequency
    duration = len(recording.time) * step
    root = next(i for i, body in enumerate(creature.bodies) if body.joint is None)
    place = np.asarray(recording.position, float)
    on_ground = simulation.world.contact_model is not None
    straight = (place[-1, root] - place[0, root])[: 2 if on_ground else 3]
    distance = float(np.linalg.norm(straight))
    speed = distance / (duration - step) if duration > step else math.nan
    length, mass = float(length_of(creature)), float(creature.mass)
    tree = simulation.world.tree
    order = [tree.names.index(body.name) for body in creature.bodies]
    weights = np.asarray(tree.mass, float)[order]
    masses = place
    if tree.centre_of_volume is not None:
        # The place of a body is the centre of its shape.
        off = np.asarray(tree.com - tree.centre, float)[:, order]
        masses = place + np.einsum("tbij,jb->tbi", np.asarray(recording.rotation, float), off)
    middle = np.average(masses, axis=1, weights=weights)[numbers.first :]
    along = stride.path_speed(middle, step, frequency)
    gravity = float(simulation.world.gravity)
    energy = float(numbers.power.sum() * step)
    # The energy of the last control step moves the animal beyond the last recorded position.
    spent = float(numbers.power[:-1].sum() * step)
    no_stride, muscular = "" if frequency > 0 else _NO_STRIDE, tree.muscles is not None
    moving = stride.if_anywhere(along, step * (len(middle) - 1), length)
    stride_length = stride.stride_length(moving, frequency)
    found = [
        Quantity("duration", "duration", duration, "s", "duration of the trial"),
        Quantity("length", "body length", length, "m", "largest extent with all joints at zero"),
        Quantity("mass", "mass", mass, "kg", "mass of all bodies"),
        Quantity(
            "speed", "speed", speed, "m/s",
            "displacement of the root's centre from start to end / duration"
            + (", without height" if on_ground else ""),
        ),
        Quantity("speed_in_lengths", "relative speed", speed / length, "lengths/s",
                 "speed / body length"),
        Quantity("path_speed", "path speed", along, "m/s",
                 "speed of the centre of mass along its path in the second half, smoothed over a "
                 "stride"),
        Quantity("stride_frequency", "stride frequency", frequency, "Hz",
                 "inverse of the shortest time after which all joint angles repeat, from their "
                 "autocorrelation (Moe-Nilssen and Helbostad 2004)", no_stride),
        Quantity("stride_length", "stride length", stride_length, "m",
                 "path speed / stride frequency (Alexander 2003)", no_stride or _STAYS),
        Quantity("relative_stride", "relative stride length", stride_length / length, "lengths",
                 "stride length / body length", no_stride or _STAYS),
    ]  # fmt: skip
    if numbers.feet is not None:
        found += ground_quantities(
            simulation, creature, recording, numbers.feet, middle, frequency, moving, _STAYS
        )
    swims = False
    if numbers.wave is not None:
        found.append(
            Quantity("lag", "lag per joint", numbers.wave.lag, "deg",
                     "mean phase lag of the bending of neighbours along the body",
                     no_stride or "its bending is a standing wave")
        )  # fmt: skip
    if row is not None:
        found += wave_quantities(numbers.midline, no_stride)
        swims = not is_dry(simulation, creature, recording, row, numbers.first)
        if simulation.world.water is not None:
            found += water_quantities(
                simulation, frames, numbers.midline, middle, frequency, length, not swims,
                no_stride, _STAYS,
            )  # fmt: skip
    swims |= simulation.world.water_level == math.inf
    found += [
        Quantity("power", "mean power", energy / duration, "W",
                 "power of all motors, |torque x rate| summed over the joints"
                 + (", and metabolic power of muscles (Minetti and Alexander 1997)" * muscular)),
        Quantity("peak_power", "peak power", float(numbers.power.max(initial=0.0)), "W",
                 "largest power, as a mean of a control step"),
        Quantity("energy", "energy", energy, "J", "mean power x duration"),
        Quantity("cost_of_transport", "cost of transport",
                 stride.cost_of_transport(spent, mass, gravity, distance), "",
                 "energy / (weight x displacement) (Tucker 1975)",
                 "it has no displacement or no weight", _cost_of_animals(mass, speed, swims)),
        Quantity("peak_torque", "peak torque", float(
            numbers.peak_torque[~recording.slides].max(initial=0.0)), "N m",
                 "largest torque of any motor, as a mean of a control step"),
    ]  # fmt: skip
    return found + muscle_quantities(tree, recording)


def _cost_of_animals(mass: float, speed: float, swims: bool) -> tuple[Animals, ...]:
    """Return the cost of transport of animals of a mass (kg) at a speed (m/s)."""
    if swims:
        low, high = swimming_cost(mass)
        animal, source = "fish of this mass, metabolic", "formulas for fish and for salmon"
    elif speed > 0:
        low, high = running_cost(mass), running_cost(mass, speed)
        animal = "runners of this mass, metabolic, fast and at this speed"
        source = "Taylor et al. 1982"
    else:
        return ()
    return (Animals("cost_of_transport", float(low), float(high), animal, source),)


def _chain(rows: Sequence[tuple[int, ...]], recording: Recording) -> tuple[int, ...]:
    """Return the longest row of three or more turning axes along the body.

    Among equally long rows, return the row that bends most. Rows of twist (about x) count only if
    all rows are twist.
    """
    swing = np.asarray(recording.joint_angle).std(0)
    slides = recording.slides
    found = [row for row in rows if len(row) > 2 and not slides[list(row)].any()]
    across = [row for row in found if body_and_axis(recording.dof_names[row[0]])[1] != "x"]
    return max(across or found, key=lambda row: (len(row), swing[list(row)].sum()), default=())


def chain_places(
    simulation: Simulation, creature: Creature, chain: tuple[int, ...]
) -> Float[np.ndarray, " j"]:
    """Return the places of joints along the body, m behind the first joint.

    Args:
        simulation: the trial.
        creature: the animal.
        chain: degrees of freedom in a row.
    """
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
