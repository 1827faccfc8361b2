"""Rhythm of a Matsuoka network as a periodic orbit: period, shape and stability.

The simulation of a network is exact, one linear piece at a time (`evo_cpg.control.piecewise`). The
search for a rhythm has three distinct outcomes:

| outcome | condition |
|---|---|
| a `LimitCycle` | a simulated state repeats after a period, to rounding |
| `NoRhythmError` | the simulation reaches a stable equilibrium and cannot leave it |
| `RhythmSearchError` | neither within the budget, so nothing is known about the network |

A state s with period T solves ``flow(s, T) = s``. Any state on the orbit is a solution, so one
number is fixed: s lies in the plane through the first guess, perpendicular to the flow there.
Newton's method solves for the 4 o + 1 unknowns (shooting, e.g. Guckenheimer & Meloon 2000). The
guess is a simulated state that nearly repeats.

The monodromy matrix is the derivative of the flow over one period. Its eigenvalues are the Floquet
multipliers. One multiplier is 1: a perturbation along the orbit only shifts the phase. The others
are the factors by which perturbations change in each period. A rhythm with a magnitude above 1 is
unstable.

All computations are in float64, in units of the network (`Flow`). All tolerances are relative to
the swing of the orbit, so they hold for every drive and every time scale.

Feedback of the senses (`evo_cpg.control.feedback`) is left out: the orbit is that of the open loop.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from evo_cpg.control.matsuoka import MatsuokaNetwork, MatsuokaState, parts, sub_network
from evo_cpg.control.piecewise import BudgetError, Flow, Rest, Run, returned

# Samples along an orbit.
STEPS = 1000

# Duration of the first simulated interval, in units of T_r + T_a, and growth of each further
# interval. The search for a rhythm follows each interval.
_STRETCH, _LONGER = 10.0, 1.5

# Onsets of firing per neuron and unit of time that end an interval early. Fast rhythms then need no
# more periods than slow ones.
_ONSETS = 4

# Largest number of simulation steps, about 100 us each for a chain of nine. The slowest rhythms
# need this number.
_BUDGET = 200_000

# Distance of a repeated state from an earlier one, as a fraction of the swing. It halves after each
# interval, down to the second value. This separates a rhythm of two alternating rounds from a
# rhythm of equal rounds.
_NEAR, _NEAREST = 0.02, 1e-7

# Largest number of Newton steps (3 to 6 from a settled state), and largest change of state and
# period, as a fraction of swing and period. A larger change may lead to another orbit.
_NEWTON, _MOVED = 12, 0.1

# Gap of a closed orbit, as a fraction of its swing. Rounding leaves 1e-15 times the flow's
# amplification within a period, for which the search allows 1e4.
CLOSED = 1e-11

# Rounding error of states, as a fraction of the largest drive. It matters if neurons fire at far
# lower rates than the drive. They do so if the adaptation gain b is 10,000 or more.
_ROUNDING = 1e-13

# Largest relative error of the monodromy matrix along the flow, whose direction it should preserve.
# Multipliers have this accuracy.
_NEUTRAL = 1e-4

# Swing, as a fraction of the widest swing, below which an oscillator has no phase but rounding.
_FAINT = 1e-9

# Relative size below which a harmonic counts as missing. The orbit may consist of several equal
# rounds if the first harmonics are missing.
_FUNDAMENTAL = 1e-2

# Number of intervals that the simulation must stay on an unstable orbit.
_STAYS = 3


class NoRhythmError(ValueError):
    """The simulation has shown that the network comes to rest."""


class RhythmSearchError(ValueError):
    """The search failed: it found neither a rhythm nor rest."""


class LimitCycle(NamedTuple):
    """A periodic orbit.

    Attributes:
        oscillators: oscillators of the network with this rhythm.
        period: period, s.
        states: states along the orbit, every ``period / STEPS``, extensors first,
            ``(2, o, STEPS)``.
        multipliers: Floquet multipliers without the neutral one, largest magnitude first. NaN if
            they could not be computed, as for a rhythm with long pauses.
        monodromy: derivative of the flow over one period at the first state, in the order of
            `MatsuokaState`.
    """

    oscillators: tuple[int, ...]
    period: float
    states: MatsuokaState
    multipliers: Complex[np.ndarray, " m"]
    monodromy: Float[np.ndarray, "k k"]

    @property
    def frequency(self) -> float:
        """Frequency, Hz."""
        return 1.0 / self.period

    @property
    def stable(self) -> bool:
        """Return whether small perturbations decay."""
        return bool(np.abs(self.multipliers[0]) < 1)

    @property
    def recovery_time(self) -> float:
        """Time in which the slowest perturbation decays to 1/e, s, or infinity if unstable.

        NaN if the multipliers are NaN.
        """
        size = np.abs(self.multipliers[0])
        if np.isnan(size):
            return np.nan
        if size == 0:
            return 0.0
        return float(-self.period / np.log(size)) if size < 1 else np.inf

    @property
    def outputs(self) -> Float[np.ndarray, "o t"]:
        """Motor signals along the orbit, in the unit of the tonic input."""
        extensor, flexor = np.maximum(np.asarray(self.states.potential), 0.0)
        return extensor - flexor

    @property
    def amplitude(self) -> Float[np.ndarray, " o"]:
        """Half the peak-to-peak range of each signal."""
        return np.ptp(self.outputs, axis=1) / 2

    @property
    def lag(self) -> Float[np.ndarray, " gaps"]:
        """Lag of each oscillator's fundamental behind the one before, degrees, -180 to 180."""
        return self.lags(self.oscillators)[1:]

    def lags(self, order: Sequence[int]) -> Float[np.ndarray, " n"]:
        """Return the lags in another order, the first behind the last, as around a ring.

        Args:
            order: some of `oscillators`.

        Returns:
            Lags, degrees. NaN if one of the two oscillators rests.
        """
        component = np.fft.rfft(self.outputs, axis=1)[:, 1]
        component[self.amplitude < _FAINT * self.amplitude.max()] = np.nan
        component = component[[self.oscillators.index(i) for i in order]]
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.rad2deg(np.angle(np.roll(component, 1) / component))


