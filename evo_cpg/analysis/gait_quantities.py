"""Table of the numbers that describe a motion: key, name, value, unit, definition.

Every group returns rows of a `Quantity`. A row that does not exist has the value NaN, and says why.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.analysis import stride
from evo_cpg.analysis.animals import (
    Animals,
    animals_of,
    reynolds_of_swimmers,
    running_cost,
    swimming_cost,
)
from evo_cpg.analysis.body_wave import STANDING, BodyWave
from evo_cpg.analysis.cycles import whole_cycles
from evo_cpg.analysis.energy import water_power
from evo_cpg.analysis.feet import Feet, limb_contacts
from evo_cpg.analysis.midline import MidlineMotion
from evo_cpg.creature.creature import Creature
from evo_cpg.creature.slender import SlenderChain
from evo_cpg.physics.water.viscous_drag import ViscousDrag
from evo_cpg.physics.water.water import Water
from evo_cpg.simulation.recording import Recording
from evo_cpg.simulation.simulation import Simulation

_STAYS = "its path in the second half of the trial is shorter than 1 % of its length"
_NO_STRIDE = "the joint angles do not repeat twice in the second half of the trial"
_DRY = "it is out of the water for more than half of the time"
_STANDS = f"its wave stands: the travelling index is below {STANDING:g}"
_FEW = "the second half of the trial has fewer than two strides, or the body is coiled"


class Quantity(NamedTuple):
    """A measured number with its definition, and the ranges of animals beside it.

    Attributes:
        key: short name of letters and underscores.
        name: name in words.
        value: value, or NaN if it does not exist.
        unit: unit, empty for a pure number.
        definition: definition, and the source of the formula.
        missing: reason why the value does not exist, empty if it does.
        animals: ranges of animals, empty if there are none.
    """

    key: str
    name: str
    value: float
    unit: str
    definition: str
    missing: str = ""
    animals: tuple[Animals, ...] = ()

    @property
    def exists(self) -> bool:
        """Whether there is a value."""
        return math.isfinite(self.value)


class Measurement(NamedTuple):
    """What the numbers are computed from.

    Attributes:
        simulation: the trial.
        creature: the animal.
        frames: frames of one individual.
        recording: its motion, with the bodies in its order.
        first: first sample of the part in which strides are measured.
        step: time between samples, s.
        length: body length, m.
        frequency: stride frequency, Hz, or NaN if nothing repeats.
        wave: wave of bending, or None.
        row: bodies of the midline, or None.
        midline: motion of the midline, or None with less than two strides.
        feet: contacts with the ground, or None without ground.
        power: power of all motors in each control step, W.
        peak_torque: largest torque of each motor, N m.
    """

    simulation: Simulation
    creature: Creature
    frames: Mapping[str, Array | np.ndarray]
    recording: Recording
    first: int
    step: float
    length: float
    frequency: float
    wave: BodyWave | None
    row: SlenderChain | None
    midline: MidlineMotion | None
    feet: Feet | None
    power: Float[np.ndarray, " t"]
    peak_torque: Float[np.ndarray, " d"]

    @property
    def no_stride(self) -> str:
        """Reason why there is no stride, or an empty text."""
        return "" if self.frequency > 0 else _NO_STRIDE

    def if_it_moves(self, path: Float[np.ndarray, "n 3"]) -> tuple[float, float]:
        """Return the speed along a path, m/s, and again, or NaN if the animal stays."""
        speed = stride.path_speed(path, self.step, self.frequency)
        moved = speed * self.step * (len(path) - 1) >= stride.STANDING_FRACTION * self.length
        return speed, speed if moved else math.nan


def quantities(motion: Measurement) -> tuple[Quantity, ...]:
    """Return all numbers of a motion, with the ranges of animals."""
    world = motion.simulation.world
    # Path of the centre of mass in the last part of the trial, m.
    tree, recording = world.tree, motion.recording
    order = [tree.names.index(body.name) for body in motion.creature.bodies]
    masses = np.asarray(recording.position, float)
    if tree.centre_of_volume is not None:
        # The place of a body is the centre of its shape.
        off = np.asarray(tree.com - tree.centre, float)[:, order]
        masses = masses + np.einsum("tbij,jb->tbi", np.asarray(recording.rotation, float), off)
    weights = np.asarray(tree.mass, float)[order]
    middle = np.average(masses, axis=1, weights=weights)[motion.first :]
    _, moving = motion.if_it_moves(middle)
    found, distance, speed = _whole_trial(motion, middle)
    if motion.feet is not None:
        found += _ground(motion, motion.feet, middle, moving)
    swims = False
    if motion.wave is not None:
        found.append(
            Quantity("lag", "lag per joint", motion.wave.lag, "deg",
                     "mean phase lag of the bending of neighbours along the body",
                     motion.no_stride or "its bending is a standing wave")
        )  # fmt: skip
    if motion.row is not None:
        found += _midline(motion)
        # Out of the water are midlines that are above it in over half of the samples.
        level, dry = world.water_level, world.water_level < 0
        if not math.isinf(level):
            places = list(motion.row.bodies)
            # Rows of upward unit vectors, in the bodies' own axes.
            upwards = np.asarray(recording.rotation, float)[motion.first :, places, 2]
            centre = np.asarray(recording.position, float)[motion.first :, places, 2]
            shapes = [motion.creature.bodies[place].shape for place in places]
            deepest = [
                [up @ shape.support(-up) for up, shape in zip(row, shapes, strict=True)]
                for row in upwards
            ]
            dry = bool((centre + np.array(deepest) < level).mean() < 0.5)
        swims = not dry
        if world.water is not None:
            found += _water(motion, world.water, middle, dry)
    swims |= world.water_level == math.inf
    found += _effort(motion, distance, speed, swims)
    present = [each._replace(missing="") if each.exists else each for each in found]
    return tuple(q if q.animals else q._replace(animals=animals_of(q.key)) for q in present)


def _whole_trial(
    motion: Measurement, middle: Float[np.ndarray, "n 3"]
) -> tuple[list[Quantity], float, float]:
    """Return the animal's size, speed and stride, its displacement (m) and its speed (m/s)."""
    recording, length, frequency = motion.recording, motion.length, motion.frequency
    duration = len(recording.time) * motion.step
    root = next(i for i, body in enumerate(motion.creature.bodies) if body.joint is None)
    on_ground = motion.simulation.world.contact_model is not None
    place = np.asarray(recording.position, float)[:, root]
    distance = float(np.linalg.norm((place[-1] - place[0])[: 2 if on_ground else 3]))
    speed = distance / (duration - motion.step) if duration > motion.step else math.nan
    along, moving = motion.if_it_moves(middle)
    stride_length = stride.stride_length(moving, frequency)
    missing = motion.no_stride or _STAYS
    found = [
        Quantity("duration", "duration", duration, "s", "duration of the trial"),
        Quantity("length", "body length", length, "m", "largest extent with all joints at zero"),
        Quantity("mass", "mass", float(motion.creature.mass), "kg", "mass of all bodies"),
        Quantity("speed", "speed", speed, "m/s",
                 "displacement of the root's centre from start to end / duration"
                 + (", without height" if on_ground else "")),
        Quantity("speed_in_lengths", "relative speed", speed / length, "lengths/s",
                 "speed / body length"),
        Quantity("path_speed", "path speed", along, "m/s",
                 "speed of the centre of mass along its path in the second half, smoothed over a "
                 "stride"),
        Quantity("stride_frequency", "stride frequency", frequency, "Hz",
                 "inverse of the shortest time after which all joint angles repeat, from their "
                 "autocorrelation (Moe-Nilssen and Helbostad 2004)", motion.no_stride),
        Quantity("stride_length", "stride length", stride_length, "m",
                 "path speed / stride frequency (Alexander 2003)", missing),
        Quantity("relative_stride", "relative stride length", stride_length / length, "lengths",
                 "stride length / body length", missing),
    ]  # fmt: skip
    return found, distance, speed


