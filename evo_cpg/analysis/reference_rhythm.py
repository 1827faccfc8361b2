"""Settings of the oscillators that give a reference frequency and lag.

Frequency: ``time_scale`` multiplies both time constants of the network, so it divides all
frequencies and changes nothing else. Its value follows from the present frequency.

Lag: L is the mean lag of each oscillator of a chain behind the one before it. It depends on three
unknowns,

    x = log(b, s, r),

the adaptation gain b, the stronger coupling s between neighbours, and the ratio r of the weaker
coupling to the stronger one. The stronger coupling is ``parent_weight`` for a positive lag (head to
tail) and ``child_weight`` for a negative lag. The bounds of x are a box. L is computed from the
periodic orbit (`evo_cpg.analysis.limit_cycle`) at the present settings and at the corners of the
box. L is continuous, so a straight line from the present settings to a corner contains every lag
between those of its ends. Bisection (Brent) finds the lag on the line that promises the smallest
change.
"""

import dataclasses
import itertools
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from evo_cpg.analysis.chains import OscillatorChain
from evo_cpg.analysis.limit_cycle import LimitCycle, NoRhythmError, RhythmSearchError, limit_cycle
from evo_cpg.control.matsuoka import CpgSettings, build_network
from evo_cpg.creature.tree import Tree

# Bounds of b, s and r. Beyond them waves are irregular (r near 1: equal couplings make no wave),
# recover slowly (r near 0) or are faint (large b). Strong, even couplings with b near 1 make rest.
GAINS, STRONGER, RATIOS = (2.0, 20.0), (0.5, 2.0), (0.05, 0.5)

# Digits of the rounded result, and largest error of its lag, degrees.
_DIGITS, _TOLERANCE = 5, 0.02


class UnreachableRhythmError(ValueError):
    """No settings within the bounds give the reference rhythm."""


