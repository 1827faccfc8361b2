"""The stride: the shortest time after which a motion repeats, and its length.

| word | meaning | source |
|---|---|---|
| stride frequency | strides per second | Moe-Nilssen and Helbostad 2004 (autocorrelation) |
| path speed | speed along the path, smoothed over a stride | |
| stride length | path speed / stride frequency | Alexander 2003 |
| cost of transport | energy / (weight x distance) | Tucker 1975 |
"""

import math

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from evo_cpg.analysis.cycles import finer, moving_mean

# Autocorrelation below which a motion does not repeat. White noise of 600 samples reaches 0.2.
_ALIKE = 0.3
# Relative height of peaks that count as equally high. The first of them is one stride, the others
# are several.
_AS_HIGH = 0.9
# Peaks of the autocorrelation whose lags differ by less than this factor belong to one stride.
_SAME = 1.2
# Lags of the autocorrelation per sample. Peaks of fast strides lie between samples.
_BETWEEN = 8
# Least number of strides in a record.
_STRIDES = 2.0
# Length of the path, in body lengths, below which an animal counts as standing.
STANDING_FRACTION = 0.01
# Largest distance (m) that counts as 0. `evo_cpg.simulation.measures` has the same value.
_NOWHERE = 1e-6


def stride_frequency(signals: Float[np.ndarray, "t j"], step: float) -> float:
    """Return the stride frequency from the autocorrelation of all joints together.

    The stride is the shortest time after which all joints repeat: the lag m at the first peak of

        r(m) = sum_j cov_m(x_j, x_j) / sqrt(sum_j var_m(x_j) sum_j var'_m(x_j))

    that is at least 0.9 times as high as the highest one. The sums cover the overlapping parts of
    the record (unbiased autocorrelation, Moe-Nilssen and Helbostad 2004). Peaks may lie between
    samples. A joint that swings twice in a stride shifts the peak of a spectrum, but not this peak.

    Args:
        signals: signals such as the joint angles, any unit.
        step: time between samples, s.

    Returns:
        Frequency, Hz, up to a third of the sampling rate. NaN if nothing repeats, or if the record
        is shorter than two strides.
    """
    count = len(signals)
    level = signals - signals.mean(0)
    if count < 8 or not signals.shape[1] or not np.square(level).sum() > 1e-12 * count:
        return math.nan
    most = int(count / _STRIDES)
    lags = np.arange(_BETWEEN * most + 1) / _BETWEEN
    alike = CubicSpline(np.arange(most + 1), _autocorrelation(level, most))(lags)
    inner = alike[1:-1]
    peak = 1 + np.flatnonzero((inner >= alike[:-2]) & (inner > alike[2:]))
    # Skip the initial peak of slow signals, before the autocorrelation first falls.
    below = np.flatnonzero(alike < 0.5 * (1 + alike.min()))
    peak = peak[peak > below[0]] if len(below) else peak[:0]
    if not len(peak) or alike[peak].max() < _ALIKE:
        return math.nan
    first = int(peak[alike[peak] >= _AS_HIGH * alike[peak].max()][0])
    # Noise splits the peak of a slow stride into several.
    same = peak[(peak >= first) & (peak <= _SAME * first)]
    first = int(same[alike[same].argmax()])
    left, middle, right = alike[first - 1 : first + 2]
    bend = left - 2 * middle + right
    shift = 0.5 * (left - right) / bend if bend < 0 else 0.0
    return float(_BETWEEN / (step * (first + shift)))


def path_speed(path: Float[np.ndarray, "t 3"], step: float, frequency: float) -> float:
    """Return the speed along the path, m/s, smoothed over a stride to remove swaying.

    Args:
        path: path of the animal's middle, m.
        step: time between samples, s.
        frequency: stride frequency, Hz, or NaN for the straight line from start to end.
    """
    path, step = finer(path, step, frequency)
    smooth = moving_mean(path, step, frequency)
    if len(smooth) < 2:
        return math.nan
    return float(np.linalg.norm(np.diff(smooth, axis=0), axis=-1).sum() / (step * len(smooth[1:])))


def if_anywhere(speed: float, time: float, length: float) -> float:
    """Return a speed (m/s), or NaN if the path is shorter than 1 % of the body.

    Args:
        speed: speed along the path, m/s.
        time: duration of the path, s.
        length: body length, m.
    """
    return speed if speed * time >= STANDING_FRACTION * length else math.nan


def stride_length(speed: float, frequency: float) -> float:
    """Return the stride length, m: speed / frequency (Alexander 2003).

    Args:
        speed: speed, m/s.
        frequency: stride frequency, Hz, or NaN without a stride.
    """
    return speed / frequency if frequency > 0 else math.nan


def cost_of_transport(energy: float, mass: float, gravity: float, distance: float) -> float:
    """Return the cost of transport E / (m g d), no unit (Tucker 1975).

    Args:
        energy: E, energy of the motors, J.
        mass: m, kg.
        gravity: g, m/s^2.
        distance: d, m.

    Returns:
        Cost of transport, or NaN without distance or weight.
    """
    work = mass * gravity * distance
    return energy / work if distance > _NOWHERE and work > 0 else math.nan


def _autocorrelation(level: Float[np.ndarray, "t j"], most: int) -> Float[np.ndarray, " lags"]:
    """Return the autocorrelation of all signals, for lags from 0 to ``most`` samples."""
    count = len(level)
    spectrum = np.fft.rfft(level, 2 * count, axis=0)
    product = np.fft.irfft(np.square(np.abs(spectrum)).sum(1), 2 * count)[: most + 1]
    power = np.concatenate([[0.0], np.cumsum(np.square(level).sum(1))])
    lags = np.arange(most + 1)
    before, after = power[count - lags], power[count] - power[lags]
    scale = np.sqrt(before * after)
    return product / np.where(scale > 0, scale, 1.0)
