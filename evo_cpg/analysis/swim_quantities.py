"""Numbers of an animal whose body waves, each with its definition."""

import math
from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.analysis import stride
from evo_cpg.analysis.allometry import reynolds_of_swimmers
from evo_cpg.analysis.animals import Animals
from evo_cpg.analysis.body_wave import STANDING
from evo_cpg.analysis.cycles import whole_cycles
from evo_cpg.analysis.midline import MidlineMotion
from evo_cpg.analysis.quantity import Quantity
from evo_cpg.analysis.swimming import (
    froude_efficiency,
    reynolds_number,
    slip,
    strouhal_number,
    swimming_number,
)
from evo_cpg.analysis.water_power import water_power
from evo_cpg.creature.creature import Creature
from evo_cpg.creature.slender import SlenderChain
from evo_cpg.physics.water.viscous_drag import ViscousDrag
from evo_cpg.physics.water.water import Water
from evo_cpg.simulation.recording import Recording
from evo_cpg.simulation.simulation import Simulation

_DRY = "it is out of the water for more than half of the time"
_STANDS = f"its wave stands: the travelling index is below {STANDING:g}"
_FEW = "the second half of the trial has fewer than two strides, or the body is coiled"
_DRAG_PUSHES = (
    "without reactive thrust, drag both pushes and resists, so thrust cannot be told apart"
)


def wave_quantities(motion: MidlineMotion | None, no_stride: str) -> list[Quantity]:
    """Return the numbers of the wave along the midline.

    Args:
        motion: motion of the midline, or None with less than two strides.
        no_stride: reason why there is no stride, or an empty text.
    """
    nan = math.nan
    count = speed = travelling = lag = tail = relative = fitted = nan
    if motion is not None:
        wave = motion.wave
        count, speed, travelling = wave.count, wave.speed, wave.travelling
        lag, tail = motion.lag.mean, motion.tail_amplitude
        relative = tail / motion.length
        fitted = motion.envelope.fitted
    missing = no_stride or (_FEW if motion is None else _STANDS)
    return [
        Quantity("wave_count", "waves on the body", count, "",
                 "length of the midline / wave length of its sway, positive from head to tail",
                 missing),
        Quantity("wave_speed", "wave speed", speed, "m/s",
                 "speed V of the wave of sway along the forward axis (Gray 1933)", missing),
        Quantity("travelling_index", "travelling index", travelling, "",
                 "0 for a standing wave, 1 for whole travelling waves, of the sway (Feeny 2008)",
                 missing),
        Quantity("bending_lag", "lag on bending", lag, "cycles",
                 "fraction of a cycle by which sway follows bending, mean of the body "
                 "(Gillis 1998)", missing),
        Quantity("tail_excursion", "excursion of the tail", tail, "m",
                 "sway of its tip from side to side in a stride", missing),
        Quantity("tail_amplitude", "relative excursion of the tail", relative, "lengths",
                 "excursion of the tail / length of the midline", missing),
        Quantity("envelope_fit", "quadratic envelope", fitted, "",
                 "fraction of the variance of the amplitude along the body that a quadratic "
                 "explains (Videler 1993)", missing),
    ]  # fmt: skip


