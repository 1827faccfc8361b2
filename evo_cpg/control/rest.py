"""Which oscillators come to rest under any drive, found by letting them run, in NumPy and SciPy.

`evo_cpg.analysis.limit_cycle` says much more, but has to compile first; this takes a second at
most, so that it can be asked before every run.
"""

from typing import Any

import numpy as np

from evo_cpg.control.matsuoka import MatsuokaNetwork

# How long the network settles, and is looked at then, in units of the slower time constant.
_SETTLING, _SEEN = 60.0, 10.0

# An output that swings by less than this share of the drive is at rest, as in
# `evo_cpg.analysis.limit_cycle`; the integration has to be better than that.
_LEAST_SWING, _RELATIVE, _ABSOLUTE = 1e-3, 1e-4, 1e-5


def resting(
    network: MatsuokaNetwork, tonic_input: float, min_gain: float, max_gain: float
) -> list[int]:
    """Oscillators whose output does not swing, with the smallest, middle and largest gain.

    Args:
        network: connections and time constants.
        tonic_input: u of every neuron; outputs are proportional to it where s is 0.
        min_gain: smallest b.
        max_gain: largest b.
    """
    from scipy.integrate import solve_ivp

    count, drive = network.oscillator_count, tonic_input + float(network.sensory_feedback)
    if drive <= 0:
        return list(range(count))
    gains = np.linspace(min_gain, max_gain, 3)
    other, own = np.maximum(network.matrix, 0.0), np.maximum(-network.matrix, 0.0)
    rise_time, adaptation_time = float(network.rise_time), float(network.adaptation_time)

    def change(time: float, numbers: np.ndarray) -> np.ndarray:
        """Eqs. 4-6 of Iwadate 2010, of a network for each gain."""
        del time
        potential, adaptation = numbers.reshape(2, 2, count, len(gains))
        firing = np.maximum(potential, 0.0)
        inhibition = other @ firing[::-1] + own @ firing
        rise = (drive - potential - inhibition - gains * adaptation) / rise_time
        return np.stack([rise, (firing - adaptation) / adaptation_time]).ravel()

    start = np.zeros((2, 2, count, len(gains)))
    start[0] = np.asarray(network.initial_potential)[..., None]
    slow, quick = max(rise_time, adaptation_time), min(rise_time, adaptation_time)
    end = (_SETTLING + _SEEN) * slow
    seen = np.arange(_SETTLING * slow, end, quick / 2)
    errors: dict[str, Any] = {"rtol": _RELATIVE, "atol": _ABSOLUTE * drive}
    found = solve_ivp(change, (0.0, end), start.ravel(), t_eval=seen, **errors)
    extensor, flexor = np.maximum(found.y.reshape(2, 2, count, len(gains), -1)[0], 0.0)
    swing = np.ptp(extensor - flexor, axis=-1).max(-1)
    return [int(i) for i in np.flatnonzero(swing < _LEAST_SWING * drive)]
