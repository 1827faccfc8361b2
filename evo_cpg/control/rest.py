"""Which oscillators come to rest under a constant drive, checked by letting them run.

`evo_cpg.analysis.limit_cycle` says much more. This takes a second at most, so that it can be asked
before every run.
"""

import numpy as np
from jaxtyping import Bool

from evo_cpg.control.matsuoka import MatsuokaNetwork, parts, sub_network
from evo_cpg.control.piecewise import BudgetError, Flow, Run, returned

# How long the network runs at most, in units of T_r + T_a: in stretches, each half as long again.
_LONGEST, _STRETCH, _LONGER = 70.0, 10.0, 1.5

# A stretch ends earlier where each neuron begins to fire more often in a unit of time.
_ONSETS = 4

# A part repeats itself where it came back to the same state but for this share of its swing, or, at
# the end, for the larger share.
_NEAR, _NEAR_ENOUGH = 1e-4, 0.02

# An oscillator rests in a part that swings where its output swings by less than this share of what
# its neurons fire.
_LEAST_SWING = 1e-3

# Steps of each part; what needs more is not said to rest.
_BUDGET = 20_000


def resting(
    network: MatsuokaNetwork, tonic_input: float, min_gain: float, max_gain: float
) -> list[int]:
    """Oscillators whose output does not swing, with the smallest, middle and largest gain.

    Only those count that certainly rest: the whole part is near a stable equilibrium, or it
    repeats itself without them.

    Args:
        network: connections and time constants.
        tonic_input: u of every neuron; outputs are proportional to it where s is 0.
        min_gain: smallest b.
        max_gain: largest b.
    """
    drive = tonic_input + float(network.sensory_feedback)
    rests = np.ones(network.oscillator_count, bool)
    known: dict[bytes, Bool[np.ndarray, " o"]] = {}
    for chosen in parts(network):
        part = sub_network(network, chosen)
        # The axes of a body are often alike.
        same = part.matrix.tobytes() + np.asarray(part.initial_potential).tobytes()
        if same not in known:
            gains = np.linspace(min_gain, max_gain, 3)
            known[same] = np.ones(len(chosen), bool)
            for gain in gains:
                # With the first gain most parts swing, and nothing is left to check.
                if known[same].any():
                    known[same] &= _part_rests(part, drive, gain)
        rests[list(chosen)] = known[same]
    return [int(i) for i in np.flatnonzero(rests)]


def _part_rests(part: MatsuokaNetwork, drive: float, gain: float) -> Bool[np.ndarray, " o"]:
    """Which oscillators of a part rest with a gain."""
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


def _still(run: Run) -> Bool[np.ndarray, " o"]:
    return run.highest - run.lowest <= _LEAST_SWING * run.most
