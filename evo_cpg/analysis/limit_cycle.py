"""Rhythm of a Matsuoka network as a periodic orbit: period, shape and stability.

The search for a rhythm simulates the network, and has three distinct outcomes:

| outcome | condition |
|---|---|
| a `LimitCycle` | a simulated state repeats after a period, and the simulation stays near it |
| `NoRhythmError` | the simulation reaches a stable equilibrium and cannot leave it |
| `RhythmSearchError` | neither within the longest simulation, so nothing is known |

A state s with period T solves ``flow(s, T) = s``. Any state on the orbit is a solution, so one
number is fixed: s lies in the plane through the first guess, perpendicular to the flow there.
Newton's method solves for the 4 o + 1 unknowns (shooting, e.g. Guckenheimer & Meloon 2000). The
guess is a simulated state that nearly repeats.

The equations are linear as long as no neuron begins or ceases to fire: ``ds/dt = A s + c``. So the
monodromy matrix, the derivative of the flow over one period, is the product of ``exp(A h)`` over
these pieces. There is no term for the changes, because the field is continuous. The eigenvalues of
the matrix are the Floquet multipliers. One multiplier is 1: a perturbation along the orbit only
shifts the phase. The others are the factors by which perturbations change in each period. A rhythm
with a magnitude above 1 is unstable.

Time is in units of ``T_r + T_a`` and states are in units of the largest drive, so that tolerances
hold for every drive and every time scale. `scipy.integrate.solve_ivp` simulates with LSODA, because
it also integrates stiff networks. The orbit is that of the open loop, because feedback of the
senses (`evo_cpg.control.feedback`) is left out.
"""

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Complex, Float

from evo_cpg.control.matsuoka import MatsuokaNetwork, parts, sub_network

# Samples along an orbit.
STEPS = 1000

# Relative tolerance of the simulation while it settles and along an orbit, and absolute tolerance
# as a multiple.
_SETTLING, _ON_ORBIT, _ABSOLUTE = 1e-6, 1e-8, 1e-2

# Duration of the first simulated interval, growth of each further one, and duration of all.
_STRETCH, _LONGER, _LONGEST = 15.0, 1.5, 800.0

# Distance of a repeated state from an earlier one, as a fraction of the swing.
_NEAR = 0.02

# Largest number of Newton steps (3 to 6 from a settled state), and largest change of state and
# period, as a fraction of swing and period. A larger change may lead to another orbit.
_NEWTON, _MOVED = 12, 0.1

# Factor by which a gap must shrink in one Newton step; otherwise the derivative is computed anew.
_SHRINKS = 0.3

# Gap of a closed orbit, as a fraction of its swing.
_CLOSED = 1e-6

# Largest relative error of the monodromy matrix along the flow, whose direction it should preserve.
# Multipliers have this accuracy.
_NEUTRAL = 1e-3

# Number of intervals that the simulation must stay on an unstable orbit.
_STAYS = 3

# Swing, as a fraction of the widest swing, below which an oscillator has no phase but rounding.
_FAINT = 1e-6

# Largest relative error of the sum of modes that represents a distance from an equilibrium.
_REBUILT = 1e-6

# Times at which `resting` judges a network, and the largest swing of an oscillator at rest, as a
# fraction of its neurons' firing.
_JUDGED, _LEAST_SWING = (25.0, 80.0), 1e-3


class NoRhythmError(ValueError):
    """The simulation has shown that the network comes to rest."""


class RhythmSearchError(ValueError):
    """The search failed: it found neither a rhythm nor rest."""


