"""Numbers that describe the motion of an animal in one trial.

Speed, power, cost of transport, duty factor and airborne fraction cover the whole trial, as in
`evo_cpg.simulation.measures`. Strides, lags and waves cover its second half, after the initial
motion. A number that does not exist comes with a reason.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from evo_cpg.analysis import footfalls, stride
from evo_cpg.analysis.body_wave import BodyWave, body_wave
from evo_cpg.analysis.chains import axis_signs, joint_rows
from evo_cpg.analysis.footfalls import Phases
from evo_cpg.analysis.midline import sway
from evo_cpg.analysis.midline_points import midline_chain, midline_points
from evo_cpg.analysis.phase_lags import PhaseLags, phase_lags
from evo_cpg.analysis.swimming import strouhal_number
from evo_cpg.creature.creature import Creature, length_of, neutral_pose
from evo_cpg.physics.water import Water
from evo_cpg.simulation.recording import Recording
from evo_cpg.simulation.simulation import Simulation

# Fraction of the trial, at its end, in which strides are measured.
LAST = 0.5

# Length of the path in the second half, in body lengths, below which an animal counts as standing.
_NOWHERE = 0.01
# Amplitude of the joints below which a body has no wave, rad.
_FAINT = math.radians(1.0)

_DRY = "it is out of the water for more than half of the time"
_STAYS = "its path in the second half of the trial is shorter than 1 % of its length"
_NO_STRIDE = "the joint angles do not repeat twice in the second half of the trial"


class Quantity(NamedTuple):
    """A number with its name, for a table.

    Attributes:
        key: short name of letters and underscores.
        name: name in words.
        value: value, or NaN if it does not exist.
        unit: unit, empty for a pure number.
        definition: definition, and the source of the formula.
        missing: reason why the value does not exist, empty if it does.
    """

    key: str
    name: str
    value: float
    unit: str
    definition: str
    missing: str = ""


class Feet(NamedTuple):
    """Bodies that touch the ground, except the root.

    Attributes:
        names: names of the bodies that ever touch, in the order of the creature.
        touched: whether each body touches in each control step.
        steady: ``touched`` without chatter.
        duty_factor: duty factor of each body.
        phases: phases of the touch-downs in the second half of the trial.
        slip: speed of each body over the ground in contact, m/s. NaN without three control steps of
            contact in a row.
        airborne: fraction of the control steps in which nothing touches, the root included.
    """

    names: tuple[str, ...]
    touched: Bool[np.ndarray, "t f"]
    steady: Bool[np.ndarray, "t f"]
    duty_factor: Float[np.ndarray, " f"]
    phases: Phases
    slip: Float[np.ndarray, " f"]
    airborne: float


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
        wave: wave along the chain, or None without a chain or below an amplitude of one degree.
        feet: contacts with the ground, or None without ground.
        power: absolute power of all motors in each control step, W.
        peak_torque: largest absolute torque of each motor, N m.
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
    feet: Feet | None
    power: Float[np.ndarray, " t"]
    peak_torque: Float[np.ndarray, " d"]
    rms_torque: Float[np.ndarray, " d"]

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
    frequency = stride.stride_frequency(angle, step)
    power = np.asarray(frames["energy"], float)[:, 0] / step
    tree = simulation.world.tree
    rows = joint_rows(simulation)
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
    feet = _feet(simulation, creature, frames, recording, first, frequency)
    numbers = GaitNumbers(
        quantities=(),
        step=step,
        first=first,
        frequency=frequency,
        axis_signs=signs,
        lags=phase_lags(angle, step, frequency),
        chain=chain,
        wave=wave,
        feet=feet,
        power=power,
        peak_torque=np.abs(recording.torque).max(0, initial=0.0),
        rms_torque=np.sqrt(np.square(recording.torque).mean(0)),
    )
    found = _quantities(simulation, creature, recording, numbers)
    present = [each if math.isnan(each.value) else each._replace(missing="") for each in found]
    return numbers._replace(quantities=tuple(present))


def _quantities(
    simulation: Simulation, creature: Creature, recording: Recording, numbers: GaitNumbers
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
    middle = np.average(place, axis=1, weights=weights)[numbers.first :]
    along = stride.path_speed(middle, step, frequency)
    gravity = float(simulation.world.gravity)
    energy = float(numbers.power.sum() * step)
    # The energy of the last control step moves the animal beyond the last recorded position.
    spent = float(numbers.power[:-1].sum() * step)
    no_stride = "" if frequency > 0 else _NO_STRIDE
    moving = _if_anywhere(along, step * (len(middle) - 1), length)
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
    found += _of_the_ground(simulation, numbers, moving)
    found += _of_the_wave(simulation, creature, recording, numbers, middle, no_stride)
    found += [
        Quantity("power", "mean power", energy / duration, "W",
                 "power of all motors, |torque x rate| summed over the joints"),
        Quantity("peak_power", "peak power", float(numbers.power.max(initial=0.0)), "W",
                 "largest power, as a mean of a control step"),
        Quantity("energy", "energy", energy, "J", "mean power x duration"),
        Quantity("cost_of_transport", "cost of transport",
                 stride.cost_of_transport(spent, mass, gravity, distance), "",
                 "energy / (weight x displacement) (Tucker 1975)",
                 "it has no displacement or no weight"),
        Quantity("peak_torque", "peak torque", float(numbers.peak_torque.max(initial=0.0)), "N m",
                 "largest torque of any motor, as a mean of a control step"),
    ]  # fmt: skip
    return found


def _if_anywhere(speed: float, time: float, length: float) -> float:
    """Return a speed (m/s), or NaN if the path in a time (s) is too short for a length (m)."""
    return speed if speed * time >= _NOWHERE * length else math.nan


def _of_the_ground(simulation: Simulation, numbers: GaitNumbers, moving: float) -> list[Quantity]:
    feet = numbers.feet
    if feet is None:
        return []
    airborne, swims = feet.airborne, ""
    if simulation.world.water_level == math.inf:
        airborne, swims = math.nan, "there is water everywhere, which supports it"
    limbs = feet.duty_factor if len(feet.names) else np.array([math.nan])
    never = "" if len(feet.names) else "nothing but the root ever touches the ground"
    slip, stays = math.nan, np.isfinite(feet.slip)
    brief = never or "nothing but the root stays on the ground for three control steps"
    if stays.any():
        # Weigh every foot by its time on the ground.
        slip = float(np.average(feet.slip[stays], weights=feet.duty_factor[stays]))
        brief = ""
    return [
        Quantity("duty_factor", "duty factor", float(limbs.mean()), "",
                 "fraction of the time on the ground, mean of the bodies that ever touch it, "
                 "except the root (Alexander and Jayes 1983)", never),
        Quantity("airborne", "airborne fraction", airborne, "",
                 "fraction of the control steps in which nothing touches the ground", swims),
        Quantity("slip", "slip", slip, "m/s",
                 "horizontal speed of each foot's lowest point, in all control steps of a contact "
                 "except its first and last. Mean of all feet, weighted by time on the ground",
                 brief),
        Quantity("relative_slip", "relative slip", slip / moving, "", "slip / path speed",
                 brief or _STAYS),
    ]  # fmt: skip


def _of_the_wave(
    simulation: Simulation,
    creature: Creature,
    recording: Recording,
    numbers: GaitNumbers,
    middle: Float[np.ndarray, "n 3"],
    no_stride: str,
) -> list[Quantity]:
    wave = numbers.wave
    if wave is None:
        return []
    stands = no_stride or "no wave travels along the body"
    found = [
        Quantity("wave_count", "waves on the body", wave.count, "",
                 "body length / wave length, positive from head to tail", stands),
        Quantity("wave_speed", "wave speed", wave.speed, "m/s",
                 "wave length x stride frequency (Gray 1933)", stands),
        Quantity("lag", "lag per joint", wave.lag, "deg",
                 "mean phase lag of neighbours along the body", stands),
        Quantity("travelling_index", "travelling index", wave.travelling, "",
                 "0 for a standing wave, 1 for whole travelling waves (Feeny 2008)", stands),
    ]  # fmt: skip
    if simulation.world.water is not None:
        midline = midline_chain(creature)
        swaying = None
        if midline is not None:
            point = midline_points(midline, recording)[numbers.first :]
            swaying = sway(point, numbers.step, numbers.frequency)
        swing = math.nan if swaying is None else float(swaying.cycles.peak_to_peak[-1])
        swum = middle - _drift(simulation.world.water, middle, numbers.step)
        through = stride.path_speed(swum, numbers.step, numbers.frequency)
        moving = _if_anywhere(through, numbers.step * (len(swum) - 1), float(length_of(creature)))
        dry = "" if _in_water(simulation, creature, recording, numbers) else _DRY
        if dry:
            through = moving = math.nan
        found += [
            Quantity("wave_slip", "speed / wave speed", through / abs(wave.speed), "",
                     "path speed through the water / wave speed, the slip U/V of Lighthill 1960",
                     dry or stands),
            Quantity("tail_excursion", "excursion of the tail", swing, "m",
                     "displacement of its tip from side to side in a stride", no_stride),
            Quantity("strouhal", "Strouhal number",
                     strouhal_number(numbers.frequency, swing, moving), "",
                     "stride frequency x excursion of the tail / path speed through the water "
                     "(Triantafyllou et al. 1993)", dry or no_stride or _STAYS),
        ]  # fmt: skip
    return found


def _feet(
    simulation: Simulation,
    creature: Creature,
    frames: Mapping[str, Array | np.ndarray],
    recording: Recording,
    first: int,
    frequency: float,
) -> Feet | None:
    contact_model, tree = simulation.world.contact_model, simulation.world.tree
    if contact_model is None:
        return None
    step = 1.0 / simulation.control_rate
    force = np.asarray(frames["contact_force"])[..., 0]
    owners = np.array(contact_model.bodies, int)
    names = [body.name for body in creature.bodies]
    limbs = sorted({int(i) for i in owners if i > 0}, key=lambda i: names.index(tree.names[i]))
    touched = footfalls.touching(force, owners, limbs) if limbs else np.zeros((len(force), 0), bool)
    ever = np.flatnonzero(touched.any(0))
    limbs, touched = [limbs[i] for i in ever], touched[:, ever]
    places = [names.index(tree.names[limb]) for limb in limbs]
    rotation = np.asarray(recording.rotation, float)[:, places]
    lowest = np.zeros((*touched.shape, 3))
    for k, place in enumerate(places):
        shape = creature.bodies[place].shape
        # Compute the lowest point only in contact: support takes one direction at a time.
        for t in np.flatnonzero(touched[:, k]):
            lowest[t, k] = shape.support(-rotation[t, k, 2])
    steady = footfalls.settled(touched, step, footfalls.chatter(frequency))
    position = np.asarray(recording.position, float)[:, places]
    return Feet(
        names=tuple(tree.names[limb] for limb in limbs),
        touched=touched,
        steady=steady,
        duty_factor=footfalls.duty_factors(touched),
        phases=footfalls.phases(steady[first:], step),
        slip=footfalls.slip_speeds(position, rotation, lowest, touched, step),
        airborne=footfalls.airborne_fraction((force != 0).any(1)),
    )


def _chain(rows: Sequence[tuple[int, ...]], recording: Recording) -> tuple[int, ...]:
    """Return the longest row of three or more degrees of freedom along the body.

    Among equally long rows, return the row that bends most. Rows of twist (about x) count only if
    all rows are twist.
    """
    swing = np.asarray(recording.joint_angle).std(0)
    found = [row for row in rows if len(row) > 2]
    across = [row for row in found if not recording.dof_names[row[0]].endswith(".x")]
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
        joint = creature.bodies[place].joint
        assert joint is not None
        joints.append(centres[place] + turns[place] @ np.array(joint.child_anchor, float))
    apart = np.linalg.norm(np.diff(joints, axis=0), axis=-1)
    return np.concatenate([[0.0], np.cumsum(apart)])


def _drift(water: Water, middle: Float[np.ndarray, "t 3"], step: float) -> Float[np.ndarray, "t 3"]:
    """Return the displacement by the water's flow since the first sample, m.

    Args:
        water: water with its flow.
        middle: centre of mass of the animal, m.
        step: time between samples, s.
    """
    flow = water.velocity(jnp.asarray(middle.T))
    carried = np.broadcast_to(np.asarray(flow, float), middle.T.shape).T * step
    return np.concatenate([np.zeros((1, 3)), np.cumsum(carried, 0)[:-1]])


def _in_water(
    simulation: Simulation, creature: Creature, recording: Recording, numbers: GaitNumbers
) -> bool:
    """Return whether the chain's bodies reach into the water in at least half of the samples."""
    level, tree = simulation.world.water_level, simulation.world.tree
    if math.isinf(level):
        return level > 0
    dofs = numbers.chain
    places = sorted({creature.body_index(tree.names[tree.dof_bodies[dof]]) for dof in dofs})
    # Rows of upward unit vectors, in the bodies' own axes.
    up = np.asarray(recording.rotation, float)[numbers.first :, places, 2]
    centre = np.asarray(recording.position, float)[numbers.first :, places, 2]
    shapes = [creature.bodies[place].shape for place in places]
    deepest = [[u @ shape.support(-u) for u, shape in zip(row, shapes, strict=True)] for row in up]
    return bool((centre + np.array(deepest) < level).mean() >= 0.5)
