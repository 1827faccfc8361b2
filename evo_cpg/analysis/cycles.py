"""Cycles of a periodic motion: their starts, frequency and phases, and samples of whole cycles.

A Fourier component, a peak-to-peak range or a mean is exact only over whole cycles. So signals are
interpolated by a cubic spline to a whole number of samples in a cycle. Signals have any unit, times
between samples (steps) are in s, and frequencies in Hz.

A cycle begins where the signal crosses a level upwards. Phases are cyclic, so their mean and their
scatter are circular (Fisher 1993). With the mean m of exp(2 pi i p_k) over the phases p_k:

    mean = arg(m) / (2 pi),    scatter = sqrt(-2 ln |m|) / (2 pi)
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float
from scipy.interpolate import CubicSpline

# Least number of samples in a cycle, after interpolation.
_FINE = 32


class Cycles(NamedTuple):
    """Samples of whole cycles.

    Attributes:
        values: samples, from the last whole cycles of the record.
        step: time between samples, s.
        width: number of samples in a cycle.
    """

    values: Float[np.ndarray, "t *n"]
    step: float
    width: int

    @property
    def component(self) -> Complex[np.ndarray, " *n"]:
        """Complex amplitude at the frequency of the cycles, for the factor exp(+i w t)."""
        turn = np.exp(-2j * np.pi * np.arange(len(self.values)) / self.width)
        return 2.0 * np.tensordot(turn, self.values, 1) / len(self.values)

    @property
    def peak_to_peak(self) -> Float[np.ndarray, " *n"]:
        """Median over the cycles of the peak-to-peak ranges."""
        apart = self.values.reshape(-1, self.width, *self.values.shape[1:])
        return np.median(np.ptp(apart, axis=1), axis=0)


def finer(
    values: Float[np.ndarray, "t *n"], step: float, frequency: float
) -> tuple[Float[np.ndarray, "m *n"], float]:
    """Interpolate signals to a whole number of samples in a cycle, at least `_FINE`.

    Args:
        values: signals of any unit.
        step: time between samples, s.
        frequency: frequency of the cycles, Hz, or NaN without cycles.

    Returns:
        Signals by a cubic spline, and time between samples, s. Signals shorter than a cycle stay
        unchanged.
    """
    width = 1.0 / (frequency * step) if frequency > 0 else np.nan
    if not width < len(values):
        return values, step
    own = width / max(_FINE, round(width))
    # The margin keeps the last sample in spite of rounding.
    places = np.arange(0, len(values) - 1 + 1e-9, own)
    return CubicSpline(np.arange(len(values)), values)(places), own * step


def whole_cycles(values: Float[np.ndarray, "t *n"], step: float, frequency: float) -> Cycles | None:
    """Return the last whole cycles of signals, or None if there is none."""
    if not frequency > 0 or len(values) < 2:
        return None
    values, step = finer(values, step, frequency)
    width = max(1, round(1.0 / (frequency * step)))
    count = len(values) // width * width
    return Cycles(values[len(values) - count :], step, width) if count else None


def last_cycles(first: int, end: int, step: float, frequency: float) -> slice:
    """Return the last of some samples that hold whole cycles, without interpolation.

    Args:
        first: first sample.
        end: sample after the last one.
        step: time between samples, s.
        frequency: frequency of the cycles, Hz, or NaN without cycles.

    Returns:
        All of the samples if they hold no whole cycle.
    """
    if frequency > 0:
        cycles = math.floor((end - first) * step * frequency + 1e-6)
        if cycles:
            first = end - round(cycles / (frequency * step))
    return slice(first, end)


def moving_mean(
    values: Float[np.ndarray, "t *n"], step: float, frequency: float
) -> Float[np.ndarray, "m *n"]:
    """Return means over a cycle, or a straight line from start to end without cycles."""
    width = max(1, round(1.0 / (frequency * step))) if frequency > 0 else len(values)
    if width >= len(values):
        return np.linspace(values[0], values[-1], len(values))
    total = np.cumsum(values - values[0], axis=0)
    total = np.concatenate([np.zeros_like(total[:1]), total])
    return values[0] + (total[width:] - total[:-width]) / width


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

    Returns:
        Mean from -0.5 to 0.5, and standard deviation.
    """
    mean = np.exp(2j * np.pi * phase).mean()
    scatter = math.sqrt(max(0.0, -2 * math.log(max(abs(mean), _SCATTERED)))) / (2 * math.pi)
    return float(np.angle(mean) / (2 * np.pi)), scatter