def _ground(
    motion: Measurement, feet: Feet, middle: Float[np.ndarray, "n 3"], speed: float
) -> list[Quantity]:
    """Return the numbers of contacts, slip and walking, at a path speed (m/s) or NaN."""
    world, frequency = motion.simulation.world, motion.frequency
    airborne, swims = feet.airborne, ""
    if world.water_level == math.inf:
        airborne, swims = math.nan, "there is water everywhere, which supports it"
    bodies = feet.duty_factor if len(feet.names) else np.array([math.nan])
    slip, aloft = feet.whole_slip, "nothing presses on the ground"
    still = _STAYS if math.isnan(speed) else ""
    limbs = limb_contacts(motion.creature, feet, motion.step, frequency)
    duty = math.nan if limbs is None else float(limbs.duty_factor.mean())
    found = [
        Quantity("duty_factor", "duty factor", float(bodies.mean()), "",
                 "fraction of the time on the ground, mean of the bodies that ever touch it, "
                 "except the root (Alexander and Jayes 1983)",
                 "nothing but the root ever touches the ground"),
        Quantity("airborne", "airborne fraction", airborne, "",
                 "fraction of the control steps in which nothing touches the ground", swims),
        Quantity("slip", "slip", slip, "m/s",
                 "horizontal speed of the material at the points of contact, weighted by load, as "
                 "in the task `walk`", aloft),
        Quantity("relative_slip", "relative slip", slip / speed, "", "slip / path speed",
                 aloft if math.isnan(slip) else _STAYS),
        Quantity("limb_duty_factor", "duty factor of the limbs", duty, "",
                 "fraction of the time on the ground of each limb that ever touches it, without "
                 "trunk and tail (Alexander and Jayes 1983)", "no limb ever touches the ground"),
    ]  # fmt: skip
    if limbs is None:
        return found
    ground, recording, heights = world.ground, motion.recording, []
    assert ground is not None
    for limb in limbs.limbs:
        hip = limb.bodies[0]
        joint = motion.creature.bodies[hip].joint
        assert joint is not None
        turned = recording.rotation[motion.first :, hip] @ np.array(joint.child_anchor, float)
        place = np.asarray(recording.position[motion.first :, hip] + turned, float)
        heights.append(float(np.asarray(ground.floor.distance(jnp.asarray(place.T))[0]).mean()))
    gravity, hips = float(world.gravity), float(np.mean(heights))
    froude = float(stride.froude_number(speed, gravity, hips))
    found += [
        Quantity("foot_slip", "foot slip / speed", float(stride.ratio(limbs.slip, speed)),
                 "", "slip of the limbs / path speed", still or "no limb presses on the ground"),
        Quantity("hip_height", "hip height", hips, "m",
                 "mean height of the limbs' first joints above the floor in the second half"),
        Quantity("froude_number", "Froude number", froude, "",
                 "path speed^2 / (gravity x hip height) (Alexander and Jayes 1983)",
                 still or "its hips are not above the floor"),
    ]  # fmt: skip
    if frequency > 0:
        mass = float(motion.creature.mass)
        found.append(
            Quantity("recovery", "energy recovery",
                     _recovery(mass, gravity, middle, motion.step, frequency), "",
                     "energy that the centre of mass saves by exchange: 1 for a pendulum, 0 for a "
                     "bounce (Cavagna et al. 1977)", "the record has no whole stride")
        )  # fmt: skip
    left, right = ([k for k, limb in enumerate(limbs.limbs) if limb.side == s] for s in (1, -1))
    if len(left) == len(right) == stride.TRIPOD:
        tripod = limbs.steady[motion.first :][:, [*left, *right]]
        found.append(
            Quantity("tripod_strength", "tripod strength", float(stride.tripod_strength(tripod)),
                     "", "time in which all three legs of a tripod swing / time in which any of "
                     "them swings (Wosnitza et al. 2013)", "a tripod never swings")
        )  # fmt: skip
    return found


