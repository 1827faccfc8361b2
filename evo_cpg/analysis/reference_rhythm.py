"""Settings of the oscillators that give a wanted frequency and lag.

Frequency: ``time_scale`` multiplies both time constants of the network, so it divides all
frequencies and changes nothing else. It follows from the frequency that is there without it.

Lag: the mean lag L of each oscillator of a chain behind the one before it depends on three
unknowns,

    x = log(b, s, r),

the adaptation gain, the stronger of the two couplings between neighbours, and the weaker in units
of it. The wave runs away from the stronger: that is ``parent_weight`` for a positive lag (head to
tail) and ``child_weight`` for a negative one. One equation for three unknowns has many solutions,
of which the one nearest to the present settings x0 is taken, as the least squares

    min  (L(x) - wanted)^2 / l^2 + |x - x0|^2 + w^2 |what x lies outside its bounds by|^2

by Levenberg and Marquardt's method (`scipy.optimize.least_squares`). With l = 0.1 degrees the
second term keeps L from the wanted lag by some 1e-3 degrees. L comes from the periodic orbit
(`evo_cpg.analysis.limit_cycle`), which is exact, so differences give its derivatives. A step to
where there is no orbit is refused.

Where to start, and what can be reached at all, tells a simulation of networks all over the bounds,
side by side (`survey`). L is continuous, so all between the smallest and the largest of their lags
can be had.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from evo_cpg.analysis.chains import Chain
from evo_cpg.analysis.couplings import Problem, network_at, problem_of
from evo_cpg.analysis.lag_survey import UnreachableRhythmError, starting_place, survey
from evo_cpg.analysis.limit_cycle import (
    LimitCycle,
    NoRhythmError,
    Orbit,
    RhythmSearchError,
    close,
    flow_of,
    limit_cycle,
    outputs,
    settle,
    start_of,
)
from evo_cpg.control.matsuoka import CpgSettings, build_network
from evo_cpg.control.piecewise import Flow
from evo_cpg.creature.tree import Tree

# l in degrees, w, and how often the search may begin anew where it ended.
_LAG_UNIT, _WALL, _ROUNDS = 0.1, 1e3, 4

# Of the derivative of the lag, by differences of an orbit that is exact to 1e-11; and what a place
# without an orbit counts as, in units of l: more than any lag does.
_CHANGE, _NO_ORBIT = 1e-5, 1e4

# Digits that the answer is rounded to, and how near it then must be, degrees.
_DIGITS, _TOLERANCE = 5, 0.02


class Rhythm(NamedTuple):
    """Settings and what comes of them.

    Attributes:
        settings: of the oscillators.
        adaptation_gain: b, the same for all.
        cycle: the orbit of the part that the chain is in.
        lags: along the chain, degrees; the lag is their mean.
    """

    settings: CpgSettings
    adaptation_gain: float
    cycle: LimitCycle
    lags: Float[np.ndarray, " gaps"]

    @property
    def lag(self) -> float:
        """Mean lag along the chain, degrees; nan for a single oscillator."""
        return float(self.lags.mean()) if len(self.lags) else np.nan


def rhythm(
    tree: Tree, settings: CpgSettings, chain: Chain, gain: float, tonic_input: float | None = None
) -> Rhythm:
    """What a chain does with given settings.

    Args:
        tree: the creature.
        settings: of the oscillators.
        chain: one of `evo_cpg.analysis.chains.chains`.
        gain: b.
        tonic_input: u; the largest if None.

    Raises:
        NoRhythmError: it comes to rest.
        RhythmSearchError: the search found neither a rhythm nor rest.
    """
    network = build_network(tree, settings)
    tonic = settings.max_tonic_input if tonic_input is None else tonic_input
    drive = np.full((2, network.oscillator_count), tonic)
    gains = np.full(network.oscillator_count, gain)
    cycle = limit_cycle(network, drive, gains, chain.part)
    return Rhythm(settings, gain, cycle, _lags(cycle.outputs, chain.places, chain.sides))


def reference_rhythm(
    tree: Tree,
    settings: CpgSettings,
    chain: Chain,
    gain: float,
    frequency: float | None = None,
    lag: float | None = None,
    hold_gain: bool = False,
    tonic_input: float | None = None,
) -> Rhythm:
    """The nearest settings that give a frequency, a lag or both.

    Args:
        tree: the creature.
        settings: at present.
        chain: whose lag and frequency are meant.
        gain: b at present.
        frequency: wanted, Hz; what it comes to if None.
        lag: wanted mean over the chain, degrees; that of the present settings if None.
        hold_gain: solve for the couplings only.
        tonic_input: u; the largest if None. Only the amplitude depends on it.

    Raises:
        NoRhythmError: the settings give no rhythm: the present ones, or those that were found for
            the lag at this tonic input.
        RhythmSearchError: the search found neither a rhythm nor rest there.
        UnreachableRhythmError: the lag is out of reach; the message says what is within.
        ValueError: a frequency, lag or b that is none.
    """
    if not 0 < gain < np.inf:
        raise ValueError(f"an adaptation gain must be a positive number, got {gain:g}")
    if frequency is not None and not 0 < frequency < np.inf:
        raise ValueError(f"a frequency must be a positive number of Hz, got {frequency:g}")
    if lag is not None:
        if not -180 < lag < 180:
            raise ValueError(f"a lag must lie between -180 and 180 degrees, got {lag:g}")
        if len(chain.places) < 2:
            raise UnreachableRhythmError(
                f"the longest chain through {chain.name} is that one oscillator, so it has no lag"
            )
        found = _with_lag(tree, settings, chain, gain, lag, hold_gain, tonic_input)
    else:
        found = rhythm(tree, settings, chain, gain, tonic_input)
    if frequency is None:
        return found
    scale = found.settings.time_scale
    time_scale = float(f"{scale * found.cycle.frequency / frequency:.{_DIGITS + 1}g}")
    # Nothing else changes, so there is no other orbit to look for.
    return found._replace(
        settings=dataclasses.replace(found.settings, time_scale=time_scale),
        cycle=found.cycle._replace(period=found.cycle.period * time_scale / scale),
    )


def _with_lag(
    tree: Tree,
    settings: CpgSettings,
    chain: Chain,
    gain: float,
    lag: float,
    hold_gain: bool,
    tonic_input: float | None,
) -> Rhythm:
    head_to_tail = bool(lag >= 0)
    with jax.enable_x64(True):
        problem = problem_of(tree, settings, chain, gain, head_to_tail, hold_gain)
        x = starting_place(problem, *survey(problem), lag)
    for _ in range(_ROUNDS):
        with jax.enable_x64(True):
            x = np.clip(_improve(problem, x, lag), *problem.bounds)
        now, stronger, ratio = np.exp(x)
        weights = _rounded(stronger), _rounded(stronger * ratio)
        parent, child = weights if head_to_tail else weights[::-1]
        there = dataclasses.replace(settings, parent_weight=parent, child_weight=child)
        # From rest, as the animal starts, whatever orbit the search has followed.
        found = rhythm(tree, there, chain, gain if hold_gain else _rounded(now), tonic_input)
        if abs(found.lag - lag) < _TOLERANCE and found.cycle.stable:
            return found
    raise UnreachableRhythmError(
        f"the search for a lag of {lag:g} degrees ended at {found.lag:.2f} degrees"
        + ("" if found.cycle.stable else ", in a rhythm that is not stable")
    )


def _rounded(number: float) -> float:
    return float(f"{number:.{_DIGITS}g}")


def _improve(problem: Problem, x: np.ndarray, lag: float) -> np.ndarray:
    """Least squares from the orbit at x; a place without an orbit is worse than any other."""
    nearby: list[Orbit] = []

    def mean_lag(x: np.ndarray) -> float:
        flow = _flow_at(problem, x)
        orbit = close(flow, nearby[-1].state, nearby[-1].period) if nearby else None
        if orbit is None:
            try:
                orbit = settle(flow, start_of(flow, problem.template))
            except (NoRhythmError, RhythmSearchError):
                return np.nan
        nearby[:] = [orbit]
        return float(_lags(outputs(flow, orbit), problem.chain, problem.sides).mean())

    def residuals(change: np.ndarray) -> np.ndarray:
        there = problem.present + problem.free * change
        low, high = problem.bounds
        outside = np.maximum(there - high, 0) - np.maximum(low - there, 0)
        off = (mean_lag(there) - lag) / _LAG_UNIT
        off = off if np.isfinite(off) else _NO_ORBIT
        return np.concatenate([[off], change, problem.free * _WALL * outside])

    def derivative(change: np.ndarray) -> np.ndarray:
        here = residuals(change)
        moved = [residuals(change + _CHANGE * unit) for unit in np.eye(len(change))]
        return (np.transpose(moved) - here[:, None]) / _CHANGE

    from scipy.optimize import least_squares

    begin = x - problem.present
    options: dict[str, Any] = {"jac": derivative, "method": "lm", "max_nfev": 50}
    found = least_squares(residuals, begin, xtol=1e-4, ftol=1e-4, **options)
    return problem.present + problem.free * found.x


def _flow_at(problem: Problem, x: np.ndarray) -> Flow:
    with jax.enable_x64(True):
        network, gain = network_at(problem, jnp.asarray(x))
    every = range(network.oscillator_count)
    # Its drive has the feedback in it.
    bare = dataclasses.replace(network, sensory_feedback=0.0)
    return flow_of(bare, problem.drive, np.asarray(gain), every)


def _lags(signals: np.ndarray, places: Sequence[int], sides: np.ndarray) -> np.ndarray:
    """Of each oscillator of a chain behind the one before it, degrees."""
    component = np.fft.rfft(signals[list(places)], axis=1)[:, 1]
    return np.rad2deg(np.angle(sides * component[:-1] * component[1:].conj()))
