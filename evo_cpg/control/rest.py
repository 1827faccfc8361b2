"""Find the oscillators that stop under a constant drive, by running the network.

This takes a second at most, so it can be called before every run. A full analysis is in
`evo_cpg.analysis.limit_cycle`.
"""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from evo_cpg.control.matsuoka import MatsuokaNetwork, parts, sub_network
from evo_cpg.control.piecewise import BudgetError, Flow, Run, returned

# A network runs in stretches of time. Longest total run and first stretch, in units of T_r + T_a,
# and ratio of each stretch to the previous one.
_LONGEST, _STRETCH, _LONGER = 70.0, 10.0, 1.5

# Largest number of starts of firing per neuron and unit of time. A stretch with more ends early.
_ONSETS = 4

# Largest difference between two states of a part that repeats itself, as a fraction of the range of
# its states. The first number holds while the network runs, the second after the longest run.
_NEAR, _NEAR_ENOUGH = 1e-4, 0.02

# Largest swing of the output of an oscillator at rest, as a fraction of its neurons' firing.
_LEAST_SWING = 1e-3

# Parts with more oscillators than this first get an inexact simulation with all adaptation gains at
# once. Oscillators that swing in it are not reported to rest. Below: its tolerances, then its
# settling time and observed time in units of the slower time constant.
_LARGE = 12
_RELATIVE, _ABSOLUTE = 1e-4, 1e-5
_SETTLING, _SEEN = 60.0, 10.0

# Largest number of steps for each part. A part that needs more is not reported to rest.
_BUDGET = 20_000


def resting(
    network: MatsuokaNetwork, tonic_input: float, min_gain: float, max_gain: float
) -> list[int]:
    """Return the oscillators whose output swings with none of three adaptation gains.

    The gains are the smallest, the middle and the largest. Only certain cases count: a part (set of
    coupled oscillators) certainly decays to an equilibrium, or repeats itself while these
    oscillators rest.

    Args:
        network: connections and time constants.
        tonic_input: u of every neuron. Outputs are proportional to it if s is 0.
        min_gain: smallest b.
        max_gain: largest b.
    """
    drive = tonic_input + float(network.constant_input)
    rests = np.ones(network.oscillator_count, bool)
    known: dict[bytes, Bool[np.ndarray, " o"]] = {}
    for chosen in parts(network):
        part = sub_network(network, chosen)
        # The axes of a body often form equal networks.
        same = part.matrix.tobytes() + np.asarray(part.initial_potential).tobytes()
        if same not in known:
            gains = np.linspace(min_gain, max_gain, 3)
            known[same] = np.ones(len(chosen), bool)
            if len(chosen) > _LARGE and drive > 0:
                known[same] = _seems_to_rest(part, drive, gains)
            for gain in gains:
                # Most parts swing with the first gain, and need no further check.
                if known[same].any():
                    known[same] &= _part_rests(part, drive, gain)
        rests[list(chosen)] = known[same]
    return [int(i) for i in np.flatnonzero(rests)]


def _part_rests(part: MatsuokaNetwork, drive: float, gain: float) -> Bool[np.ndarray, " o"]:
    """Return which oscillators of a part certainly rest with one adaptation gain."""
    count = part.oscillator_count
    flow = Flow(part, np.full((2, count), drive), np.full(count, gain))
    if not flow.driven:
        return np.ones(count, bool)
    flow.steps_left = _BUDGET
    state = flow.vector(part.initial_potential, np.zeros((2, count)))
    time, stretch = 0.0, _STRETCH
    try:
        while True:
            run = flow.run(state, stretch, most_onsets=_ONSETS * flow.neurons * stretch)
            state, time, stretch = run.state, time + run.duration, _LONGER * stretch
            if flow.rest(state) is not None:
                return np.ones(count, bool)
            if returned(run.onsets, _NEAR if time < _LONGEST else _NEAR_ENOUGH) is not None:
                return _still(run)
            if time >= _LONGEST:
                return np.zeros(count, bool)
    except BudgetError:
        return np.zeros(count, bool)


def _seems_to_rest(
    part: MatsuokaNetwork, drive: float, gains: Float[np.ndarray, " g"]
) -> Bool[np.ndarray, " o"]:
    """Return which oscillators of a part barely swing with any of the adaptation gains."""
    from scipy.integrate import solve_ivp

    count = part.oscillator_count
    other, own = np.maximum(part.matrix, 0.0), np.maximum(-part.matrix, 0.0)
    rise_time, adaptation_time = float(part.rise_time), float(part.adaptation_time)

    def change(time: float, numbers: np.ndarray) -> np.ndarray:
        """Return the derivatives in eqs. 4-6 of Iwadate 2010, with one network for each gain."""
        del time
        potential, adaptation = numbers.reshape(2, 2, count, len(gains))
        firing = np.maximum(potential, 0.0)
        inhibition = other @ firing[::-1] + own @ firing
        rise = (drive - potential - inhibition - gains * adaptation) / rise_time
        return np.stack([rise, (firing - adaptation) / adaptation_time]).ravel()

    start = np.zeros((2, 2, count, len(gains)))
    start[0] = np.asarray(part.initial_potential)[..., None]
    slow, quick = max(rise_time, adaptation_time), min(rise_time, adaptation_time)
    end = (_SETTLING + _SEEN) * slow
    seen = np.arange(_SETTLING * slow, end, quick / 2)
    errors: dict[str, Any] = {"rtol": _RELATIVE, "atol": _ABSOLUTE * drive}
    found = solve_ivp(change, (0.0, end), start.ravel(), t_eval=seen, **errors)
    extensor, flexor = np.maximum(found.y.reshape(2, 2, count, len(gains), -1)[0], 0.0)
    swing, most = np.ptp(extensor - flexor, axis=-1), (extensor + flexor).max(-1)
    return (swing <= 10 * _LEAST_SWING * most).all(-1)


def _still(run: Run) -> Bool[np.ndarray, " o"]:
    return run.highest - run.lowest <= _LEAST_SWING * run.most
