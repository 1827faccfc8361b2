"""The rhythm of a Matsuoka network as a periodic orbit: its period, shape and stability.

A state s that comes back to itself after T solves ``flow(s, T) = s``. The flow does not care where
on the orbit s lies, so one number is fixed: the output of the first oscillator, which is set to the
mean of its swing. Newton's method (`optimistix.root_find`) on the 4 o + 1 unknowns starts from a
simulation that has settled (shooting, e.g. Guckenheimer & Meloon 2000).

The derivative of the flow over one period, the monodromy matrix, says what becomes of a small push:
its eigenvalues are the Floquet multipliers. One of them is 1, a push along the orbit, which only
shifts the phase. The others say by which factor what is left of a push shrinks in each period; if
one is larger than 1 the rhythm is not stable.

All is done in float64.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jax.flatten_util import ravel_pytree
from jax.typing import ArrayLike
from jaxtyping import Array, Complex, Float

from evo_cpg.control.matsuoka import (
    MatsuokaNetwork,
    MatsuokaState,
    initial_state,
    output,
    runge_kutta_step,
    sub_network,
)

# Runge-Kutta steps in a period. The period is then within 4e-7 of that with eight times as many
# (nine joints, b from 1.5 to 10).
STEPS = 1000

# How long the network settles before the period is looked for, in units of the slower time
# constant, and as how few crossings of its level a signal counts as at rest.
_SETTLING, _FEWEST_CROSSINGS = 200.0, 4

# A rhythm whose output swings by less than this share of the largest drive is none.
_LEAST_SWING = 1e-3

# States closer than this share of the swing are taken for the same, until Newton's method tells.
_SAME = 0.01

# Of Newton's method, which takes 3 to 6 from a settled state.
_NEWTON = 15

# An orbit is closed if no number of the state misses itself by more.
CLOSED = 1e-6

# The multiplier of a push along the orbit is 1 but for the error of the steps.
_NEUTRAL = 1e-2


class NoRhythmError(ValueError):
    """The network comes to rest, or never repeats itself."""


class LimitCycle(NamedTuple):
    """A periodic orbit.

    Attributes:
        oscillators: which of the network's it is of.
        period: s.
        states: along the orbit, every ``period / STEPS``; extensors first, ``(2, o, STEPS)``.
        multipliers: Floquet multipliers without the neutral one, largest magnitude first.
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
        """Hz."""
        return 1.0 / self.period

    @property
    def stable(self) -> bool:
        """Whether pushes die away."""
        return bool(np.abs(self.multipliers[0]) < 1)

    @property
    def recovery_time(self) -> float:
        """After which what is left of the slowest push has shrunk to 1/e, s; inf if unstable."""
        size = np.abs(self.multipliers[0])
        return float(-self.period / np.log(size)) if size < 1 else np.inf

    @property
    def outputs(self) -> Float[np.ndarray, "o t"]:
        """Motor signals along the orbit, in units of the tonic input."""
        return np.asarray(output(self.states))

    @property
    def amplitude(self) -> Float[np.ndarray, " o"]:
        """Half of what each signal swings by."""
        return np.ptp(self.outputs, axis=1) / 2

    @property
    def lag(self) -> Float[np.ndarray, " gaps"]:
        """Of each oscillator's fundamental behind the one before it, degrees from -180 to 180."""
        return self.lags(self.oscillators)[1:]

    def lags(self, order: Sequence[int]) -> Float[np.ndarray, " n"]:
        """Likewise in another order, the first behind the last, as around a ring.

        Args:
            order: some of `oscillators`.
        """
        component = np.fft.rfft(self.outputs, axis=1)[:, 1]
        component = component[[self.oscillators.index(i) for i in order]]
        return np.rad2deg(np.angle(np.roll(component, 1) / component))


def parts(network: MatsuokaNetwork) -> list[tuple[int, ...]]:
    """Oscillators that are joined to each other, directly or not, part by part.

    Axes that do not inhibit each other have rhythms of their own, each with a phase of its own.
    """
    joined = (
        (network.matrix != 0)
        | (network.matrix.T != 0)
        | np.eye(network.oscillator_count, dtype=bool)
    )
    for _ in range(network.oscillator_count.bit_length()):
        joined = joined @ joined
    return list(dict.fromkeys(tuple(map(int, np.flatnonzero(row))) for row in joined))