def water_quantities(
    simulation: Simulation,
    frames: Mapping[str, Array | np.ndarray],
    motion: MidlineMotion | None,
    middle: Float[np.ndarray, "n 3"],
    frequency: float,
    length: float,
    dry: bool,
    no_stride: str,
    no_speed: str,
) -> list[Quantity]:
    """Return the numbers of swimming.

    Args:
        simulation: the trial, in water.
        frames: frames of one individual.
        motion: motion of the midline, or None with less than two strides.
        middle: path of the centre of mass in the last part of the trial, m.
        frequency: stride frequency, Hz, or NaN.
        length: body length, m.
        dry: whether the midline is mostly out of the water.
        no_stride: reason why there is no stride, or an empty text.
        no_speed: reason why a speed does not exist.
    """
    water, step = simulation.world.water, 1.0 / simulation.control_rate
    assert water is not None
    swum = middle - drift(water, middle, step)
    through = stride.path_speed(swum, step, frequency)
    if dry or motion is None:
        through = math.nan
    moving = stride.if_anywhere(through, step * (len(swum) - 1), length)
    tail = math.nan if motion is None else motion.tail_amplitude
    wave_speed = math.nan if motion is None else motion.wave.speed
    missing = (_DRY if dry else "") or no_stride or (_FEW if motion is None else "")
    found = [
        Quantity("wave_slip", "speed / wave speed", float(slip(through, wave_speed)), "",
                 "path speed through the water / wave speed, the slip U/V of Lighthill 1960",
                 missing or _STANDS),
        Quantity("strouhal", "Strouhal number",
                 float(strouhal_number(frequency, tail, moving)), "",
                 "stride frequency x excursion of the tail, from side to side / path speed "
                 "through the water (Triantafyllou et al. 1993)", missing or no_speed),
    ]  # fmt: skip
    law = simulation.world.law(ViscousDrag)
    if law is not None:
        nu = float(law.viscosity) / float(water.density)
        sw = float(swimming_number(frequency, tail, length, nu))
        others = float(reynolds_of_swimmers(sw))
        alike = Animals("reynolds", others, others, "animals of this swimming number",
                        "Gazzola et al. 2014")  # fmt: skip
        found += [
            Quantity("reynolds", "Reynolds number", float(reynolds_number(moving, length, nu)), "",
                     "path speed through the water x body length / kinematic viscosity",
                     missing or no_speed, (alike,) if math.isfinite(others) else ()),
            Quantity("swimming_number", "swimming number", sw, "",
                     "2 pi x stride frequency x excursion of the tail, from side to side x body "
                     "length / kinematic viscosity (Gazzola et al. 2014)", missing),
        ]  # fmt: skip
    efficiency = math.nan
    h = step / simulation.substeps
    found_power = None if missing else water_power(simulation.world, frames, h)
    if found_power is not None:
        efficiency = _efficiency(found_power.thrust, found_power.power, swum, step, frequency)
    unknown = missing or (_DRAG_PUSHES if found_power is None else no_speed)
    found.append(
        Quantity("froude_efficiency", "Froude efficiency", efficiency, "",
                 "reactive thrust along the path x speed / power into the water (Lighthill 1960)",
                 unknown)
    )  # fmt: skip
    return found


def _efficiency(
    thrust: Float[np.ndarray, "t 3"],
    power: Float[np.ndarray, " t"],
    swum: Float[np.ndarray, "n 3"],
    step: float,
    frequency: float,
) -> float:
    """Return T U / P over the last whole strides, or NaN without one."""
    course = np.gradient(swum, step, axis=0)
    last = len(swum)
    columns = np.concatenate([thrust[-last:], course, power[-last:, None]], axis=1)
    cycles = whole_cycles(columns, step, frequency)
    if cycles is None:
        return math.nan
    mean = cycles.values.mean(0)
    return float(froude_efficiency(float(mean[:3] @ mean[3:6]), 1.0, float(mean[6])))


def drift(water: Water, middle: Float[np.ndarray, "t 3"], step: float) -> Float[np.ndarray, "t 3"]:
    """Return the displacement by the water's flow since the first sample, m.

    Args:
        water: water with its flow.
        middle: centre of mass of the animal, m.
        step: time between samples, s.
    """
    flow = water.velocity(jnp.asarray(middle.T))
    carried = np.broadcast_to(np.asarray(flow, float), middle.T.shape).T * step
    return np.concatenate([np.zeros((1, 3)), np.cumsum(carried, 0)[:-1]])


def is_dry(
    simulation: Simulation,
    creature: Creature,
    recording: Recording,
    chain: SlenderChain,
    first: int,
) -> bool:
    """Return whether the chain's bodies are out of the water in over half of the samples.

    Args:
        simulation: the trial.
        creature: the animal.
        recording: its motion, with the bodies in its order.
        chain: bodies of the midline.
        first: first sample that counts.
    """
    level = simulation.world.water_level
    if math.isinf(level):
        return level < 0
    places = list(chain.bodies)
    # Rows of upward unit vectors, in the bodies' own axes.
    up = np.asarray(recording.rotation, float)[first:, places, 2]
    centre = np.asarray(recording.position, float)[first:, places, 2]
    shapes = [creature.bodies[place].shape for place in places]
    deepest = [[u @ shape.support(-u) for u, shape in zip(row, shapes, strict=True)] for row in up]
    return bool((centre + np.array(deepest) < level).mean() < 0.5)