class LimitCycle(NamedTuple):
    """A periodic orbit.

    Attributes:
        oscillators: oscillators of the network with this rhythm.
        period: period, s.
        states: potentials and adaptations every ``period / STEPS``, extensors first.
        multipliers: Floquet multipliers without the neutral one, largest magnitude first. NaN if
            they could not be computed, as for a rhythm with long pauses.
        monodromy: derivative of the flow over one period at the first state.
    """

    oscillators: tuple[int, ...]
    period: float
    states: Float[np.ndarray, "2 2 o t"]
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
        """Time in which the slowest perturbation decays to 1/e, s. Infinity if unstable."""
        size = np.abs(self.multipliers[0])
        with np.errstate(divide="ignore"):
            return np.inf if size >= 1 else float(-self.period / np.log(size))

    @property
    def outputs(self) -> Float[np.ndarray, "o t"]:
        """Motor signals along the orbit, in the unit of the tonic input."""
        extensor, flexor = np.maximum(self.states[0], 0.0)
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

        Returns:
            Lags, degrees. NaN if one of the two oscillators rests.
        """
        component = np.fft.rfft(self.outputs, axis=1)[:, 1]
        component[self.amplitude < _FAINT * self.amplitude.max()] = np.nan
        component = component[[self.oscillators.index(i) for i in order]]
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.rad2deg(np.angle(np.roll(component, 1) / component))


class Equilibrium(NamedTuple):
    """An equilibrium.

    Attributes:
        state: the equilibrium.
        rates: eigenvalues there, largest real part first.
        shapes: modes that add up to the distance from the equilibrium, in the order of ``rates``.
        margin: distance of each potential from zero, infinite for neurons that never fire.
        firing: True for neurons that fire.
    """

    state: Float[np.ndarray, " k"]
    rates: Complex[np.ndarray, " k"]
    shapes: Complex[np.ndarray, "k k"]
    margin: Float[np.ndarray, " n"]
    firing: Bool[np.ndarray, " n"]


class Flow:
    """A part of a network under a constant drive.

    States are vectors: potentials of the extensors, of the flexors, then their adaptations. Times
    are in units of ``T_r + T_a``, and states in units of ``scale``.

    Args:
        part: connections and time constants.
        tonic_input: u of each neuron, extensors first.
        gain: b of each oscillator.
    """

    def __init__(self, part: MatsuokaNetwork, tonic_input: np.ndarray, gain: np.ndarray):
        rise, adaptation = float(part.rise_time), float(part.adaptation_time)
        drive = np.asarray(tonic_input, float) + float(part.constant_input)
        self.unit, self.ratio = rise + adaptation, rise / adaptation
        self.scale = float(np.abs(drive).max()) or 1.0
        self.neurons = n = drive.size
        self.driven = drive.ravel() > 0
        self.start = np.append(np.ravel(part.initial_potential) / self.scale, np.zeros(n))
        other, own = np.maximum(part.matrix, 0.0), np.maximum(-part.matrix, 0.0)
        inhibition = np.block([[own, other], [other, own]])
        gains, one, none = np.diag(np.tile(gain, 2)), np.eye(n), np.zeros((n, n))
        speed = self.unit / np.repeat([rise, adaptation], n)
        # ds/dt = by_firing @ y + by_state @ s + constant, with y = max(0, x).
        self._by_firing = speed[:, None] * np.vstack([-inhibition, one])
        self._by_state = speed[:, None] * np.block([[-one, -gains], [none, -one]])
        self._constant = speed * np.append(drive.ravel() / self.scale, np.zeros(n))

    def derivative(self, time: float, state: np.ndarray) -> np.ndarray:
        """Return the derivative of a state (Iwadate 2010, eqs. 4-6)."""
        del time
        firing = np.maximum(state[: self.neurons], 0.0)
        return self._by_firing @ firing + self._by_state @ state + self._constant

    def matrix(self, time: float, state: np.ndarray) -> np.ndarray:
        """Return A, the derivative of `derivative` while the same neurons fire."""
        del time
        matrix = self._by_state.copy()
        matrix[:, : self.neurons] += self._by_firing * (state[: self.neurons] > 0)
        return matrix

    def run(self, state: np.ndarray, duration: float, tolerance: float) -> Any:
        """Simulate, with an event whenever a neuron begins or ceases to fire."""
        from scipy.integrate import solve_ivp

        events = [lambda time, state, i=i: state[i] for i in range(self.neurons)]
        return solve_ivp(
            self.derivative,
            (0.0, duration),
            state,
            method="LSODA",
            jac=self.matrix,
            events=events,
            dense_output=True,
            rtol=tolerance,
            atol=_ABSOLUTE * tolerance,
        )

    def monodromy(self, run: Any) -> Float[np.ndarray, "k k"]:
        """Return the derivative of the last state of a run with respect to the first.

        It is not finite if the run grows beyond the largest number.
        """
        from scipy.linalg import expm

        times = np.unique(np.concatenate([*run.t_events, run.t[[0, -1]]]))
        product = np.eye(len(run.y))
        with np.errstate(over="ignore", invalid="ignore"):
            for begin, end in itertools.pairwise(times):
                middle = run.sol((begin + end) / 2)
                product = expm(self.matrix(0.0, middle) * (end - begin)) @ product
        return product

    def equilibrium(self, state: np.ndarray) -> Equilibrium | None:
        """Return the equilibrium in which the neurons fire that fire in a state, if there is one.

        None also if nearly parallel modes leave the distance from it undetermined.
        """
        matrix, firing = self.matrix(0.0, state), state[: self.neurons] > 0
        try:
            still = np.linalg.solve(matrix, -self._constant)
            rates, vectors = np.linalg.eig(matrix)
            shapes = vectors * np.linalg.solve(vectors, state - still)
        except np.linalg.LinAlgError:
            return None
        x, distance = still[: self.neurons], state - still
        if (np.where(firing, x, -x)[self.driven] <= 0).any():
            return None
        if not np.abs(shapes.sum(1) - distance).max() <= _REBUILT * np.abs(distance).max() + 1e-12:
            return None
        order = np.argsort(-np.real(rates))
        margin = np.where(self.driven, np.abs(x), np.inf)
        return Equilibrium(still, rates[order].astype(complex), shapes[:, order], margin, firing)

    def decays_to(self, state: np.ndarray) -> Equilibrium | None:
        """Return the equilibrium that a state certainly decays to, or None if this is uncertain.

        Certain: it is stable, and no mode of the distance can bring a potential across zero.
        """
        near = self.equilibrium(state)
        if near is None or not near.rates[0].real < 0:
            return None
        reach = np.abs(near.shapes[: self.neurons]).sum(1)
        return near if (reach < near.margin).all() else None

    def grown(self, state: np.ndarray) -> np.ndarray:
        """Return a later state of growth from an unstable equilibrium, while the same neurons fire.

        Without this step, slow growth near the onset of oscillation would take the whole search.
        """
        near = self.equilibrium(state)
        if near is None or not near.rates[0].real > 0:
            return state
        sizes, time = np.abs(near.shapes[: self.neurons]), 0.0
        for length in 2.0 ** np.arange(20, 0, -1):
            growth = np.exp(np.minimum(np.real(near.rates) * (time + length), 700.0))
            if (sizes @ growth < near.margin).all():
                time += float(length)
        return near.state + np.real(near.shapes @ np.exp(near.rates * time))


class Orbit(NamedTuple):
    """A closed orbit in the units of a flow: its state, period, simulation, and monodromy."""

    state: Float[np.ndarray, " k"]
    period: float
    run: Any
    monodromy: Float[np.ndarray, "k k"]

    def multipliers(self, flow: Flow) -> Complex[np.ndarray, " m"]:
        """Return the Floquet multipliers, without the neutral one along the flow."""
        along = flow.derivative(0.0, self.state)
        across = np.linalg.qr(along[:, None], mode="complete")[0][:, 1:]
        values = np.linalg.eigvals(across.T @ self.monodromy @ across)
        return values[np.argsort(-np.abs(values), kind="stable")].astype(complex)


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
    every = list(chosen)
    tonic_input, gains = np.asarray(tonic_input, float), np.asarray(adaptation_gain, float)
    flow = Flow(sub_network(network, chosen), tonic_input[:, every], gains[every])
    orbit = settle(flow)
    samples = orbit.run.sol(np.arange(STEPS) * orbit.period / STEPS)
    along = flow.derivative(0.0, orbit.state)
    error = np.linalg.norm(orbit.monodromy @ along - along) / np.linalg.norm(along)
    multipliers = orbit.multipliers(flow)
    if not error < _NEUTRAL:
        multipliers = np.full_like(multipliers, np.nan)
    states = flow.scale * samples.reshape(2, 2, -1, STEPS)
    return LimitCycle(chosen, orbit.period * flow.unit, states, multipliers, orbit.monodromy)


def settle(flow: Flow) -> Orbit:
    """Simulate from the start until the state is on an orbit, and return the orbit.

    Raises:
        NoRhythmError: the simulation leads to rest.
        RhythmSearchError: the simulation found neither rest nor an orbit.
    """
    if not flow.driven.any():
        raise NoRhythmError(
            "nothing drives the network, so it comes to rest: the sum of tonic input and sensory "
            "feedback is at most 0 for every neuron"
        )
    state, time, stretch, stayed = flow.start, 0.0, _STRETCH, 0
    swing = np.nan
    while time < _LONGEST:
        run = flow.run(state, stretch, _SETTLING)
        state, time, stretch = run.y[:, -1], time + stretch, _LONGER * stretch
        rest = flow.decays_to(state)
        if rest is not None:
            how = "Some neurons silence others. Try a smaller pair_weight or a larger b"
            if rest.firing.all():
                how = "All neurons fire evenly. Couple the oscillators, or increase pair_weight"
            raise NoRhythmError(
                f"the network comes to rest: after {time * flow.unit:.3g} s it is near a stable "
                "equilibrium (a perturbation decays within "
                f"{-flow.unit / rest.rates[0].real:.3g} s). {how}. An isolated oscillator needs a "
                f"pair_weight between {1 + flow.ratio:.3g} and 1 + b"
            )
        swing = float(np.ptp(run.y[:, len(run.t) // 2 :], axis=1).max())
        # The last start of firing with a similar one before it, and the time between them.
        guess, latest = None, -np.inf
        for neuron, (times, states) in enumerate(zip(run.t_events, run.y_events, strict=True)):
            starts = [i for i, s in enumerate(states) if flow.derivative(0.0, s)[neuron] > 0]
            for i in reversed(starts[:-1]):
                last = starts[-1]
                if np.abs(states[last] - states[i]).max() <= _NEAR * swing:
                    if times[last] > latest:
                        guess, latest = (states[last], float(times[last] - times[i])), times[last]
                    break
        found = None if guess is None else close(flow, *guess)
        stayed = 0 if found is None else stayed + 1
        if found is not None:
            stable = np.abs(found.multipliers(flow)).max(initial=0.0) < 1
            if stable or stayed == _STAYS:
                return found
        state = flow.grown(state)
    raise RhythmSearchError(
        "the search failed, so nothing is known about the network: in "
        f"{time * flow.unit:.3g} s of simulation it neither came to rest nor repeated itself. Its "
        f"state still moves by {swing * flow.scale:.3g}. Try another --gain or a pair_weight "
        "farther from a border of oscillation"
    )


def close(flow: Flow, state: Float[np.ndarray, " k"], period: float) -> Orbit | None:
    """Find an orbit near a guess of state and period by Newton's method, or return None."""
    first, about, swing, before = state, period, np.nan, np.inf
    across = flow.derivative(0.0, first)
    across = across / np.linalg.norm(across)
    slope = np.zeros((len(state) + 1, len(state) + 1))
    slope[-1, :-1] = across
    for number in range(_NEWTON):
        run = flow.run(state, period, _ON_ORBIT)
        gap = run.y[:, -1] - state
        if not number:
            swing = float(np.ptp(run.y, axis=1).max()) or float(np.abs(state).max())
        size = np.abs(gap).max()
        if size < _CLOSED * swing:
            return Orbit(state, period, run, flow.monodromy(run))
        # The derivative takes the longest, so it is kept while the gap shrinks with it.
        if not number or size > _SHRINKS * before:
            slope[:-1, :-1] = flow.monodromy(run) - np.eye(len(state))
        if not np.isfinite(slope).all():
            return None
        slope[:-1, -1] = flow.derivative(0.0, run.y[:, -1])
        try:
            change = np.linalg.solve(slope, np.append(-gap, across @ (first - state)))
        except np.linalg.LinAlgError:
            return None
        state, period, before = state + change[:-1], period + float(change[-1]), size
        strayed = np.abs(state - first).max() > _MOVED * swing
        if strayed or not abs(period - about) < _MOVED * about:
            return None
    return None