def _recovery(
    mass: float, gravity: float, middle: Float[np.ndarray, "n 3"], step: float, frequency: float
) -> float:
    """Return the energy recovery in whole strides, or NaN without one."""
    course = middle[-1, :2] - middle[0, :2]
    far = float(np.linalg.norm(course))
    if len(middle) < 3 or not far > 0:
        return math.nan
    velocity = np.gradient(middle, step, axis=0)
    ahead = velocity[:, :2] @ (course / far)
    vertical = mass * gravity * middle[:, 2] + 0.5 * mass * velocity[:, 2] ** 2
    cycles = whole_cycles(np.stack([0.5 * mass * ahead**2, vertical], -1), step, frequency)
    return math.nan if cycles is None else float(stride.recovery(*cycles.values.T))


def _midline(motion: Measurement) -> list[Quantity]:
    """Return the numbers of the wave along the midline."""
    found = motion.midline
    count = speed = travelling = lag = tail = relative = fitted = math.nan
    if found is not None:
        count, speed, travelling = found.wave.count, found.wave.speed, found.wave.travelling
        lag, tail, fitted = found.lag.mean, found.tail_amplitude, found.envelope.fitted
        relative = tail / found.length
    missing = motion.no_stride or (_FEW if found is None else _STANDS)
    rows = (
        ("wave_count", "waves on the body", count, "",
         "length of the midline / wave length of its sway, positive from head to tail"),
        ("wave_speed", "wave speed", speed, "m/s",
         "speed V of the wave of sway along the forward axis (Gray 1933)"),
        ("travelling_index", "travelling index", travelling, "",
         "0 for a standing wave, 1 for whole travelling waves, of the sway (Feeny 2008)"),
        ("bending_lag", "lag on bending", lag, "cycles",
         "fraction of a cycle by which sway follows bending, mean of the body (Gillis 1998)"),
        ("tail_excursion", "excursion of the tail", tail, "m",
         "sway of its tip from side to side in a stride"),
        ("tail_amplitude", "relative excursion of the tail", relative, "lengths",
         "excursion of the tail / length of the midline"),
        ("envelope_fit", "quadratic envelope", fitted, "",
         "fraction of the variance of the amplitude along the body that a quadratic explains "
         "(Videler 1993)"),
    )  # fmt: skip
    return [Quantity(*row, missing) for row in rows]


