"""Bending wave along a body: number of waves, speed and travelling index.

    phi(s) = phi_0 - k s,    wave length = 2 pi / k,    waves on the body = L k / (2 pi)
    speed along the body = wave length x frequency               (Gray 1933; Lighthill 1960)

with the phase phi of the bending at the place s along the body, whose length is L. A wave with
positive k runs from head to tail. The number and the speed of waves have the sign of k.

The travelling index of Feeny 2008 measures whether the wave travels. It is the reciprocal condition
number of (Re w, Im w) with the complex amplitudes w of all places: 0 for a standing wave, 1 for
whole travelling waves.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from evo_cpg.analysis.gait import fourier_component

_NOT_A_NUMBER = float("nan")


class BodyWave(NamedTuple):
    """Bending wave.

    Numbers are NaN if a place does not bend, with fewer than three places, or with less than a
    period of samples.

    Attributes:
        count: number of waves on the body, positive for a wave from head to tail.
        length: wave length, m, never negative.
        speed: wave speed along the body, m/s, positive from head to tail.
        lag: mean phase lag of neighbours, degrees, positive from head to tail.
        travelling: travelling index, from 0 (standing) to 1 (travelling).
        straightness: fraction of the phases' variance explained by a constant lag per length.
        phase: phase lag of each place behind the first, degrees, without jumps.
        amplitude: amplitude at each place, unit of the signals.
    """

    count: float
    length: float
    speed: float
    lag: float
    travelling: float
    straightness: float
    phase: Float[np.ndarray, " j"]
    amplitude: Float[np.ndarray, " j"]


def body_wave(
    bending: Float[np.ndarray, "t j"],
    place: Float[np.ndarray, " j"],
    length: float,
    step: float,
    frequency: float,
) -> BodyWave:
    """Return the wave in samples of the bending along a body.

    Args:
        bending: bending at each place, such as joint angles about one axis, rad.
        place: places along the body from the head, ascending, m.
        length: length of the body, m.
        step: time between samples, s.
        frequency: frequency of the wave, Hz.
    """
    number = bending.shape[1]
    nothing = np.full(number, np.nan)
    nan = _NOT_A_NUMBER
    none = BodyWave(nan, nan, nan, nan, nan, nan, nothing, np.zeros(number))
    if number < 3 or not frequency > 0 or len(bending) * step < 1.0 / frequency:
        return none
    component = fourier_component(bending, step, frequency)
    amplitude = np.abs(component)
    if not amplitude.min() > 1e-9:
        return none._replace(amplitude=amplitude)
    lag = np.angle(component[:-1] / component[1:])
    behind = np.concatenate([[0.0], np.cumsum(lag)])
    wave_number, start = np.polyfit(place, behind, 1, w=amplitude)
    left = np.square(amplitude * (behind - start - wave_number * place)).sum()
    middle = np.average(behind, weights=np.square(amplitude))
    all_of_it = np.square(amplitude * (behind - middle)).sum()
    singular = np.linalg.svd(
        np.stack([np.real(component), np.imag(component)], -1), compute_uv=False
    )
    wave = 2 * np.pi / wave_number if abs(wave_number) > 1e-9 else _NOT_A_NUMBER
    return BodyWave(
        count=float(length * wave_number / (2 * np.pi)),
        length=float(abs(wave)),
        speed=float(wave * frequency),
        lag=float(np.degrees(lag.mean())),
        travelling=float(singular[1] / singular[0]),
        straightness=float(1 - left / all_of_it) if all_of_it > 1e-12 else _NOT_A_NUMBER,
        phase=np.degrees(behind),
        amplitude=amplitude,
    )