class Orbit(NamedTuple):
    """A closed orbit in units of a flow.

    Attributes:
        state: state on the orbit.
        period: period of the orbit.
        run: simulation of one period from the state, with its tangent.
    """

    state: Float[np.ndarray, " k"]
    period: float
    run: Run


def limit_cycle(
    network: MatsuokaNetwork,
    tonic_input: Float[np.ndarray, "2 o"],
    adaptation_gain: Float[np.ndarray, " o"],
    oscillators: tuple[int, ...] | None = None,
) -> LimitCycle:
    """Return the orbit of one part of a network: one set of connected oscillators.

    The part starts at its initial potentials and has a constant drive.

    Args:
        network: connections and time constants.
        tonic_input: u of each neuron, extensors first.
        adaptation_gain: b of each oscillator.
        oscillators: oscillators of the part, or None for the first of `parts`.

    Raises:
        NoRhythmError: the part rests.
        RhythmSearchError: the search found neither a rhythm nor rest.
    """
    chosen = parts(network)[0] if oscillators is None else oscillators
    part = sub_network(network, chosen)
    flow = flow_of(part, tonic_input, adaptation_gain, chosen)
    return describe(flow, chosen, settle(flow, start_of(flow, part)))


def flow_of(
    part: MatsuokaNetwork,
    tonic_input: Float[np.ndarray, "2 o"],
    adaptation_gain: Float[np.ndarray, " o"],
    chosen: Sequence[int],
) -> Flow:
    """Return the flow of a part of a network.

    Args:
        part: network of some oscillators.
        tonic_input: u of each neuron of the whole network, extensors first.
        adaptation_gain: b of each oscillator of the whole network.
        chosen: indices of the part's oscillators.
    """
    drive = np.asarray(tonic_input, float)[:, list(chosen)] + float(part.constant_input)
    return Flow(part, drive, np.asarray(adaptation_gain, float)[list(chosen)])


def start_of(flow: Flow, part: MatsuokaNetwork) -> Float[np.ndarray, " k"]:
    """Return the initial state of an animal's oscillators, in units of the flow."""
    return flow.vector(part.initial_potential, np.zeros((2, flow.count)))