def _water(
    motion: Measurement, water: Water, middle: Float[np.ndarray, "n 3"], dry: bool
) -> list[Quantity]:
    """Return the numbers of swimming."""
    simulation, midline, frequency = motion.simulation, motion.midline, motion.frequency
    world, step = simulation.world, motion.step
    time = motion.recording.time
    swum = middle - drift(water, middle, time[motion.first :])
    through, moving = motion.if_it_moves(swum)
    tail = wave_speed = math.nan
    if midline is not None:
        tail, wave_speed = midline.tail_amplitude, midline.wave.speed
    if dry or midline is None:
        through = moving = math.nan
    missing = (_DRY if dry else "") or motion.no_stride or (_FEW if midline is None else "")
    found = [
        Quantity("wave_slip", "speed / wave speed", float(stride.slip(through, wave_speed)), "",
                 "path speed through the water / wave speed, the slip U/V of Lighthill 1960",
                 missing or _STANDS),
        Quantity("strouhal", "Strouhal number",
                 float(stride.strouhal_number(frequency, tail, moving)), "",
                 "stride frequency x excursion of the tail, from side to side / path speed "
                 "through the water (Triantafyllou et al. 1993)", missing or _STAYS),
    ]  # fmt: skip
    law = world.law(ViscousDrag)
    if law is not None:
        nu = float(law.viscosity) / float(water.density)
        reynolds = float(stride.reynolds_number(moving, motion.length, nu))
        number = float(stride.swimming_number(frequency, tail, motion.length, nu))
        others = float(reynolds_of_swimmers(number))
        alike = Animals("reynolds", others, others, "animals of this swimming number",
                        "Gazzola et al. 2014")  # fmt: skip
        found += [
            Quantity("reynolds", "Reynolds number", reynolds, "",
                     "path speed through the water x body length / kinematic viscosity",
                     missing or _STAYS, (alike,) if math.isfinite(others) else ()),
            Quantity("swimming_number", "swimming number", number, "",
                     "2 pi x stride frequency x excursion of the tail, from side to side x body "
                     "length / kinematic viscosity (Gazzola et al. 2014)", missing),
        ]  # fmt: skip
    h = step / simulation.substeps
    power = None if missing else water_power(world, motion.frames, h, time)
    efficiency = math.nan
    if power is not None:
        course, last = np.gradient(swum, step, axis=0), len(swum)
        columns = [power.thrust[-last:], course, power.power[-last:, None]]
        cycles = whole_cycles(np.concatenate(columns, axis=1), step, frequency)
        if cycles is not None:
            mean = cycles.values.mean(0)
            useful = float(mean[:3] @ mean[3:6])
            efficiency = float(stride.froude_efficiency(useful, 1.0, float(mean[6])))
    unknown = _STAYS if power is not None else (
        "without reactive thrust, drag both pushes and resists, so thrust cannot be told apart"
    )  # fmt: skip
    found.append(
        Quantity("froude_efficiency", "Froude efficiency", efficiency, "",
                 "reactive thrust along the path x speed / power into the water (Lighthill 1960)",
                 missing or unknown)
    )  # fmt: skip
    return found


