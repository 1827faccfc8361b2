"""Rhythm of a Matsuoka network as a periodic orbit: period, shape and stability.

A network may be simulated exactly, one linear piece at a time (`evo_cpg.control.piecewise`). The
search for a rhythm has three outcomes, which are never taken for one another:

| outcome | what was checked |
|---|---|
| a `LimitCycle` | a state comes back to itself, to rounding; the simulation leads to it |
| `NoRhythmError` | the simulation comes near a stable equilibrium, from where nothing leads away |
| `RhythmSearchError` | neither, within the budget: nothing is known of the network |

A state s that comes back to itself after T solves ``flow(s, T) = s``. The flow does not care where
on the orbit s lies, so one number is fixed: s lies in the plane across the flow through the first
guess. Newton's method solves for the 4 o + 1 unknowns (shooting, e.g. Guckenheimer & Meloon 2000).
The guess is a state of the simulation that came back nearly to itself.

The derivative of the flow over one period, the monodromy matrix, says what becomes of a small push:
its eigenvalues are the Floquet multipliers. One of them is 1, a push along the orbit, which only
shifts the phase. The others say by which factor what is left of a push shrinks in each period; if
one is larger than 1 the rhythm is not stable.

All is done in float64, in units of the network (`Flow`). All tolerances are relative to the swing
of the orbit, so they hold for every drive and every time scale.
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

# The first stretch that is simulated before the search looks back, in units of T_r + T_a. Every
# further one is half as long again.
_STRETCH, _LONGER = 10.0, 1.5

# A stretch ends earlier where each neuron begins to fire more often in a unit of time. Quick
# rhythms need no more rounds than slow ones.
_ONSETS = 4

# Steps of the simulation in all, about 100 us each for a chain of nine. The slowest rhythm that is
# found takes this many.
_BUDGET = 200_000

# A state has come back where it is as near to an earlier one as this share of the swing; half of
# it after each stretch, down to the least. A rhythm that repeats every second time only is then
# told from one that repeats every time.
_NEAR, _NEAREST = 0.02, 1e-7

# Newton's method takes 3 to 6 steps from a settled state. It has found what the simulation does
# where it moved by less than this share of the swing, and of the period.
_NEWTON, _MOVED = 12, 0.1

# The gap at which an orbit is closed, as a share of its swing. Rounding leaves 1e-15 times what the
# flow amplifies it by within a period, for which the search allows 1e4.
CLOSED = 1e-11

# What rounding of the drive, the unit of states, may come to. It matters where neurons fire faintly
# beside the drive: from b = 10,000 on.
_ROUNDING = 1e-13

# How far the monodromy matrix may turn the flow's own direction, which it should leave alone, as a
# share. Multipliers are as exact.
_NEUTRAL = 1e-4

# An oscillator that swings by less than this share of the widest one has no phase: rounding.
_FAINT = 1e-9

# A harmonic that is smaller than this share of the largest may be missing; the orbit may then
# consist of equal rounds.
_FUNDAMENTAL = 1e-2

# An orbit that is not stable counts only where the simulation stays on it for this many stretches.
_STAYS = 3


class NoRhythmError(ValueError):
    """The network comes to rest: a fact, checked by simulation."""


class RhythmSearchError(ValueError):
    """The search found neither a rhythm nor rest: a failure of the search, no fact."""


class LimitCycle(NamedTuple):
    """A periodic orbit.

    Attributes:
        oscillators: which of the network's it is of.
        period: s.
        states: along the orbit, every ``period / STEPS``; extensors first, ``(2, o, STEPS)``.
        multipliers: Floquet multipliers without the neutral one, largest magnitude first; nan where
            they could not be computed, as for a rhythm that nearly stands still in between.
        monodromy: derivative of the flow over one period at the first state, whose numbers stand in
            the order of `MatsuokaState`.
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
        """After which what is left of the slowest push has shrunk to 1/e, s; inf if unstable.

        nan where the multipliers are.
        """
        size = np.abs(self.multipliers[0])
        if np.isnan(size):
            return np.nan
        if size == 0:
            return 0.0
        return float(-self.period / np.log(size)) if size < 1 else np.inf

    @property
    def outputs(self) -> Float[np.ndarray, "o t"]:
        """Motor signals along the orbit, in units of the tonic input."""
        extensor, flexor = np.maximum(np.asarray(self.states.potential), 0.0)
        return extensor - flexor

    @property
    def amplitude(self) -> Float[np.ndarray, " o"]:
        """Half the peak-to-peak range of each signal."""
        return np.ptp(self.outputs, axis=1) / 2

    @property
    def lag(self) -> Float[np.ndarray, " gaps"]:
        """Of each oscillator's fundamental behind the one before it, degrees from -180 to 180."""
        return self.lags(self.oscillators)[1:]

    def lags(self, order: Sequence[int]) -> Float[np.ndarray, " n"]:
        """Likewise in another order, the first behind the last, as around a ring.

        Args:
            order: some of `oscillators`.

        Returns:
            Degrees; nan beside an oscillator that rests.
        """
        component = np.fft.rfft(self.outputs, axis=1)[:, 1]
        component[self.amplitude < _FAINT * self.amplitude.max()] = np.nan
        component = component[[self.oscillators.index(i) for i in order]]
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.rad2deg(np.angle(np.roll(component, 1) / component))