def settle(flow: Flow, state: Float[np.ndarray, " k"]) -> Orbit:
    """Simulate until the state is on an orbit, and return the orbit.

    Args:
        flow: flow of a part of a network (`flow_of`). The function sets its budget of steps.
        state: initial state.

    Raises:
        NoRhythmError: the simulation leads to rest.
        RhythmSearchError: the simulation found neither rest nor an orbit within the budget.
    """
    if not flow.driven:
        raise NoRhythmError(
            "nothing drives the network, so it comes to rest: the sum of tonic input and sensory "
            "feedback is at most 0 for every neuron"
        )
    flow.steps_left = _BUDGET
    time, stretch, near = 0.0, _STRETCH, _NEAR
    stayed, swing = 0, np.nan
    try:
        while True:
            rest = flow.rest(state)
            if rest is not None:
                raise NoRhythmError(_rest_words(flow, rest, time))
            if flow.stands_still(state):
                raise RhythmSearchError(_border_words(flow, time))
            run = flow.run(state, stretch, most_onsets=_ONSETS * flow.neurons * stretch)
            state, time = run.state, time + run.duration
            swing = float((run.highest - run.lowest).max())
            guess = returned(run.onsets, near)
            found = None if guess is None else close(flow, *guess)
            stayed = 0 if found is None else stayed + 1
            if found is not None and (_is_stable(flow, found) or stayed == _STAYS):
                return found
            state, leapt = flow.leap(state)
            time += leapt
            stretch, near = _LONGER * stretch, max(near / 2, _NEAREST)
    except BudgetError:
        raise RhythmSearchError(_failure_words(flow, state, time, swing)) from None


def close(flow: Flow, state: Float[np.ndarray, " k"], period: float) -> Orbit | None:
    """Find an orbit near a guess by Newton's method, or return None.

    Args:
        flow: flow of the network.
        state: guess of a state.
        period: guess of the period, in units of the flow.
    """
    first, about = state, period
    across = flow.derivative(first)
    across = across / np.linalg.norm(across)
    swing = None
    for _ in range(_NEWTON):
        run = flow.run(state, period, tangent=True)
        gap = run.state - state
        if swing is None:
            visited = np.array([onset.state for onset in run.onsets] + [state])
            swing = float(np.ptp(visited, axis=0).max()) or float(np.abs(state).max())
        if np.abs(gap).max() < CLOSED * swing + _ROUNDING:
            return Orbit(state, period, run)
        assert run.tangent is not None
        matrix = np.zeros((flow.size + 1, flow.size + 1))
        matrix[:-1, :-1] = run.tangent - np.eye(flow.size)
        matrix[:-1, -1] = flow.derivative(run.state)
        matrix[-1, :-1] = across
        try:
            change = np.linalg.solve(matrix, np.append(-gap, across @ (first - state)))
        except np.linalg.LinAlgError:
            return None
        state, period = state + change[:-1], period + float(change[-1])
        strayed = np.abs(state - first).max() > _MOVED * swing
        if strayed or not abs(period - about) < _MOVED * about:
            return None
    return None


def describe(flow: Flow, chosen: tuple[int, ...], orbit: Orbit) -> LimitCycle:
    """Return an orbit in the user's units.

    Args:
        flow: flow of the part.
        chosen: oscillators of the part.
        orbit: orbit in units of the flow.
    """
    orbit, samples = _once(flow, orbit)
    assert orbit.run.tangent is not None
    # Fill the class of JAX arrays with NumPy arrays, which keep double precision.
    kind = jax.tree.structure(MatsuokaState(jnp.zeros((2, 1)), jnp.zeros((2, 1))))
    along = flow.scale * samples.reshape(2, 2, flow.count, STEPS)
    states = jax.tree.unflatten(kind, list(along))
    multipliers = _multipliers(flow, orbit)
    if not _neutral_error(flow, orbit) < _NEUTRAL:
        multipliers = np.full_like(multipliers, np.nan)
    period = orbit.period / flow.second
    return LimitCycle(chosen, period, states, multipliers, orbit.run.tangent)


