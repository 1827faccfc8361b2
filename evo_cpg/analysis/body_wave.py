"""Wave along a body, of its bending or of its displacement: number, speed and travelling index.

    phi(s) = phi_0 - k s,    wave length = 2 pi / k,    waves on the body = L k / (2 pi)
    speed along the body = wave length x frequency               (Gray 1933; Lighthill 1960)

with the phase phi of the signal at the place s along the body, whose length is L. A wave with
positive k runs from head to tail. The number and the speed of waves have the sign of k. A standing
wave has no speed: its phases jump by half a cycle at its nodes.

The travelling index measures whether the wave travels. It is the reciprocal condition number of
(Re w, Im w) with the first mode w of the complex orthogonal decomposition (Feeny 2008): 0 for a
standing wave, 1 for whole travelling waves.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from evo_cpg.analysis.cycles import whole_cycles
from evo_cpg.analysis.gait import fourier_component

# Travelling index below which a wave stands. A pure wave reaches it with 0.05 waves on the body.
STANDING = 0.1

# Amplitude, absolute and relative to the largest, below which a place does not move.
_STILL, _RELATIVELY_STILL = 1e-9, 1e-6

_NOT_A_NUMBER = float("nan")


class BodyWave(NamedTuple):
    """Wave along a body.

    Numbers are NaN if fewer than three places move, or with less than a period of samples. The
    number, length, speed and lag of a standing wave (`STANDING`) are NaN.

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
    signals: Float[np.ndarray, "t j"],
    place: Float[np.ndarray, " j"],
    length: float,
    step: float,
    frequency: float,
) -> BodyWave:
    """Return the wave in samples along a body.

    Args:
        signals: bending (joint angles about one axis, rad) or sideways displacement (m) at each
            place.
        place: places along the body from the head, ascending, m.
        length: length of the body, m.
        step: time between samples, s.
        frequency: frequency of the wave, Hz.
    """
    number = signals.shape[1]
    nothing = np.full(number, np.nan)
    nan = _NOT_A_NUMBER
    none = BodyWave(nan, nan, nan, nan, nan, nan, nothing, np.zeros(number))
    if number < 3 or not frequency > 0 or len(signals) * step < 1.0 / frequency:
        return none
    component = fourier_component(signals, step, frequency)
    amplitude = np.abs(component)
    moves = amplitude > max(_STILL, _RELATIVELY_STILL * amplitude.max())
    if moves.sum() < 3:
        return none._replace(amplitude=amplitude)
    if not moves.all():
        found = body_wave(signals[:, moves], place[moves], length, step, frequency)
        phase = nothing
        phase[moves] = found.phase
        return found._replace(phase=phase, amplitude=amplitude)
    lag = np.angle(component[:-1] / component[1:])
    behind = np.concatenate([[0.0], np.cumsum(lag)])
    wave_number, start = np.polyfit(place, behind, 1, w=amplitude)
    left = np.square(amplitude * (behind - start - wave_number * place)).sum()
    middle = np.average(behind, weights=np.square(amplitude))
    all_of_it = np.square(amplitude * (behind - middle)).sum()
    travelling = travelling_index(signals, step, frequency)
    travels = travelling >= STANDING and abs(wave_number) > 1e-9
    wave = 2 * np.pi / wave_number if travels else nan
    return BodyWave(
        count=float(length / wave),
        length=float(abs(wave)),
        speed=float(wave * frequency),
        lag=float(np.degrees(lag.mean())) if travels else nan,
        travelling=travelling,
        straightness=float(1 - left / all_of_it) if all_of_it > 1e-12 else nan,
        phase=np.degrees(behind),
        amplitude=amplitude,
    )


def travelling_index(signals: Float[np.ndarray, "t j"], step: float, frequency: float) -> float:
    """Return the travelling index by complex orthogonal decomposition (Feeny 2008).

    The analytic signals z of all places (Hilbert transform in time) have the correlations
    ``R = z z^H / n``. The index is the smaller over the larger singular value of (Re w, Im w),
    with the first eigenvector w of R. It is (1 - b) / (1 + b) for a wave of amplitude 1 and its
    reflection of amplitude b, on whole wave lengths. A pure wave with the wave number k on a
    length L has sqrt((1 - s) / (1 + s)) with s = |sin(k L) / (k L)|, which is below 1.

    Returns:
        Index from 0 to 1, or NaN without a cycle of samples or without motion.
    """
    cycles = whole_cycles(signals, step, frequency)
    if cycles is None:
        return _NOT_A_NUMBER
    centred = cycles.values - cycles.values.mean(0)
    spectrum = np.fft.fft(centred, axis=0)
    count = len(centred)
    # The analytic signal has positive frequencies only.
    keep = np.zeros(count)
    keep[1 : (count + 1) // 2] = 2.0
    analytic = np.fft.ifft(spectrum * keep[:, None], axis=0)
    power, modes = np.linalg.eigh(analytic.T @ analytic.conj() / count)
    if not power[-1] > _STILL**2:
        return _NOT_A_NUMBER
    first = modes[:, -1]
    singular = np.linalg.svd(np.stack([np.real(first), np.imag(first)], -1), compute_uv=False)
    return float(singular[1] / singular[0])
