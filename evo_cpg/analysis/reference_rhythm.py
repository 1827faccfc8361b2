"""Settings of the oscillators that give a reference frequency and lag.

Frequency: ``time_scale`` multiplies both time constants of the network, so it divides all
frequencies and changes nothing else. Its value follows from the present frequency.

Lag: L is the mean lag of each oscillator of a chain behind the one before it. It depends on three
unknowns,

    x = log(b, s, r),

the adaptation gain b, the stronger coupling s between neighbours, and the ratio r of the weaker
coupling to the stronger one. The stronger coupling is ``parent_weight`` for a positive lag (head to
tail) and ``child_weight`` for a negative lag. One equation for three unknowns has many solutions.
Least squares select the solution nearest to the present settings x0,

    min  (L(x) - L*)^2 / l^2 + |x - x0|^2 + w^2 |distance of x outside its bounds|^2

with the reference lag L*, by Levenberg and Marquardt's method (`scipy.optimize.least_squares`).
With l = 0.1 degrees, the second term shifts L by about 1e-3 degrees. L is computed from the
periodic orbit (`evo_cpg.analysis.limit_cycle`), which is exact, so finite differences give its
derivatives. A step to a point without an orbit is rejected.

A simulation of networks within the bounds (`survey`) gives the starting point and the range of
reachable lags.
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

# l in degrees, w, and the largest number of searches, each from the result of the one before.
_LAG_UNIT, _WALL, _ROUNDS = 0.1, 1e3, 4

# Step of the finite differences (the orbit is exact to 1e-11). Residual ``(L - L*) / l`` of a point
# without an orbit: larger than for any lag, as lags differ by at most 360 degrees.
_CHANGE, _NO_ORBIT = 1e-5, 1e4

# Digits of the rounded result, and largest error of its lag, degrees.
_DIGITS, _TOLERANCE = 5, 0.02


class Rhythm(NamedTuple):
    """Settings of the oscillators and the resulting rhythm.

    Attributes:
        settings: settings of the oscillators.
        adaptation_gain: b, equal for all oscillators.
        cycle: orbit of the chain's part of the network.
        lags: lags along the chain, degrees.
    """

    settings: CpgSettings
    adaptation_gain: float
    cycle: LimitCycle
    lags: Float[np.ndarray, " gaps"]

    @property
    def lag(self) -> float:
        """Mean lag along the chain, degrees, or NaN for a single oscillator."""
        return float(self.lags.mean()) if len(self.lags) else np.nan


def rhythm(
    tree: Tree, settings: CpgSettings, chain: Chain, gain: float, tonic_input: float | None = None
) -> Rhythm:
    """Return the rhythm of a chain with given settings.

    Args:
        tree: the creature.
        settings: settings of the oscillators.
        chain: one of `evo_cpg.analysis.chains.chains`.
        gain: b.
        tonic_input: u, or None for the largest one.

    Raises:
        NoRhythmError: the network comes to rest.
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
    """Return the nearest settings that give a frequency, a lag or both.

    Args:
        tree: the creature.
        settings: present settings.
        chain: chain with the lag and the frequency.
        gain: present b.
        frequency: reference frequency, Hz, or None to leave ``time_scale`` unchanged.
        lag: reference mean lag of the chain, degrees, or None to leave b and couplings unchanged.
        hold_gain: whether to solve for the couplings only.
        tonic_input: u, or None for the largest one. Only the amplitude depends on it.

    Raises:
        NoRhythmError: the network rests with the present settings, or with the settings found.
        RhythmSearchError: the search found neither a rhythm nor rest.
        UnreachableRhythmError: the lag is out of reach. The message states the reachable range.
        ValueError: a frequency, lag or b is outside its range.
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
                f"the longest chain through {chain.name} has a single oscillator, so it has no "
                "lag. Set lags between limbs with controller.cpg.couplings or rings"
            )
        found = _with_lag(tree, settings, chain, gain, lag, hold_gain, tonic_input)
    else:
        found = rhythm(tree, settings, chain, gain, tonic_input)
    if frequency is None:
        return found
    scale = found.settings.time_scale
    time_scale = float(f"{scale * found.cycle.frequency / frequency:.{_DIGITS + 1}g}")
    # The shape of the orbit does not change, so no new search is needed.
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
        # Start as the animal does, because the search may have followed another orbit.
        found = rhythm(tree, there, chain, gain if hold_gain else _rounded(now), tonic_input)
        if abs(found.lag - lag) < _TOLERANCE and found.cycle.stable:
            return found
    raise UnreachableRhythmError(
        f"the search for a lag of {lag:g} degrees ended at {found.lag:.2f} degrees"
        + ("" if found.cycle.stable else ", in an unstable rhythm")
    )


def _rounded(number: float) -> float:
    return float(f"{number:.{_DIGITS}g}")


def _improve(problem: Problem, x: np.ndarray, lag: float) -> np.ndarray:
    """Solve the least squares, starting from the orbit at x."""
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
    # `Problem.drive` already includes the sensory feedback.
    bare = dataclasses.replace(network, constant_input=0.0)
    return flow_of(bare, problem.drive, np.asarray(gain), every)


def _lags(signals: np.ndarray, places: Sequence[int], sides: np.ndarray) -> np.ndarray:
    """Return the lag of each oscillator of a chain behind the one before it, degrees."""
    component = np.fft.rfft(signals[list(places)], axis=1)[:, 1]
    return np.rad2deg(np.angle(sides * component[:-1] * component[1:].conj()))
