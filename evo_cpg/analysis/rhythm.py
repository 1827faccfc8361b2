"""Rhythm of a signal: beginnings of its cycles, their frequency, and the mean of phases.

A cycle begins where the signal crosses a level upwards. Phases are cyclic, so their mean and their
scatter are circular (Fisher 1993). With the mean m of exp(2 pi i p_k) over the phases p_k:

    mean = arg(m) / (2 pi),    scatter = sqrt(-2 ln |m|) / (2 pi)
"""

import math

import numpy as np
from jaxtyping import Float

# Smallest peak-to-peak range of a signal with a rhythm.
_STILL = 1e-6
# Smallest |m|, which keeps the scatter finite.
_SCATTERED = 1e-12


def upward_crossings(signal: Float[np.ndarray, " t"]) -> Float[np.ndarray, " k"]:
    """Return where a signal crosses 0 upwards, in samples, linearly interpolated."""
    before = np.flatnonzero((signal[:-1] < 0) & (signal[1:] >= 0))
    return before + signal[before] / (signal[before] - signal[before + 1])


def cycle_starts(signal: Float[np.ndarray, " t"], step: float) -> Float[np.ndarray, " k"]:
    """Return the times at which a signal crosses its mid-range upwards, s.

    Args:
        signal: samples of any unit.
        step: time between samples, s.

    Returns:
        Times after the first sample. There are none if the signal stands still.
    """
    low, high = signal.min(), signal.max()
    if not high - low > _STILL:
        return np.zeros(0)
    return upward_crossings(signal - 0.5 * (high + low)) * step


def frequency_of(starts: Float[np.ndarray, " k"]) -> float:
    """Return the frequency of cycles from their starts (s), Hz, or NaN with fewer than three."""
    if len(starts) < 3:
        return math.nan
    return float((len(starts) - 1) / (starts[-1] - starts[0]))


def mean_phase(phase: Float[np.ndarray, " k"]) -> tuple[float, float]:
    """Return the circular mean of phases and their circular standard deviation, cycles.

    Args:
        phase: phases, cycles.

    Returns:
        Mean from -0.5 to 0.5, and standard deviation.
    """
    mean = np.exp(2j * np.pi * phase).mean()
    scatter = math.sqrt(max(0.0, -2 * math.log(max(abs(mean), _SCATTERED)))) / (2 * math.pi)
    return float(np.angle(mean) / (2 * np.pi)), scatter