def drift(
    water: Water, middle: Float[np.ndarray, "t 3"], time: Float[np.ndarray, " t"]
) -> Float[np.ndarray, "t 3"]:
    """Return the displacement by the water's flow since the first of some times (s), m."""
    flow = np.asarray(water.along(jnp.asarray(middle.T), jnp.asarray(time)), float).T
    carried = flow[:-1] * np.diff(time)[:, None]
    return np.concatenate([np.zeros((1, 3)), np.cumsum(carried, 0)])


def _effort(motion: Measurement, distance: float, speed: float, swims: bool) -> list[Quantity]:
    """Return power, energy, cost of transport, torques, and the work of muscles."""
    recording, world, power = motion.recording, motion.simulation.world, motion.power
    mass, muscles = float(motion.creature.mass), world.tree.muscles
    # The energy of the last control step moves the animal beyond the last recorded position.
    spent = float(power[:-1].sum() * motion.step)
    cost = stride.cost_of_transport(spent, mass, float(world.gravity), distance)
    torque = float(motion.peak_torque[~recording.slides].max(initial=0.0))
    known: tuple[Any, ...] = ()
    if swims:
        known = (*swimming_cost(mass), "fish of this mass, metabolic",
                 "formulas for fish and for salmon")  # fmt: skip
    elif speed > 0:
        known = (running_cost(mass), running_cost(mass, speed),
                 "runners of this mass, metabolic, fast and at this speed",
                 "Taylor et al. 1982")  # fmt: skip
    animals: tuple[Animals, ...] = ()
    if known:
        least, most, *words = known
        animals = (Animals("cost_of_transport", float(least), float(most), *words),)
    muscular = ", and metabolic power of muscles (Minetti and Alexander 1997)"
    found = [
        Quantity("power", "mean power", float(power.mean()), "W",
                 "power of all motors, |torque x rate| summed over the joints"
                 + muscular * (muscles is not None)),
        Quantity("peak_power", "peak power", float(power.max(initial=0.0)), "W",
                 "largest power, as a mean of a control step"),
        Quantity("energy", "energy", float(power.sum() * motion.step), "J",
                 "mean power x duration"),
        Quantity("cost_of_transport", "cost of transport", cost, "",
                 "energy / (weight x displacement) (Tucker 1975)",
                 "it has no displacement or no weight", animals),
        Quantity("peak_torque", "peak torque", torque, "N m",
                 "largest torque of any motor, as a mean of a control step"),
    ]  # fmt: skip
    if muscles is None:
        return found
    turn = np.diff(np.asarray(recording.joint_angle, float), axis=0)
    work = (np.asarray(recording.torque, float)[:-1] * turn)[:, np.array(muscles.driven)]
    positive, absolute = np.maximum(work, 0.0), np.abs(work)
    return [
        *found,
        Quantity("muscle_work", "work of muscles", float(work.sum()), "J",
                 "torque x change of the joint's angle, summed over the joints with muscles"),
        Quantity("positive_muscle_work", "positive work of muscles", float(positive.sum()), "J",
                 "the same, of muscles that turn their joints"),
        Quantity("absolute_muscle_work", "absolute work of muscles", float(absolute.sum()), "J",
                 "the same, |torque x change of the angle|, as motors are counted"),
    ]  # fmt: skip