def sampled(flow: Flow, orbit: Orbit) -> Float[np.ndarray, "k t"]:
    """Return states along an orbit, every ``period / STEPS``, in units of the flow."""
    states, state = [], orbit.state
    for _ in range(STEPS):
        states.append(state)
        state = flow.run(state, orbit.period / STEPS).state
    return np.transpose(states)


def outputs(flow: Flow, orbit: Orbit) -> Float[np.ndarray, "o t"]:
    """Return motor signals along an orbit, in units of the flow."""
    extensor, flexor = np.maximum(sampled(flow, orbit)[: flow.neurons], 0).reshape(
        2, flow.count, STEPS
    )
    return extensor - flexor


def _once(flow: Flow, orbit: Orbit) -> tuple[Orbit, Float[np.ndarray, "k t"]]:
    """Return an orbit reduced to a single round, and the states along it."""
    samples = sampled(flow, orbit)
    swings = samples - samples.mean(1, keepdims=True)
    harmonics = np.abs(np.fft.rfft(swings, axis=1)[:, 1:]).max(0)
    times = 1 + int((harmonics > _FUNDAMENTAL * harmonics.max()).argmax())
    if times == 1:
        return orbit, samples
    once = close(flow, orbit.state, orbit.period / times)
    swing = float(np.ptp(samples, axis=1).max())
    if once is None or np.abs(once.state - orbit.state).max() > CLOSED**0.5 * swing:
        return orbit, samples
    return once, sampled(flow, once)


def _is_stable(flow: Flow, orbit: Orbit) -> bool:
    return bool(np.abs(_multipliers(flow, orbit)).max(initial=0.0) < 1)


def _multipliers(flow: Flow, orbit: Orbit) -> Complex[np.ndarray, " m"]:
    """Return Floquet multipliers, without the neutral one along the flow."""
    assert orbit.run.tangent is not None
    along = flow.derivative(orbit.state)
    across = np.linalg.qr(along[:, None], mode="complete")[0][:, 1:]
    values = np.linalg.eigvals(across.T @ orbit.run.tangent @ across)
    return values[np.argsort(-np.abs(values), kind="stable")].astype(complex)


def _neutral_error(flow: Flow, orbit: Orbit) -> float:
    """Return the relative change of the flow's direction by the monodromy matrix."""
    along = flow.derivative(orbit.state)
    assert orbit.run.tangent is not None
    return float(np.linalg.norm(orbit.run.tangent @ along - along) / np.linalg.norm(along))


def _rest_words(flow: Flow, rest: Rest, time: float) -> str:
    """Return the message for a network at rest, with advice."""
    rate = rest.rates[0].real * flow.second
    decay = f"decays within {-1 / rate:.3g} s" if rate < 0 else "does not grow"
    if rest.firing.all():
        how = "All neurons fire evenly. Couple the oscillators, or increase pair_weight"
    else:
        how = "Some neurons silence others. Try a smaller pair_weight or a larger b"
    return (
        f"the network comes to rest: after {time / flow.second:.3g} s it is near a stable "
        f"equilibrium (a perturbation {decay}). {how}. An isolated oscillator needs a pair_weight "
        f"between {1 + flow.ratio:.3g} and 1 + b"
    )


def _border_words(flow: Flow, time: float) -> str:
    """Return the message for a state at the border between rest and rhythm."""
    return (
        "the search failed, so nothing is known about the network: after "
        f"{time / flow.second:.3g} s it stands still at the border between rest and a "
        "rhythm. Try a slightly smaller or larger pair_weight or --gain"
    )


def _failure_words(flow: Flow, state: np.ndarray, time: float, swing: float) -> str:
    """Return the message for a search that used up its budget."""
    words = (
        "the search failed, so nothing is known about the network: in "
        f"{time / flow.second:.3g} s of simulation it neither came to rest nor repeated itself"
    )
    near = flow.equilibrium(state)
    if near is None:
        return (
            f"{words}. Its output swings by up to {swing * flow.scale:.3g}. The rhythm may be "
            "irregular or settle slowly. Try another --gain or other weights"
        )
    rate = near.rates[0].real * flow.second
    change = "grow" if rate > 0 else "decay"
    return (
        f"{words}. Swings about an equilibrium {change}, by a factor e in {abs(1 / rate):.3g} s. "
        "Try a pair_weight a little farther from this border of oscillation"
    )