class Orbit(NamedTuple):
    """A closed orbit in units of a flow.

    Attributes:
        state: on the orbit.
        period: after which the state comes back.
        run: one period from there, with its tangent.
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
    """The orbit to which one part of a network settles from its start, under a constant drive.

    Args:
        network: connections and time constants.
        tonic_input: u of each neuron, extensors first.
        adaptation_gain: b of each oscillator.
        oscillators: the part; the first of `parts` if None.

    Raises:
        NoRhythmError: it comes to rest.
        RhythmSearchError: it neither came to rest nor repeated itself.
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
    """The flow of a part of a network, with the search's budget.

    Args:
        part: some of a network's oscillators.
        tonic_input: u of each neuron of the network, extensors first.
        adaptation_gain: b of each of its oscillators.
        chosen: which of them are in the part.
    """
    drive = np.asarray(tonic_input, float)[:, list(chosen)] + float(part.sensory_feedback)
    return Flow(part, drive, np.asarray(adaptation_gain, float)[list(chosen)])


def start_of(flow: Flow, part: MatsuokaNetwork) -> Float[np.ndarray, " k"]:
    """The state in which an animal's oscillators start, in units of the flow."""
    return flow.vector(part.initial_potential, np.zeros((2, flow.count)))


def settle(flow: Flow, state: Float[np.ndarray, " k"]) -> Orbit:
    """The orbit to which a simulation leads.

    Args:
        flow: whose steps are limited.
        state: at the start.

    Raises:
        NoRhythmError: it leads to rest.
        RhythmSearchError: it leads nowhere within the flow's budget.
    """
    if not flow.driven:
        raise NoRhythmError(
            "nothing drives the network, so it comes to rest: tonic input and sensory feedback "
            "together are at most 0 for every neuron"
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
    """Newton's method for a state that comes back to itself; None where it finds none nearby.

    Args:
        flow: of the network.
        state: a guess.
        period: a guess, in units of the flow.
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
    """An orbit in the user's units.

    Args:
        flow: of the part.
        chosen: the part's oscillators.
        orbit: that was found.
    """
    orbit, samples = _once(flow, orbit)
    assert orbit.run.tangent is not None
    # Arrays of NumPy, with all their digits, in a class that is made of JAX's.
    kind = jax.tree.structure(MatsuokaState(jnp.zeros((2, 1)), jnp.zeros((2, 1))))
    along = flow.scale * samples.reshape(2, 2, flow.count, STEPS)
    states = jax.tree.unflatten(kind, list(along))
    multipliers = _multipliers(flow, orbit)
    if not _neutral_error(flow, orbit) < _NEUTRAL:
        multipliers = np.full_like(multipliers, np.nan)
    period = orbit.period / flow.second
    return LimitCycle(chosen, period, states, multipliers, orbit.run.tangent)


def sampled(flow: Flow, orbit: Orbit) -> Float[np.ndarray, "k t"]:
    """States along an orbit, every ``period / STEPS``, in units of the flow."""
    states, state = [], orbit.state
    for _ in range(STEPS):
        states.append(state)
        state = flow.run(state, orbit.period / STEPS).state
    return np.transpose(states)


def outputs(flow: Flow, orbit: Orbit) -> Float[np.ndarray, "o t"]:
    """Motor signals along an orbit, in units of the flow."""
    extensor, flexor = np.maximum(sampled(flow, orbit)[: flow.neurons], 0).reshape(
        2, flow.count, STEPS
    )
    return extensor - flexor


def _once(flow: Flow, orbit: Orbit) -> tuple[Orbit, Float[np.ndarray, "k t"]]:
    """An orbit that may have been gone around several times, once, and the states along it."""
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
    """Floquet multipliers but the neutral one, whose direction, the flow's own, is divided out."""
    assert orbit.run.tangent is not None
    along = flow.derivative(orbit.state)
    across = np.linalg.qr(along[:, None], mode="complete")[0][:, 1:]
    values = np.linalg.eigvals(across.T @ orbit.run.tangent @ across)
    return values[np.argsort(-np.abs(values), kind="stable")].astype(complex)


def _neutral_error(flow: Flow, orbit: Orbit) -> float:
    """By how much the monodromy matrix changes the flow's own direction, as a share."""
    along = flow.derivative(orbit.state)
    assert orbit.run.tangent is not None
    return float(np.linalg.norm(orbit.run.tangent @ along - along) / np.linalg.norm(along))


def _rest_words(flow: Flow, rest: Rest, time: float) -> str:
    """Return the message for a network at rest, with advice."""
    rate = rest.rates[0].real * flow.second
    push = f"a push decays within {-1 / rate:.3g} s" if rate < 0 else "a push does not grow"
    if rest.firing.all():
        how = "All neurons fire evenly: stronger inhibition (pair_weight) may let it swing"
    else:
        how = "Some neurons silence others: a smaller pair_weight or a larger b may let it swing"
    return (
        f"the network comes to rest: after {time / flow.second:.3g} s it is near a stable "
        f"equilibrium, where {push}. {how}. It oscillates where 1 + T_r / T_a < a < 1 + b for its "
        "effective inhibition a (docs/models/controller.md)"
    )


def _border_words(flow: Flow, time: float) -> str:
    """Return the message for a state at the border between rest and rhythm."""
    return (
        "the search failed, so nothing is known of the network: after "
        f"{time / flow.second:.3g} s it stands still at the very border between rest and a "
        "rhythm. Try a slightly smaller or larger pair_weight or --gain"
    )


def _failure_words(flow: Flow, state: np.ndarray, time: float, swing: float) -> str:
    """Return the message for a search that used up its budget."""
    words = (
        "the search failed, so nothing is known of the network: in "
        f"{time / flow.second:.3g} s of simulation it neither came to rest nor repeated itself"
    )
    near = flow.equilibrium(state)
    if near is None:
        return (
            f"{words}. Its output swings by up to {swing * flow.scale:.3g}. The rhythm may be "
            "irregular or settle slowly; try another --gain or other weights"
        )
    rate = near.rates[0].real * flow.second
    change = "grow" if rate > 0 else "decay"
    return (
        f"{words}. Swings about an equilibrium {change}, by a factor e in {abs(1 / rate):.3g} s. "
        "Try a pair_weight a little farther from this border of oscillation"
    )