def limit_cycle(
    network: MatsuokaNetwork,
    tonic_input: Float[np.ndarray, "2 o"],
    adaptation_gain: Float[np.ndarray, " o"],
    oscillators: tuple[int, ...] | None = None,
) -> LimitCycle:
    """The orbit to which one part of a network settles under a constant drive.

    Args:
        network: connections and time constants.
        tonic_input: u of each neuron, extensors first.
        adaptation_gain: b of each oscillator.
        oscillators: the part; the first of `parts` if None.

    Raises:
        NoRhythmError: it does not oscillate, or Newton's method finds no orbit.
    """
    chosen = parts(network)[0] if oscillators is None else oscillators
    part = sub_network(network, chosen)
    with jax.enable_x64(True):
        drive = jnp.asarray(np.asarray(tonic_input, float)[:, list(chosen)])
        drive = drive + network.sensory_feedback
        gain = jnp.asarray(np.asarray(adaptation_gain, float)[list(chosen)])
        start, period, level = settle(part, drive, gain)
        state, found, mismatch = find_orbit(part, drive, gain, level, start, jnp.asarray(period))
        if not float(mismatch) < CLOSED or not 0.5 * period < float(found) < 2 * period:
            raise NoRhythmError(
                f"no orbit near a period of {period:.3g} s: the rhythm does not repeat"
            )
        return _describe(part, drive, gain, chosen, state, float(found))


@functools.partial(jax.jit, static_argnames="steps")
def path(
    network: MatsuokaNetwork,
    drive: Array,
    gain: Array,
    state: MatsuokaState,
    length: Array,
    steps: int,
) -> tuple[MatsuokaState, MatsuokaState]:
    """The state after some seconds, and those at the beginning of every step.

    Args:
        network: connections and time constants.
        drive: tonic input and sensory feedback of each neuron.
        gain: b of each oscillator.
        state: at the start.
        length: s.
        steps: into how many Runge-Kutta steps the length is divided.
    """

    def onward(state: MatsuokaState, _: None) -> tuple[MatsuokaState, MatsuokaState]:
        return runge_kutta_step(network, length / steps, state, drive, gain), state

    return jax.lax.scan(onward, state, length=steps)


def settle(
    network: MatsuokaNetwork, drive: Array, gain: Array
) -> tuple[MatsuokaState, float, float]:
    """A state on the orbit, about how long it takes to come back, and the first signal's level.

    Args:
        network: connections and time constants.
        drive: tonic input and sensory feedback of each neuron.
        gain: b of each oscillator.

    Raises:
        NoRhythmError: it comes to rest, or never repeats itself.
    """
    if not np.abs(drive).max() > 0:
        raise NoRhythmError("nothing drives the network: tonic input and feedback are 0")
    rest = initial_state(network, dtype=jnp.float64)
    slow = max(network.rise_time, network.adaptation_time)
    h = min(network.rise_time, network.adaptation_time) / 20
    steps = round(_SETTLING * slow / h)
    state, _ = path(network, drive, gain, rest, jnp.asarray(steps * h), steps)
    state, states = path(network, drive, gain, state, jnp.asarray(steps * h), steps)
    signal = np.asarray(output(jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1), states)))[0]
    low, high = signal.min(), signal.max()
    level = (low + high) / 2
    rising = np.flatnonzero((signal[:-1] < level) & (signal[1:] >= level))
    if high - low < _LEAST_SWING * float(np.abs(drive).max()) or len(rising) <= _FEWEST_CROSSINGS:
        raise NoRhythmError(
            f"the network comes to rest (its output swings by {high - low:.2g}); it oscillates "
            "where 1 + T_r / T_a < a < 1 + b for its effective inhibition a (docs/models/"
            "controller.md)"
        )
    # Where the signal meets its level, between two samples.
    share = (level - signal[rising]) / (signal[rising + 1] - signal[rising])
    crossings = jax.tree.map(
        lambda x: x[rising] + share[:, None, None] * (x[rising + 1] - x[rising]), states
    )
    # One signal may cross its level more than once in a period: the state tells which crossing.
    places = np.concatenate(
        [np.asarray(x).reshape(len(rising), -1) for x in jax.tree.leaves(crossings)], 1
    )
    back = np.abs(places[1:] - places[0]).max(1) < _SAME * np.ptp(places) + _SAME * (high - low)
    if not back.any():
        raise NoRhythmError("the rhythm does not repeat itself: no crossing is like the first")
    again = int(back.argmax()) + 1
    first = jax.tree.map(lambda x: x[0], crossings)
    length = (rising[again] + share[again] - rising[0] - share[0]) * h
    return first, float(length), float(level)


