"""Phase lags between signals at one frequency, and their coherence.

    S_ij = mean over segments of X_i conj(X_j)          cross-spectrum (Welch 1967)
    lag_ij = arg S_ij                                   lag of j behind i
    C_ij = |S_ij|^2 / (S_ii S_jj)                       coherence (Bendat and Piersol 2010)

with the component X of each signal at the frequency, in a Hann window. Segments span a few periods
and overlap by half.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from evo_cpg.analysis.gait import fourier_component

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
    """Measure phase lags and coherence.

    Args:
        signals: signals of any unit.
        step: time between samples, s.
        frequency: stride frequency, Hz.

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
