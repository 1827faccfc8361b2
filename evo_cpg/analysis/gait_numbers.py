"""All that can be told in numbers of how an animal moved in one trial.

Speed, power, cost of transport, duty factor and airborne share are those of the whole trial, as in
`evo_cpg.simulation.measures`. What is about strides, lags and waves is taken from the second half
of the trial, when the animal is under way. Where a number does not exist it is said why.
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
from evo_cpg.analysis.phase_lags import PhaseLags, phase_lags
from evo_cpg.creature.creature import Creature, length_of, neutral_pose
from evo_cpg.physics.water import Water
from evo_cpg.simulation.recording import Recording
from evo_cpg.simulation.simulation import Simulation

# Share of the trial, at its end, in which strides are looked for.
LAST = 0.5

# Who gets on by less in the second half, in body lengths, gets nowhere.
_NOWHERE = 0.01
# A body whose joints swing by less makes no wave, rad.
_FAINT = math.radians(1.0)

_DRY = "it is out of the water for more than half of the time"
_STAYS = "it gets nowhere"
_NO_STRIDE = "the joints do not repeat themselves twice in the second half of the trial"


class Quantity(NamedTuple):
    """A number with its name, as a table has it.

    Attributes:
        key: short name, of letters and underscores.
        name: in words.
        value: NaN where it does not exist.
        unit: empty where it has none.
        definition: what it is, and whose formula.
        missing: why it does not exist.
    """

    key: str
    name: str
    value: float
    unit: str
    definition: str
    missing: str = ""


class Feet(NamedTuple):
    """What touches the ground.

    Attributes:
        names: of the bodies that ever touch it, in the order of the creature.
        touched: whether each touches in each control step.
        steady: the same without chatter.
        duty_factor: of each.
        phases: of their touch-downs in the second half of the trial.
        slip: speed of each over the ground while it touches, m/s; NaN of one that never stays.
        airborne: share of the control steps in which nothing touches, the root included.
    """

    names: tuple[str, ...]
    touched: Bool[np.ndarray, "t f"]
    steady: Bool[np.ndarray, "t f"]
    duty_factor: Float[np.ndarray, " f"]
    phases: Phases
    slip: Float[np.ndarray, " f"]
    airborne: float


class GaitNumbers(NamedTuple):
    """How an animal moved.

    Attributes:
        quantities: the numbers.
        step: between samples, s.
        first: sample with which the part begins that strides are taken from.
        frequency: strides a second; NaN where nothing is repeated.
        axis_signs: of each degree of freedom, -1 where its axis points against that of the first
            of its row of oscillators: lags and wave are those of the angles with these signs.
        lags: between the joints, in the order of the recording's degrees of freedom.
        chain: degrees of freedom along the body; none where fewer than three are in a row.
        wave: along them; None where there is no chain, or it swings by less than a degree.
        feet: what touches the ground; None where there is none.
        power: of all motors, without regard to its sign, in each control step, W.
        peak_torque: of each motor, N m.
        rms_torque: root of the mean square of each, N m.
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
        """Of a quantity; NaN where it does not exist."""
        return next((each.value for each in self.quantities if each.key == key), math.nan)