class Rhythm(NamedTuple):
    """Settings of the oscillators and the resulting rhythm.

    Attributes:
        settings: settings of the oscillators.
        adaptation_gain: b, equal for all oscillators.
        cycle: orbit of the chain's part of the network.
        lags: lags along the chain, degrees, without the half turn of opposite neighbours.
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
    tree: Tree,
    settings: CpgSettings,
    chain: OscillatorChain,
    gain: float,
    tonic_input: float | None = None,
    near: LimitCycle | None = None,
) -> Rhythm:
    """Return the rhythm of a chain with given settings.

    Args:
        tree: the creature.
        settings: settings of the oscillators.
        chain: one of `evo_cpg.analysis.chains.chains`.
        gain: b.
        tonic_input: u, or None for the largest one.
        near: orbit of similar settings, from which the search starts.

    Raises:
        NoRhythmError: the network comes to rest.
        RhythmSearchError: the search found neither a rhythm nor rest.
    """
    network = build_network(tree, settings)
    tonic = settings.max_tonic_input if tonic_input is None else tonic_input
    drive = np.full((2, network.oscillator_count), tonic)
    gains = np.full(network.oscillator_count, gain)
    cycle = limit_cycle(network, drive, gains, chain.part, near)
    turns = chain.sides * np.exp(1j * np.deg2rad(cycle.lags(chain.oscillators)[1:]))
    return Rhythm(settings, gain, cycle, np.rad2deg(np.angle(turns)))


def reference_rhythm(
    tree: Tree,
    settings: CpgSettings,
    chain: OscillatorChain,
    gain: float,
    frequency: float | None = None,
    lag: float | None = None,
    hold_gain: bool = False,
    tonic_input: float | None = None,
) -> Rhythm:
    """Return settings that give a frequency, a lag or both, near to the present ones.

    Args:
        tree: the creature.
        settings: present settings.
        chain: chain with the lag and the frequency.
        gain: present b.
        frequency: reference frequency, Hz, positive, or None to leave ``time_scale`` unchanged.
        lag: reference mean lag of the chain, -180 to 180 degrees, or None to leave b and couplings
            unchanged.
        hold_gain: whether to solve for the couplings only.
        tonic_input: u, or None for the largest one. Only the amplitude depends on it.

    Raises:
        NoRhythmError: the network rests with the present settings, or with the settings found.
        RhythmSearchError: the search found neither a rhythm nor rest.
        UnreachableRhythmError: the lag is out of reach. The message states the reachable range.
    """
    if lag is None:
        found = rhythm(tree, settings, chain, gain, tonic_input)
    elif len(chain.oscillators) < 2:
        raise UnreachableRhythmError(
            f"the longest chain through {chain.name} has a single oscillator, so it has no lag. "
            "Set lags between limbs with controller.cpg.couplings or rings"
        )
    else:
        found = _with_lag(tree, settings, chain, gain, lag, hold_gain)
        if tonic_input is not None:
            found = rhythm(tree, found.settings, chain, found.adaptation_gain, tonic_input)
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
    chain: OscillatorChain,
    gain: float,
    lag: float,
    hold_gain: bool,
) -> Rhythm:
    """Return the rhythm with the given mean lag, by bisection along lines in the box."""
    names = ("parent_weight", "child_weight") if lag >= 0 else ("child_weight", "parent_weight")

    def at(x: np.ndarray, near: Rhythm | None = None) -> Rhythm | None:
        b, stronger, ratio = np.exp(x)
        weights = (float(f"{weight:.{_DIGITS}g}") for weight in (stronger, stronger * ratio))
        there = dataclasses.replace(settings, **dict(zip(names, weights, strict=True)))
        b = gain if hold_gain else float(f"{b:.{_DIGITS}g}")
        try:
            found = rhythm(tree, there, chain, b, near=near and near.cycle)
        except (NoRhythmError, RhythmSearchError):
            return None
        return found if np.isfinite(found.lag) else None

    low, high = np.log([GAINS, STRONGER, RATIOS]).T
    pair = [settings.parent_weight, settings.child_weight]
    stronger = max(*pair, STRONGER[0])
    present = np.clip(np.log([gain, stronger, max(min(pair) / stronger, RATIOS[0])]), low, high)
    if hold_gain:
        present[0] = low[0] = high[0] = np.log(gain)
    corners = {tuple(x) for x in itertools.product(*zip(low, high, strict=True))}
    places = [present, *map(np.array, sorted(corners))]
    known = [(x, found) for x in places if (found := at(x)) is not None]
    if not known:
        raise UnreachableRhythmError(
            "there is no steady rhythm at any of the gains and couplings tried. pair_weight or "
            "the constants prevent oscillation"
        )
    lags = [found.lag for _, found in known]
    if not min(lags) <= lag <= max(lags):
        direction = "from head to tail" if lag >= 0 else "from tail to head (negative lags)"
        # Round the range inwards, so that its ends are reachable.
        least, most = np.ceil(min(lags) * 10) / 10, np.floor(max(lags) * 10) / 10
        gains = np.unique(np.exp([low[0], high[0]]).round(9))
        raise UnreachableRhythmError(
            f"a lag of {lag:g} degrees is out of reach. Allowed {direction}: {least:.1f} to "
            f"{most:.1f} (with b = {'--'.join(f'{gain:g}' for gain in gains)}, "
            f"{names[0]} = {STRONGER[0]:g}--{STRONGER[1]:g} and {names[1]} = "
            f"{RATIOS[0]:g}--{RATIOS[1]:g} times that)"
        )
    # From the present settings if they oscillate, or else between any two corners.
    lines = itertools.product(known[:1], known[1:])
    if known[0][0] is not present:
        lines = itertools.combinations(known, 2)
    crossing = []
    for (a, first), (b, last) in lines:
        if (first.lag - lag) * (last.lag - lag) <= 0:
            place = a + (b - a) * (lag - first.lag) / ((last.lag - first.lag) or 1.0)
            crossing.append((float(np.linalg.norm(place - present)), a, b, first))
    for _, a, b, first in sorted(crossing, key=lambda line: line[0]):
        found = _on_line(at, a, b, first, lag)
        if found is not None:
            return found
    raise UnreachableRhythmError(f"the search for a lag of {lag:g} degrees found no steady rhythm")


def _on_line(at, a: np.ndarray, b: np.ndarray, first: Rhythm, lag: float) -> Rhythm | None:
    """Return the rhythm with the lag between two places, or None if the orbit is lost between."""
    from scipy.optimize import brentq

    seen = [first]

    def off(fraction: float) -> float:
        found = at(a + fraction * (b - a), seen[-1])
        if found is None:
            raise RhythmSearchError
        seen.append(found)
        return found.lag - lag

    try:
        fraction = brentq(off, 0.0, 1.0, xtol=1e-5)
    except (RhythmSearchError, ValueError):
        return None
    # Start as the animal does, because the search may have followed another orbit.
    found = at(a + fraction * (b - a))
    reached = found is not None and found.cycle.stable and abs(found.lag - lag) < _TOLERANCE
    return found if reached else None