@jax.jit
def find_orbit(
    network: MatsuokaNetwork,
    drive: Array,
    gain: Array,
    level: ArrayLike,
    start: MatsuokaState,
    period: Array,
) -> tuple[MatsuokaState, Array, Array]:
    """Newton's method for a state that comes back to itself.

    The result has derivatives with respect to all arguments but the guesses, by the implicit
    function theorem.

    Args:
        network: connections and time constants.
        drive: tonic input and sensory feedback of each neuron.
        gain: b of each oscillator.
        level: what the first oscillator's output is at the state that is looked for.
        start: a guess of it.
        period: a guess, s.

    Returns:
        The state, the period, and by how much the orbit fails to close (nan where Newton's
        method fails): it is one if that is less than `CLOSED`.
    """
    begin, unflatten = ravel_pytree((start, period))

    def gap(unknown: Array, known: tuple[MatsuokaNetwork, Array, Array]) -> Array:
        state, length = unflatten(unknown)
        end, _ = path(*known, state, length, STEPS)
        away, _ = ravel_pytree(jax.tree.map(jnp.subtract, end, state))
        return jnp.append(away, output(state)[0] - level)

    known = (network, drive, gain)
    fixed = jax.lax.stop_gradient(known)
    solver = optimistix.Newton(rtol=1e-9, atol=1e-9)
    guess = jax.lax.stop_gradient(begin)
    found = optimistix.root_find(gap, solver, guess, fixed, max_steps=_NEWTON, throw=False).value
    # A last step of Newton's, in which only the gap has derivatives: those of the root. They are
    # what root_find would give by itself, which raises an error where there is no root.
    found = jax.lax.stop_gradient(found)
    left = gap(found, known)
    state, length = unflatten(found - jnp.linalg.solve(jax.jacfwd(gap)(found, fixed), left))
    return state, length, jnp.abs(left).max()


@jax.jit
def _monodromy(
    network: MatsuokaNetwork, drive: Array, gain: Array, state: MatsuokaState, period: Array
) -> Array:
    """Derivative of the state after a period with respect to that before."""
    flat, unflatten = ravel_pytree(state)

    def flow(flat: Array) -> Array:
        end, _ = path(network, drive, gain, unflatten(flat), period, STEPS)
        return ravel_pytree(end)[0]

    return jax.jacfwd(flow)(flat)


def _describe(
    network: MatsuokaNetwork,
    drive: Array,
    gain: Array,
    chosen: tuple[int, ...],
    state: MatsuokaState,
    period: float,
) -> LimitCycle:
    monodromy = np.asarray(_monodromy(network, drive, gain, state, jnp.asarray(period)))
    multipliers = np.linalg.eigvals(monodromy)
    neutral = int(np.abs(multipliers - 1).argmin())
    if abs(multipliers[neutral] - 1) > _NEUTRAL:
        raise NoRhythmError("the orbit has no neutral direction: it is not one of the flow")
    others = np.delete(multipliers, neutral)
    _, states = path(network, drive, gain, state, jnp.asarray(period), STEPS)
    states = jax.tree.map(lambda x: np.moveaxis(np.asarray(x), 0, -1), states)
    order = np.argsort(-np.abs(others), kind="stable")
    return LimitCycle(chosen, period, states, others[order].astype(complex), monodromy)
