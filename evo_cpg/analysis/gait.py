"""Frequency, amplitude and phase lag of the joints, to detect a wave along the body.

Iwadate 2010, section 6, reports "a smooth phase lag from the front to the back of the animal".
The functions take the joint angles about one axis, from front to back, in the last part of the
trial. Angles of joints whose axes point the opposite way need a sign of -1. Each joint's frequency
is the peak of its spectrum. Amplitudes and phases belong to the component at the common frequency.

`phase_lags` compares all pairs of signals at one frequency:

    S_ij = mean over segments of X_i conj(X_j)          cross-spectrum (Welch 1967)
    lag_ij = arg S_ij                                   lag of j behind i
    C_ij = |S_ij|^2 / (S_ii S_jj)                       coherence (Bendat and Piersol 2010)

with the component X of each signal at the frequency, in a Hann window. Segments span a few periods
and overlap by half.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from evo_cpg.creature.axis_kinds import body_and_axis
from evo_cpg.simulation.recording import Recording

# The spectrum is interpolated to this fraction of its natural resolution before the peak is
# refined by a parabola.
_PADDING = 8


class JointGait(NamedTuple):
    """The rhythm of the joints about one axis, in the order of the degrees of freedom.

    Attributes:
        axis: name of the axis.
        frequency: frequency of each joint, Hz.
        amplitude: amplitude of each joint at the common frequency, rad.
        lag: lag of each joint behind the one before it, degrees from -180 to 180. Positive lags
            are a wave from head to tail.
    """

    axis: str
    frequency: Float[np.ndarray, " j"]
    amplitude: Float[np.ndarray, " j"]
    lag: Float[np.ndarray, " gaps"]

    def has_wave(self, spread: float = 0.02, lags: tuple[float, float] = (10.0, 70.0)) -> bool:
        """Return whether all joints share a frequency and all lags are within bounds.

        Args:
            spread: allowed relative difference of a frequency from the median.
            lags: smallest and largest lag, degrees.
        """
        middle = np.median(self.frequency)
        together = np.abs(self.frequency - middle).max() <= spread * middle
        return bool(together and (self.lag >= lags[0]).all() and (self.lag <= lags[1]).all())


def bending_axis(recording: Recording) -> str:
    """Return the axis about which the joints bend most, except x.

    A turn about x is twist, because animals lie along x. It counts only if there is no other axis,
    and slides count only if nothing turns.
    """
    axes = [body_and_axis(name)[1] for name in recording.dof_names]
    turning = {axis for axis, slides in zip(axes, recording.slides, strict=True) if not slides}
    across = turning - {"x"} or turning or set(axes)
    swing = recording.joint_angle.std(0)
    totals = {axis: sum(swing[i] for i, a in enumerate(axes) if a == axis) for axis in across}
    return max(sorted(totals), key=lambda axis: totals[axis])


def gait(
    recording: Recording,
    axis: str | None = None,
    last: float = 0.5,
    signs: Float[np.ndarray, " d"] | None = None,
) -> JointGait:
    """Return frequency, amplitude and lag of the joints about one axis.

    Args:
        recording: the motion.
        axis: name of the joint axis, or None for the bending axis.
        last: fraction of the recording, at its end, to use.
        signs: sign of each degree of freedom, -1 if its axis points against the first axis
            (`evo_cpg.analysis.chains.axis_signs`), or None for equal directions.
    """
    axis = axis or bending_axis(recording)
    chosen = [i for i, name in enumerate(recording.dof_names) if body_and_axis(name)[1] == axis]
    start = round(len(recording.time) * (1 - last))
    step = float(recording.time[1] - recording.time[0])
    angles = recording.joint_angle[start:, chosen]
    if signs is not None:
        angles = angles * signs[chosen]
    frequency = dominant_frequency(angles, step)
    component = fourier_component(angles, step, float(np.median(frequency)))
    lag = np.rad2deg(np.angle(component[:-1] / component[1:]))
    return JointGait(axis, frequency, np.abs(component), lag)


def ring_lags(
    recording: Recording, joints: Sequence[str], last: float = 0.5
) -> Float[np.ndarray, " n"]:
    """Return the lag of each joint behind the one before, the first behind the last, degrees.

    Each joint's axis turns with the limb around the ring. A motion that is alike in all limbs, such
    as lifting, therefore has equal signs in all limbs.

    Args:
        recording: the motion.
        joints: names of degrees of freedom, in the order of a ring.
        last: fraction of the recording, at its end, to use.
    """
    start = round(len(recording.time) * (1 - last))
    step = float(recording.time[1] - recording.time[0])
    angles = recording.joint_angle[start:, [recording.dof_names.index(name) for name in joints]]
    frequency = float(np.median(dominant_frequency(angles, step)))
    component = fourier_component(angles, step, frequency)
    return np.rad2deg(np.angle(np.roll(component, 1) / component))


def dominant_frequency(signals: Float[np.ndarray, "t j"], step: float) -> Float[np.ndarray, " j"]:
    """Return the frequency of the highest peak of each signal's spectrum, Hz.

    A component with fewer than two periods in all samples is drift, not rhythm.
    """
    count = len(signals)
    window = np.hanning(count)[:, None]
    spectrum = np.abs(np.fft.rfft(level(signals) * window, _PADDING * count, axis=0))
    # The spectrum of a drift in a Hann window reaches up to two periods in the window.
    spectrum[: 2 * _PADDING] = 0
    peak = np.clip(spectrum.argmax(0), 1, len(spectrum) - 2)
    columns = np.arange(signals.shape[1])
    left, middle, right = (spectrum[peak + k, columns] for k in (-1, 0, 1))
    curvature = left - 2 * middle + right
    shift = np.where(curvature < 0, 0.5 * (left - right) / np.where(curvature < 0, curvature, 1), 0)
    return (peak + shift) / (_PADDING * count * step)


def fourier_component(
    signals: Float[np.ndarray, "t j"], step: float, frequency: float
) -> np.ndarray:
    """Return the complex amplitude of each signal at one frequency (Hz), with a Hann window."""
    count = len(signals)
    window = np.hanning(count)
    turn = np.exp(-2j * np.pi * frequency * step * np.arange(count))
    return 2 * (level(signals) * (window * turn)[:, None]).sum(0) / window.sum()


def level(signals: Float[np.ndarray, "t j"]) -> Float[np.ndarray, "t j"]:
    """Return the signals without their means and linear trends."""
    time = np.linspace(-1.0, 1.0, len(signals))[:, None]
    centred = signals - signals.mean(0)
    return centred - time * (time * centred).sum(0) / (time * time).sum(0)


# Periods in a segment. Short segments are numerous, and give a more accurate coherence.
_PERIODS = 4.0


class PhaseLags(NamedTuple):
    """Phase lags and coherence of signals.

    Attributes:
        lag: lag of signal j behind signal i, degrees from -180 to 180. NaN if one of them does not
            oscillate at this frequency.
        coherence: coherence, from 0 (unrelated) to 1. NaN with a single segment, whose coherence is
            always 1.
    """

    lag: Float[np.ndarray, "j j"]
    coherence: Float[np.ndarray, "j j"]


def phase_lags(signals: Float[np.ndarray, "t j"], step: float, frequency: float) -> PhaseLags:
    """Measure phase lags and coherence at the stride frequency (Hz).

    Returns:
        Lags and coherence, NaN if the record is shorter than a period.
    """
    count, number = signals.shape
    unknown = np.full((number, number), np.nan)
    if not frequency > 0 or count * step < 1.0 / frequency or not number:
        return PhaseLags(unknown, unknown.copy())
    length = min(count, max(8, round(_PERIODS / (frequency * step))))
    starts = range(0, count - length + 1, max(1, length // 2))
    # Phases refer to the start of each segment. Only their differences count.
    parts = np.stack(
        [fourier_component(signals[first : first + length], step, frequency) for first in starts]
    )
    cross = np.einsum("si,sj->ij", parts, parts.conj()) / len(parts)
    power = np.real(np.diag(cross))
    scale = np.outer(power, power)
    # A signal that is silent relative to the loudest has no phase.
    silent = scale <= 1e-18 * power.max(initial=0.0) ** 2
    lag = np.where(silent, np.nan, np.degrees(np.angle(cross)))
    coherence = np.square(np.abs(cross)) / np.where(silent, 1.0, scale)
    several = len(parts) > 1
    return PhaseLags(lag, np.where(silent | (not several), np.nan, coherence))
