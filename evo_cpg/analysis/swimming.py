"""Numbers of a swimmer, from the paths of points on its midline.

| word | meaning | source |
|---|---|---|
| U | speed through the water along the path | |
| A | tail amplitude: sway of the tail's tip from side to side (peak to peak) | |
| Strouhal number | f A / U | Triantafyllou et al. 1993 |
| V | speed of the wave of displacement along the body | Gray 1933 |
| slip | U / V | Lighthill 1960 |
| Froude efficiency | T U / P | Lighthill 1960 |
| Reynolds number | U L / nu | |
| swimming number | w A L / nu, with w = 2 pi f. So Sw / Re = 2 pi St | Gazzola et al. 2014 |

A is from side to side everywhere, also in the swimming number. Papers say "amplitude" for this
length or for half of it.

`swimming` returns all of them for many settings at once, from arrays alone. The formulas take
numbers or arrays.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from evo_cpg.analysis import stride
from evo_cpg.analysis.midline import midline_motion
from evo_cpg.analysis.ratio import Values, ratio


class Swimming(NamedTuple):
    """Numbers of swimmers. Arrays have one trailing axis for each axis of settings.

    A value that does not exist is NaN: all without two cycles, those of the wave if it stands,
    those with U in an animal that does not move, and Re and Sw without viscosity.

    Attributes:
        frequency: frequency of the tail's beat, Hz.
        speed: U, m/s.
        tail_amplitude: A, from side to side, m.
        strouhal: Strouhal number.
        wave_speed: V, m/s, positive from head to tail.
        wave_count: number of waves on the body, positive from head to tail.
        slip: U / V.
        travelling: travelling index of the displacement.
        lag: mean lag of the sway on the bending, fraction of a cycle.
        reynolds: Reynolds number.
        swimming_number: swimming number.
        amplitude: half of the peak-to-peak sway of each point / body length.
        lags: lag of the sway on the bending at each point, fraction of a cycle.
        quadratic: coefficients c0, c1, c2 of the amplitude's quadratic fit.
    """

    frequency: Float[np.ndarray, " *n"]
    speed: Float[np.ndarray, " *n"]
    tail_amplitude: Float[np.ndarray, " *n"]
    strouhal: Float[np.ndarray, " *n"]
    wave_speed: Float[np.ndarray, " *n"]
    wave_count: Float[np.ndarray, " *n"]
    slip: Float[np.ndarray, " *n"]
    travelling: Float[np.ndarray, " *n"]
    lag: Float[np.ndarray, " *n"]
    reynolds: Float[np.ndarray, " *n"]
    swimming_number: Float[np.ndarray, " *n"]
    amplitude: Float[np.ndarray, "p *n"]
    lags: Float[np.ndarray, "p *n"]
    quadratic: Float[np.ndarray, "3 *n"]


def swimming(
    points: Float[np.ndarray, "t p 3 *n"],
    step: float,
    frequency: Values | None = None,
    *,
    speed: Values | None = None,
    length: Values | None = None,
    viscosity: Values | None = None,
) -> Swimming:
    """Return the numbers of one or many swimmers.

    Leave out the initial motion: pass only samples of the steady part.

    Args:
        points: paths of points on the midline in the world, from the head's tip to the tail's tip,
            m. Trailing axes are settings.
        step: time between samples, s.
        frequency: frequency of the beat, Hz, or None to measure it from the bending.
        speed: speed through the water, m/s, or None for the speed of the midline's mean along its
            path. Pass it if the water flows, or if the animal is towed.
        length: body length, m, or None for the mean length of the midline.
        viscosity: kinematic viscosity of the water, m^2/s, or None without viscosity.
    """
    points = np.asarray(points, float)
    shape = points.shape[3:]
    count = int(np.prod(shape))
    flat = points.reshape(*points.shape[:3], count)
    given = [
        [None] * count
        if value is None
        else np.broadcast_to(np.asarray(value, float), shape).ravel().tolist()
        for value in (frequency, speed, length, viscosity)
    ]
    found = [_alone(flat[..., k], step, *(values[k] for values in given)) for k in range(count)]
    columns = [np.stack([np.asarray(one[i]) for one in found], -1) for i in range(len(found[0]))]
    return Swimming(*(column.reshape((*column.shape[:-1], *shape)) for column in columns))


def strouhal_number(frequency: Values, amplitude: Values, speed: Values) -> Values:
    """Return St = f A / U, no unit (Triantafyllou, Triantafyllou and Grosenbaugh 1993).

    Args:
        frequency: f, frequency of the tail's beat, Hz.
        amplitude: A, sway of the tail's tip from side to side, m.
        speed: U, m/s. The result is NaN for 0.
    """
    return ratio(np.multiply(frequency, amplitude), speed)


def slip(speed: Values, wave_speed: Values) -> Values:
    """Return U / V, no unit (Lighthill 1960). NaN without a wave speed.

    Args:
        speed: U, m/s.
        wave_speed: V, m/s. Only its magnitude counts.
    """
    return ratio(speed, np.abs(wave_speed))


def reynolds_number(speed: Values, length: Values, viscosity: Values) -> Values:
    """Return Re = U L / nu, no unit. NaN without viscosity.

    Args:
        speed: U, m/s.
        length: L, m.
        viscosity: kinematic viscosity nu, m^2/s.
    """
    return ratio(np.multiply(speed, length), viscosity)


def swimming_number(
    frequency: Values, amplitude: Values, length: Values, viscosity: Values
) -> Values:
    """Return Sw = 2 pi f A L / nu, no unit (Gazzola, Argentina and Mahadevan 2014).

    Args:
        frequency: f, frequency of the tail's beat, Hz.
        amplitude: A, sway of the tail's tip from side to side, m.
        length: L, m.
        viscosity: kinematic viscosity nu, m^2/s. The result is NaN for 0.
    """
    return ratio(2 * np.pi * np.multiply(frequency, amplitude) * length, viscosity)


def froude_efficiency(thrust: Values, speed: Values, power: Values) -> Values:
    """Return the Froude efficiency T U / P, no unit (Lighthill 1960).

    The net force on a free swimmer is zero, so T is not the net force. Take T from the law that
    pushes (reactive thrust), or hold the animal in a tow and take the net force.

    Args:
        thrust: T, mean thrust, N.
        speed: U, speed through the water, m/s.
        power: P, mean power of the body into the water, W. The result is NaN unless P is positive.
    """
    return ratio(np.multiply(thrust, speed), power)


def _alone(
    points: Float[np.ndarray, "t p 3"],
    step: float,
    frequency: float | None,
    speed: float | None,
    length: float | None,
    viscosity: float | None,
) -> Swimming:
    """Return the numbers of one swimmer, as scalars and arrays of points."""
    if frequency is None:
        segments = np.diff(points, axis=1)
        turns = np.cross(segments[:, :-1], segments[:, 1:]).reshape(len(points), -1)
        frequency = stride.stride_frequency(turns, step)
    if speed is None:
        speed = stride.path_speed(points.mean(1), step, frequency)
    nan, nothing = np.nan, np.full(points.shape[1], np.nan)
    motion = midline_motion(points, step, frequency, length)
    amplitude, lags, quadratic = nothing, nothing, np.full(3, nan)
    tail = wave_speed = wave_count = travelling = lag = nan
    if motion is not None:
        tail, length = motion.tail_amplitude, motion.length
        wave_speed, wave_count = motion.wave.speed, motion.wave.count
        travelling = motion.wave.travelling
        lags, lag = motion.lag
        amplitude, quadratic = motion.envelope.amplitude, motion.envelope.quadratic
    nu = nan if viscosity is None else viscosity
    length = nan if length is None else length
    return Swimming(
        frequency=np.asarray(frequency),
        speed=np.asarray(speed),
        tail_amplitude=np.asarray(tail),
        strouhal=np.asarray(strouhal_number(frequency, tail, speed)),
        wave_speed=np.asarray(wave_speed),
        wave_count=np.asarray(wave_count),
        slip=np.asarray(slip(speed, wave_speed)),
        travelling=np.asarray(travelling),
        lag=np.asarray(lag),
        reynolds=np.asarray(reynolds_number(speed, length, nu)),
        swimming_number=np.asarray(swimming_number(frequency, tail, length, nu)),
        amplitude=amplitude,
        lags=lags,
        quadratic=quadratic,
    )
