"""The stride, and the dimensionless numbers of walkers and swimmers.

| word | meaning | source |
|---|---|---|
| stride | the shortest time after which a motion repeats | |
| stride frequency | strides per second | Moe-Nilssen and Helbostad 2004 (autocorrelation) |
| path speed | speed along the path, smoothed over a stride | |
| stride length | path speed / stride frequency | Alexander 2003 |
| cost of transport | energy / (weight x distance) | Tucker 1975 |
| Froude number | v^2 / (g h), with the hip height h | Alexander and Jayes 1983 |
| recovery | energy saved by exchange in the centre of mass / energy | Cavagna et al. 1977 |
| tripod strength | time of joint swing / time of any swing in a tripod | Wosnitza et al. 2013 |
| relative slip | slip of the feet / speed of the animal | |
| U | speed through the water along the path | |
| A | tail amplitude: sway of the tail's tip from side to side (peak to peak) | |
| Strouhal number | f A / U | Triantafyllou et al. 1993 |
| V | speed of the wave of displacement along the body | Gray 1933 |
| slip | U / V | Lighthill 1960 |
| Froude efficiency | T U / P | Lighthill 1960 |
| Reynolds number | U L / nu | |
| swimming number | w A L / nu, with w = 2 pi f. So Sw / Re = 2 pi St | Gazzola et al. 2014 |

A is from side to side everywhere, also in the swimming number. Papers say "amplitude" for this
length or for half of it. The formulas take numbers or arrays.
"""

import math

import numpy as np
from jaxtyping import Bool, Float
from scipy.interpolate import CubicSpline

from evo_cpg.analysis.cycles import finer, moving_mean

# A number, or an array of numbers.
Values = float | Float[np.ndarray, " *n"]

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

    Returns:
        Frequency, Hz, up to a third of the sampling rate. NaN if nothing repeats, or if the record
        is shorter than two strides.
    """
    count = len(signals)
    level = signals - signals.mean(0)
    if count < 8 or not signals.shape[1] or not np.square(level).sum() > 1e-12 * count:
        return math.nan
    most = int(count / _STRIDES)
    spectrum = np.fft.rfft(level, 2 * count, axis=0)
    product = np.fft.irfft(np.square(np.abs(spectrum)).sum(1), 2 * count)[: most + 1]
    power = np.concatenate([[0.0], np.cumsum(np.square(level).sum(1))])
    lags = np.arange(most + 1)
    scale = np.sqrt(power[count - lags] * (power[count] - power[lags]))
    autocorrelation = product / np.where(scale > 0, scale, 1.0)
    alike = CubicSpline(lags, autocorrelation)(np.arange(_BETWEEN * most + 1) / _BETWEEN)
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


def stride_length(speed: float, frequency: float) -> float:
    """Return the stride length, m: speed / frequency (Alexander 2003). NaN without a stride."""
    return speed / frequency if frequency > 0 else math.nan


def cost_of_transport(energy: float, mass: float, gravity: float, distance: float) -> float:
    """Return E / (m g d), no unit (Tucker 1975), with the energy E of the motors.

    Returns:
        Cost of transport, or NaN without distance or weight.
    """
    work = mass * gravity * distance
    return energy / work if distance > _NOWHERE and work > 0 else math.nan


# Legs of a tripod, of which an insect has two.
TRIPOD = 3


def froude_number(speed: Values, gravity: Values, hip_height: Values) -> Values:
    """Return Fr = v^2 / (g h), no unit (Alexander and Jayes 1983).

    Animals walk below about 0.5 and run above. Some papers write v / sqrt(g h), which is the root.

    Args:
        speed: v, m/s.
        gravity: g, m/s^2.
        hip_height: h, mean height of the hips above the ground, m.

    Returns:
        Froude number, NaN without gravity or with hips on the ground.
    """
    return ratio(np.square(speed), np.multiply(gravity, hip_height))


def recovery(
    forward: Float[np.ndarray, "t *n"], vertical: Float[np.ndarray, "t *n"]
) -> Float[np.ndarray, " *n"]:
    """Return the recovery R = 1 - W / (W_f + W_v) (Cavagna, Heglund and Taylor 1977).

    Each W is the sum of the positive steps of an energy of the centre of mass: W_f of ``forward``,
    W_v of ``vertical``, W of their sum. Two equal sinusoids that are shifted by d have
    R = 1 - |cos(d / 2)|: 1 for 180 degrees (a pendulum), 0 for 0 (a bounce).

    Args:
        forward: kinetic energy of the forward motion, J, in whole strides.
        vertical: potential energy plus kinetic energy of the vertical motion, J.

    Returns:
        Recovery from 0 to 1, NaN if neither energy changes.
    """
    total, *apart = (
        np.maximum(np.diff(energy, axis=0), 0.0).sum(0)
        for energy in (forward + vertical, forward, vertical)
    )
    spent = apart[0] + apart[1]
    return np.where(spent > 0, 1.0 - total / np.where(spent > 0, spent, 1.0), np.nan)


def tripod_strength(touched: Bool[np.ndarray, "t 6 *n"]) -> Float[np.ndarray, " *n"]:
    """Return the tripod strength, mean of both tripods: 1 if their legs swing together.

    A tripod is L1, R2, L3 or R1, L2, R3. Its strength is the time in which all three legs swing,
    over the time in which any of them swings. Swings of the length s that follow each other by d
    have (s - 2 d) / (s + 2 d).

    Args:
        touched: whether each leg touches the ground in each sample. The order is L1, L2, L3, R1,
            R2, R3, from front to back.

    Returns:
        Strength from 0 to 1, NaN if a tripod never swings.
    """
    swings = ~touched
    each = []
    for legs in ([0, 4, 2], [3, 1, 5]):
        together = swings[:, legs].all(1).sum(0)
        any_of_them = swings[:, legs].any(1).sum(0)
        each.append(np.where(any_of_them > 0, together / np.maximum(any_of_them, 1), np.nan))
    return np.mean(each, axis=0)


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
    """Return Re = U L / nu with the kinematic viscosity nu, no unit. NaN without viscosity."""
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


def ratio(above: Values, below: Values) -> Values:
    """Return the ratio of two quantities, NaN unless the lower one is positive."""
    below = np.asarray(below, float)
    exists = below > 0
    found = np.where(exists, above, np.nan) / np.where(exists, below, 1.0)
    return found if found.ndim else float(found)