def resting(
    network: MatsuokaNetwork, tonic_input: float, min_gain: float, max_gain: float
) -> list[int]:
    """Return the oscillators whose output swings with none of three adaptation gains.

    The gains are the smallest, the middle and the largest b. An oscillator counts if its whole part
    decays to an equilibrium, or if it is still while others of its part swing. This takes a second
    at most, so it can be called before every run.
    """
    rests = np.ones(network.oscillator_count, bool)
    known: dict[bytes, Bool[np.ndarray, " o"]] = {}
    for chosen in parts(network):
        part = sub_network(network, chosen)
        # The axes of a body often form equal networks.
        same = part.matrix.tobytes() + np.asarray(part.initial_potential).tobytes()
        if same not in known:
            known[same] = np.ones(len(chosen), bool)
            for gain in np.linspace(min_gain, max_gain, 3):
                # Most parts swing with the first gain, and need no further check.
                if known[same].any():
                    drive, gains = (
                        np.full((2, len(chosen)), tonic_input),
                        np.full(len(chosen), gain),
                    )
                    known[same] &= _still(Flow(part, drive, gains))
        rests[list(chosen)] = known[same]
    return [int(i) for i in np.flatnonzero(rests)]


def _still(flow: Flow) -> Bool[np.ndarray, " o"]:
    """Return which oscillators do not swing from the start of a network."""
    count = flow.neurons // 2
    if not flow.driven.any():
        return np.ones(count, bool)
    state, before, still = flow.start, 0.0, np.zeros(count, bool)
    for time in _JUDGED:
        run = flow.run(state, time - before, _SETTLING)
        state, before = run.y[:, -1], time
        if flow.decays_to(state) is not None:
            return np.ones(count, bool)
        late = run.t > run.t[-1] / 2
        fired = np.maximum(run.y[: flow.neurons, late].reshape(2, count, -1), 0.0)
        still = np.ptp(fired[0] - fired[1], axis=1) <= _LEAST_SWING * fired.sum(0).max(1)
        if not still.any():
            break
    # If none swings yet, the oscillation may still grow.
    return still & ~still.all()