def gait_numbers(
    simulation: Simulation,
    creature: Creature,
    frames: Mapping[str, Array | np.ndarray],
    recording: Recording,
) -> GaitNumbers:
    """Measure a motion.

    Args:
        simulation: the trial.
        creature: the animal.
        frames: of one individual, see `evo_cpg.simulation.rollout.record`.
        recording: the same in the order of the creature.
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
    # What is spent after the last sample takes it to where it is not seen any more.
    spent = float(numbers.power[:-1].sum() * step)
    no_stride = "" if frequency > 0 else _NO_STRIDE
    moving = _if_anywhere(along, step * (len(middle) - 1), length)
    stride_length = stride.stride_length(moving, frequency)
    found = [
        Quantity("duration", "duration", duration, "s", "of the trial"),
        Quantity("length", "body length", length, "m", "largest extent with all joints at zero"),
        Quantity("mass", "mass", mass, "kg", "of all bodies"),
        Quantity(
            "speed", "speed", speed, "m/s",
            "of the root's centre in a straight line from start to end"
            + (", over the ground" if on_ground else ""),
        ),
        Quantity("speed_in_lengths", "relative speed", speed / length, "lengths/s",
                 "speed by body length"),
        Quantity("path_speed", "path speed", along, "m/s",
                 "of the centre of mass along its way in the second half, smoothed over a stride"),
        Quantity("stride_frequency", "stride frequency", frequency, "Hz",
                 "inverse of the shortest time after which all joints are as they were: "
                 "autocorrelation (Moe-Nilssen and Helbostad 2004)", no_stride),
        Quantity("stride_length", "stride length", stride_length, "m",
                 "path speed by stride frequency (Alexander 2003)", no_stride or _STAYS),
        Quantity("relative_stride", "relative stride length", stride_length / length, "lengths",
                 "stride length by body length", no_stride or _STAYS),
    ]  # fmt: skip
    found += _of_the_ground(simulation, numbers, moving)
    found += _of_the_wave(simulation, creature, recording, numbers, middle, no_stride)
    found += [
        Quantity("power", "mean power", energy / duration, "W",
                 "of all motors, |torque x rate| summed over the joints"),
        Quantity("peak_power", "peak power", float(numbers.power.max(initial=0.0)), "W",
                 "the largest mean of a control step"),
        Quantity("energy", "energy", energy, "J", "mean power x duration"),
        Quantity("cost_of_transport", "cost of transport",
                 stride.cost_of_transport(spent, mass, gravity, distance), "",
                 "energy by weight and distance in a straight line (Tucker 1975)",
                 "it gets nowhere, or weighs nothing"),
        Quantity("peak_torque", "peak torque", float(numbers.peak_torque.max(initial=0.0)), "N m",
                 "of any motor, mean of a control step"),
    ]  # fmt: skip
    return found


def _if_anywhere(speed: float, time: float, length: float) -> float:
    """A speed (m/s) that has got an animal of a length (m) anywhere in a time (s), or NaN."""
    return speed if speed * time >= _NOWHERE * length else math.nan


def _of_the_ground(simulation: Simulation, numbers: GaitNumbers, moving: float) -> list[Quantity]:
    feet = numbers.feet
    if feet is None:
        return []
    airborne, swims = feet.airborne, ""
    if simulation.world.water_level == math.inf:
        airborne, swims = math.nan, "there is water everywhere, which holds it"
    limbs = feet.duty_factor if len(feet.names) else np.array([math.nan])
    never = "" if len(feet.names) else "nothing but the root ever touches the ground"
    slip, stays = math.nan, np.isfinite(feet.slip)
    brief = never or "nothing but the root stays on the ground for three control steps"
    if stays.any():
        # Every foot counts by the time that it is on the ground.
        slip = float(np.average(feet.slip[stays], weights=feet.duty_factor[stays]))
        brief = ""
    return [
        Quantity("duty_factor", "duty factor", float(limbs.mean()), "",
                 "share of the time on the ground (Alexander and Jayes 1983), mean of the bodies "
                 "that ever touch it but for the root", never),
        Quantity("airborne", "airborne share", airborne, "",
                 "share of the control steps in which nothing touches the ground", swims),
        Quantity("slip", "slip", slip, "m/s",
                 "horizontal speed of each foot's lowest point in control steps in which it "
                 "touches, and in those beside them, mean of all",
                 brief),
        Quantity("relative_slip", "relative slip", slip / moving, "", "slip by path speed",
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
    stands = no_stride or "no wave runs along the body"
    found = [
        Quantity("wave_count", "waves on the body", wave.count, "",
                 "body length by wave length; positive from head to tail", stands),
        Quantity("wave_speed", "wave speed", wave.speed, "m/s",
                 "along the body: wave length x stride frequency (Gray 1933)", stands),
        Quantity("lag", "lag per joint", wave.lag, "deg",
                 "mean phase lag of neighbours along the body", stands),
        Quantity("travelling_index", "travelling index", wave.travelling, "",
                 "0 for a wave that stands, 1 for whole waves that run (Feeny 2008)", stands),
    ]  # fmt: skip
    if simulation.world.water is not None:
        point = _tail_tip(simulation, creature, recording, numbers.chain)[numbers.first :]
        swing = stride.excursion(point, middle, numbers.step, numbers.frequency)
        swum = middle - _drift(simulation.world.water, middle, numbers.step)
        through = stride.path_speed(swum, numbers.step, numbers.frequency)
        moving = _if_anywhere(through, numbers.step * (len(swum) - 1), float(length_of(creature)))
        dry = "" if _in_water(simulation, creature, recording, numbers) else _DRY
        if dry:
            through = moving = math.nan
        found += [
            Quantity("wave_slip", "speed by wave speed", through / abs(wave.speed), "",
                     "path speed through the water by wave speed, the slip U/V of Lighthill 1960",
                     dry or stands),
            Quantity("tail_excursion", "excursion of the tail", swing, "m",
                     "of its tip, from side to side in a stride", no_stride),
            Quantity("strouhal", "Strouhal number",
                     stride.strouhal_number(numbers.frequency, swing, moving), "",
                     "stride frequency x excursion of the tail by path speed through the water "
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
        # Only where it counts: it is asked for one by one.
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
    """Three or more degrees of freedom in a row along the body, as many as there are.

    Of rows that are as long that which bends most; not twist, which is about x, unless all is.
    """
    swing = np.asarray(recording.joint_angle).std(0)
    found = [row for row in rows if len(row) > 2]
    across = [row for row in found if not recording.dof_names[row[0]].endswith(".x")]
    return max(across or found, key=lambda row: (len(row), swing[list(row)].sum()), default=())


def chain_places(
    simulation: Simulation, creature: Creature, chain: tuple[int, ...]
) -> Float[np.ndarray, " j"]:
    """Where joints are along the body, m behind the first.

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
    """How far the water has carried the animal since the first sample, m.

    Args:
        water: where it swims.
        middle: of the animal, m.
        step: between samples, s.
    """
    flow = water.velocity(jnp.asarray(middle.T))
    carried = np.broadcast_to(np.asarray(flow, float), middle.T.shape).T * step
    return np.concatenate([np.zeros((1, 3)), np.cumsum(carried, 0)[:-1]])


def _in_water(
    simulation: Simulation, creature: Creature, recording: Recording, numbers: GaitNumbers
) -> bool:
    """Whether the chain's bodies reach into the water for half of the second half or more."""
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


def _tail_tip(
    simulation: Simulation, creature: Creature, recording: Recording, chain: tuple[int, ...]
) -> Float[np.ndarray, "t 3"]:
    """Where the chain's last body ends, straight away from its joint, m."""
    tree = simulation.world.tree
    place = creature.body_index(tree.names[tree.dof_bodies[chain[-1]]])
    joint = creature.bodies[place].joint
    assert joint is not None
    away = -np.array(joint.child_anchor, float)
    far = float(np.linalg.norm(away))
    if far > 0:
        away /= far
        far = float(away @ np.asarray(creature.bodies[place].shape.support(away), float))
    end = far * away
    return recording.position[:, place] + recording.rotation[:, place] @ end
