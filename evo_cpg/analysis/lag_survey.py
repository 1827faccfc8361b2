"""Range of lags that a chain of oscillators can have, by simulation of networks within bounds.

All networks are simulated side by side. The lag is a continuous function of adaptation gain and
couplings, so every lag between the smallest and the largest found is reachable.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.analysis.couplings import GAINS, RATIOS, STRONGER, Problem, network_at
from evo_cpg.analysis.gait import fourier_component
from evo_cpg.analysis.rhythm import frequency_of, upward_crossings
from evo_cpg.control.matsuoka import MatsuokaState, initial_state, output, runge_kutta_step

# Nodes of the survey between the bounds, in addition to the present values.
_NODES = (np.geomspace(*GAINS, 5), np.geomspace(*STRONGER, 3), np.geomspace(*RATIOS, 4))

# Runge-Kutta steps in the shorter time constant, settling and recording time in units of the longer
# time constant, and steps between samples. Lags of the survey are accurate to 0.05 degrees.
_STEPS_PER_TIME_CONSTANT, _SETTLING, _WATCHED, _EVERY = 8, 200, 100, 2

# Largest product of step and rate of a potential. Runge-Kutta steps are stable up to 2.8.
_STABLE = 1.0

# Swing, as a fraction of the neurons' even firing rate, below which an oscillator rests.
_LEAST_SWING = 5e-3

# Largest difference of the two halves of the recording in a steady rhythm: lag in degrees, and
# relative frequency. Each half needs this number of periods.
_STEADY_LAG, _STEADY_FREQUENCY, _FEWEST = 0.1, 1e-3, 3


class UnreachableRhythmError(ValueError):
    """No settings within the bounds give the reference rhythm."""


def survey(problem: Problem) -> tuple[tuple[np.ndarray, ...], Float[np.ndarray, "b s r"]]:
    """Simulate the chain's network at all nodes, and measure its lags.

    Returns:
        Values of b, s and r, and the mean lag along the chain for each of their combinations,
        degrees. NaN without a steady rhythm.
    """
    nodes = tuple(
        np.exp(np.unique(np.append(np.clip(np.log(values), low, high), now)))
        for values, low, high, now in zip(_NODES, *problem.bounds, problem.present, strict=True)
    )
    points = np.log(np.stack(np.meshgrid(*nodes, indexing="ij"), -1))
    times = problem.template.rise_time, problem.template.adaptation_time
    # The rate of a potential grows with its inhibition, so strong weights need smaller steps.
    strongest = 1 + max(_inhibition(problem, x) for x in points.reshape(-1, 3))
    h = min(min(times) / _STEPS_PER_TIME_CONSTANT, _STABLE * problem.template.rise_time / strongest)
    signals = np.asarray(_watch(problem, jnp.asarray(points.reshape(-1, 3)), h, max(times)))
    lags = np.array(
        [
            _steady_lag(problem, one, _EVERY * h, np.exp(x[0]))
            for one, x in zip(signals, points.reshape(-1, 3), strict=True)
        ]
    )
    return nodes, lags.reshape(points.shape[:-1])


def starting_place(
    problem: Problem, nodes: tuple[np.ndarray, ...], lags: Float[np.ndarray, "b s r"], lag: float
) -> Float[np.ndarray, "3"]:
    """Return the point nearest to the present settings that has about the given lag.

    Candidates are interpolated on the lines between neighbouring nodes of the survey.

    Raises:
        UnreachableRhythmError: the lag is outside the range of all lags, or no network oscillates.
    """
    if np.isnan(lags).all():
        raise UnreachableRhythmError(
            "there is no steady rhythm at any of the gains and couplings tried. pair_weight or "
            "the constants prevent oscillation"
        )
    # Round the range of lags inwards, because the survey is not exact.
    low, high = np.ceil(np.nanmin(lags) * 10) / 10, np.floor(np.nanmax(lags) * 10) / 10
    if not low <= lag <= high:
        raise UnreachableRhythmError(_refusal(problem, lag, low, high))
    points = np.log(np.stack(np.meshgrid(*nodes, indexing="ij"), -1))
    nearest = np.unravel_index(np.nanargmin(np.abs(lags - lag)), lags.shape)
    places = []
    for axis in range(3):
        ends = [np.moveaxis(lags, axis, 0)[cut] for cut in (slice(None, -1), slice(1, None))]
        a, b = (np.moveaxis(points, axis, 0)[cut] for cut in (slice(None, -1), slice(1, None)))
        brackets = (ends[0] - lag) * (ends[1] - lag) <= 0
        ratio = ((lag - ends[0]) / np.where(ends[1] == ends[0], 1, ends[1] - ends[0]))[..., None]
        places.append((a + ratio * (b - a))[brackets])
    # Nodes without a rhythm may leave no line that crosses the lag.
    found = np.concatenate(places) if any(map(len, places)) else points[nearest][None]
    return found[np.square(found - problem.present).sum(-1).argmin()]


@functools.partial(jax.jit, static_argnames=("h", "unit"))
def _watch(problem: Problem, points: Array, h: float, unit: float) -> Array:
    """Return outputs of the chain at every second step, after settling: ``(points, time, chain)``.

    Args:
        problem: problem of the chain.
        points: values of the unknowns.
        h: length of a step, s.
        unit: longer of the two time constants, s.
    """

    def signals(x: Array) -> Array:
        network, gain = network_at(problem, x)
        onward = functools.partial(
            runge_kutta_step, network, h, drive=jnp.asarray(problem.drive), adaptation_gain=gain
        )

        def several(state: MatsuokaState, _: None) -> tuple[MatsuokaState, Array]:
            state = functools.reduce(lambda state, _: onward(state), range(_EVERY), state)
            return state, output(state)[np.array(problem.chain)]

        state = initial_state(network, dtype=jnp.float64)
        state = jax.lax.fori_loop(
            0, round(_SETTLING * unit / h), lambda _, state: onward(state), state
        )
        return jax.lax.scan(several, state, length=round(_WATCHED * unit / h / _EVERY))[1]

    return jax.vmap(signals)(points)


def _inhibition(problem: Problem, x: np.ndarray) -> float:
    """Return the largest sum of absolute weights on one neuron."""
    network, _ = network_at(problem, jnp.asarray(x))
    return float(np.abs(network.matrix).sum(1).max())


def _steady_lag(problem: Problem, signals: np.ndarray, step: float, gain: float) -> float:
    """Return the mean lag, degrees, or NaN without a steady rhythm."""
    # The rate of evenly firing neurons is about the drive divided by 1 + b.
    least = _LEAST_SWING * float(np.abs(problem.drive).max()) / (1 + gain)
    seen = []
    for half in np.array_split(signals[: len(signals) // 2 * 2], 2):
        one = half[:, 0] - half[:, 0].mean()
        starts = upward_crossings(one)
        if len(starts) <= _FEWEST or np.ptp(half, axis=0).min() < least:
            return np.nan
        frequency = frequency_of(starts) / step
        component = fourier_component(half, step, frequency)
        turns = problem.sides * component[:-1] / component[1:]
        seen.append((np.rad2deg(np.angle(turns)).mean(), frequency))
    (first, before), (last, after) = seen
    steady = abs(first - last) < _STEADY_LAG and abs(after / before - 1) < _STEADY_FREQUENCY
    return float(last) if steady else np.nan


def _refusal(problem: Problem, lag: float, low: float, high: float) -> str:
    gains = "--".join(f"{gain:g}" for gain in np.unique(np.exp(problem.bounds[:, 0]).round(9)))
    strong, weak = ("parent_weight", "child_weight")[:: 1 if problem.head_to_tail else -1]
    direction = "from head to tail" if problem.head_to_tail else "from tail to head (negative lags)"
    return (
        f"a lag of {lag:g} degrees is out of reach. Allowed {direction}: {low:.1f} to {high:.1f} "
        f"(with b = {gains}, {strong} = {STRONGER[0]:g}--{STRONGER[1]:g} and {weak} = "
        f"{RATIOS[0]:g}--{RATIOS[1]:g} times that)"
    )
