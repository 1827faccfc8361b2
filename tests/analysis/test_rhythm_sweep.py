"""Rhythm or rest of many networks, against SciPy's integration of eqs. 4-6."""

import dataclasses
import functools
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import odeint

from creatures import box_chain
from evo_cpg.analysis.limit_cycle import (
    Flow,
    LimitCycle,
    NoRhythmError,
    RhythmSearchError,
    close,
    limit_cycle,
    resting,
)
from evo_cpg.control.couplings import Coupling
from evo_cpg.control.matsuoka import (
    TIME_CONSTANTS,
    CpgSettings,
    MatsuokaNetwork,
    build_network,
    parts,
)
from evo_cpg.creature.tree import build_tree

RISE, ADAPTATION = TIME_CONSTANTS["swapped"]
# Lower bound of the weight a: a pair oscillates if 1 + T_r / T_a < a < 1 + b.
LEAST = 1 + RISE / ADAPTATION


def chain(joints: int = 1, **settings) -> MatsuokaNetwork:
    return build_network(build_tree(box_chain(joints + 1, "z")), CpgSettings(**settings))


def found(network: MatsuokaNetwork, gain: float, drive: np.ndarray | float = 1.0) -> LimitCycle:
    count = network.oscillator_count
    return limit_cycle(network, np.broadcast_to(drive, (2, count)), np.full(count, float(gain)))


def simulated(
    network: MatsuokaNetwork, gain: float, drive: np.ndarray | float, seconds: float, period: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the states of the last two and a quarter periods before ``seconds``, and times."""
    count = network.oscillator_count
    other, own = np.maximum(network.matrix, 0.0), np.maximum(-network.matrix, 0.0)
    drive = np.broadcast_to(drive, (2, count)) + network.constant_input
    rise, adaptation = network.rise_time, network.adaptation_time

    def change(numbers: np.ndarray, _: float) -> np.ndarray:
        x, z = numbers.reshape(2, 2, count)
        firing = np.maximum(x, 0.0)
        inhibition = firing[::-1] @ other.T + firing @ own.T
        rates = (drive - x - inhibition - gain * z) / rise, (firing - z) / adaptation
        return np.ravel(rates)

    start = np.concatenate([np.ravel(network.initial_potential), np.zeros(2 * count)])
    times = np.append(0.0, np.linspace(seconds - 2.25 * period, seconds, 9001))
    size = float(np.abs(drive).max())
    states = odeint(change, start, times, rtol=1e-9, atol=1e-12 * size, mxstep=1_000_000)
    return states[1:], times[1:]


def outputs(states: np.ndarray) -> np.ndarray:
    extensor, flexor = np.split(np.maximum(states[:, : states.shape[1] // 2], 0.0), 2, axis=1)
    return extensor - flexor


def is_what_simulation_shows(
    network: MatsuokaNetwork, gain: float, drive: np.ndarray | float = 1.0
) -> str:
    """Compare search and simulation, and return the outcome, ``rhythm`` or ``rest``."""
    unit = network.rise_time + network.adaptation_time
    size = float(np.max(np.abs(np.asarray(drive) + network.constant_input)))
    try:
        cycle = found(network, gain, drive)
    except NoRhythmError:
        states, _ = simulated(network, gain, drive, 400 * unit, 40 * unit)
        assert np.ptp(states, axis=0).max() < 1e-3 * size / (1 + gain)
        return "rest"
    # Unknown multipliers belong to perturbations that decay far within a period.
    fading = np.nan_to_num(-1 / np.log(np.abs(cycle.multipliers[0])))
    seconds = 40 * unit + (10 + 10 * fading) * cycle.period
    states, times = simulated(network, gain, drive, seconds, cycle.period)
    # The state repeats after a period, and not before.
    swing = np.ptp(states, axis=0).max()
    apart = np.abs(states - states[0]).max(1) / swing
    step = times[1] - times[0]
    back = round(cycle.period / step)
    moved = np.abs(np.diff(states, axis=0)).max() / swing
    assert apart[back] < 1e-3 + moved
    assert apart[back // 20 : back - back // 20].min() > 2 * apart[back]
    np.testing.assert_allclose(
        cycle.amplitude, np.ptp(outputs(states), axis=0) / 2, rtol=5e-3, atol=1e-4 * swing
    )
    return "rhythm"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("weight", "gain"),
    [
        (3.0, 4.0),
        (50.0, 60.0),
        (LEAST + 0.02, 4),
        (3.0, 2.5),
        (4.0, 3.5),
        (3.0, 2.01),
        (1.5, 2.0),
        (2.0, 1e3),
        (1e4, 1.1e4),
    ],
)
def test_a_pair_within_the_bounds_oscillates(weight, gain):
    assert is_what_simulation_shows(chain(pair_weight=weight), gain) == "rhythm"


@pytest.mark.parametrize(("weight", "gain"), [(3.0, 1.9), (3.0, 1.99), (LEAST - 0.02, 4.0), (0, 4)])
def test_a_pair_outside_the_bounds_rests(weight, gain):
    assert is_what_simulation_shows(chain(pair_weight=weight), gain) == "rest"


@functools.cache
def unscaled(constants):
    """Return the rhythm of a pair at unit drive and time scale."""
    return found(chain(pair_weight=12.0, constants=constants), 20.0)


@pytest.mark.slow
@pytest.mark.parametrize("constants", ["swapped", "as_printed"])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("drive", [1e-30, 1.0, 1e30])
def test_drive_and_time_scale_only_scale_the_rhythm(constants, scale, drive):
    """The period scales with the time scale, and the amplitude with the drive."""
    plain = unscaled(constants)
    settings = {"time_scale": scale, "max_tonic_input": drive}
    cycle = found(chain(pair_weight=12.0, constants=constants, **settings), 20.0, drive)
    assert cycle.period == pytest.approx(scale * plain.period, rel=1e-6)
    np.testing.assert_allclose(cycle.amplitude, drive * plain.amplitude, rtol=1e-6)
    np.testing.assert_allclose(cycle.multipliers, plain.multipliers, atol=1e-4)


def test_frequency_at_the_lower_bound_equals_linear_theory():
    """w = sqrt((1 - a + b) / (T_r T_a)) at a = 1 + T_r / T_a, from either side."""
    gain = 4.0
    hertz = np.sqrt((1 - LEAST + gain) / (RISE * ADAPTATION)) / (2 * np.pi)
    cycle = found(chain(pair_weight=LEAST + 1e-5), gain)
    assert cycle.frequency == pytest.approx(hertz, rel=1e-4)
    with pytest.raises(NoRhythmError, match="evenly"):
        found(chain(pair_weight=LEAST - 1e-5), gain)


@pytest.mark.parametrize(
    ("gain", "constant", "words"),
    [(1.5, 0.0, "silence"), (4.0, -1.0, "nothing drives"), (4.0, -3.0, "nothing drives")],
)
def test_one_sided_and_undriven_rest_have_their_reason(gain, constant, words):
    with pytest.raises(NoRhythmError, match=words):
        found(chain(pair_weight=3.0, constant_input=constant), gain)


@pytest.mark.slow
def test_a_resting_oscillator_has_no_lag():
    """The tail rests while the other oscillators swing. Lags to it are NaN."""
    cycle = found(chain(3), 0.3)
    assert is_what_simulation_shows(chain(3), 0.3) == "rhythm"
    assert cycle.amplitude[2] < 1e-6 * cycle.amplitude[0]
    assert np.isnan(cycle.lag[1]) and np.isfinite(cycle.lag[0])
    assert resting(chain(3), 1.0, 0.3, 0.3) == [2]


def test_an_unfinished_search_is_neither_rest_nor_rhythm(monkeypatch):
    """At a = 1 + b, one side rests just as the other would begin to fire."""
    with pytest.raises(RhythmSearchError):
        found(chain(pair_weight=5.0), 4.0)
    monkeypatch.setattr("evo_cpg.analysis.limit_cycle._LONGEST", 0.0)
    with pytest.raises(RhythmSearchError, match="nothing is known"):
        found(chain(pair_weight=2.0), 4.0)


def test_a_guess_with_an_overflowing_derivative_closes_no_orbit():
    """Both sides fire alike, which is unstable: a perturbation grows by more than exp(710)."""
    flow, alike = Flow(chain(pair_weight=5.0), np.ones((2, 1)), np.full(1, 4.0)), np.full(4, 0.2)
    long = SimpleNamespace(t_events=[], t=np.array([0.0, 2e3]), y=np.ones((4, 2)))
    long.sol = lambda time: alike
    assert not np.isfinite(flow.monodromy(long)).all()
    flow.run = lambda *given: long
    assert close(flow, alike, 2e3) is None


def test_a_rhythm_of_unknown_stability_is_returned(monkeypatch):
    monkeypatch.setattr("evo_cpg.analysis.limit_cycle._NEUTRAL", 0.0)
    cycle = found(chain(pair_weight=3.0), 4.0)
    assert cycle.frequency == pytest.approx(0.425, abs=1e-3)
    assert np.isnan(cycle.multipliers).all() and np.isnan(cycle.recovery_time)


def drawn(seed: int) -> tuple[MatsuokaNetwork, float, np.ndarray]:
    """Return a random network, b and drive."""
    rng = np.random.default_rng(seed)

    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    joints = int(rng.choice([1, 2, 3, 5]))
    drive = between(1e-6, 1e6)
    network = chain(
        joints,
        pair_weight=between(0.5, 20.0),
        parent_weight=float(rng.uniform(0, 2)),
        child_weight=float(rng.choice([0.0, 0.2, rng.uniform(0, 2)])),
        time_scale=between(1e-2, 1e2),
        max_tonic_input=drive,
    )
    if rng.random() < 0.5:
        rise = network.adaptation_time * between(1e-3, 3.0)
        network = dataclasses.replace(network, rise_time=rise)
    uneven = rng.uniform(0.7, 1.3, (2, joints)) if rng.random() < 0.5 else np.ones((2, joints))
    return network, between(0.3, 50.0), drive * uneven


@pytest.mark.parametrize(
    "seed", [pytest.param(i, marks=() if i in (1, 51) else pytest.mark.slow) for i in range(100)]
)
def test_random_networks_agree_with_simulation(seed):
    is_what_simulation_shows(*drawn(seed))


@pytest.mark.parametrize("weight", [0.5, LEAST - 0.05, LEAST + 0.05, 1.8])
def test_a_single_oscillator_swings_above_the_critical_weight(weight):
    rests = resting(chain(1, pair_weight=weight), 1.0, 1.0, 10.0)
    assert rests == ([0] if weight < LEAST else [])


def test_an_oscillator_with_one_silent_side_is_at_rest():
    """The weight exceeds 1 + b for every b. It swings if one gain is large enough."""
    network = chain(1, pair_weight=12.0)
    assert resting(network, 1.0, 1.0, 10.0) == [0]
    assert resting(network, 1.0, 1.0, 13.0) == []


def test_all_rest_without_a_positive_drive():
    swinging = chain(3)
    assert resting(swinging, 1.0, 1.0, 10.0) == resting(swinging, 1e-3, 1.0, 10.0) == []
    still = dataclasses.replace(swinging, constant_input=-1.0)
    assert resting(still, 1.0, 1.0, 10.0) == [0, 1, 2]


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"constants": "as_printed"},
        {"pair_weight": 0.6},
        {"couplings": (Coupling("b2.z", "b3.z", 0.0), Coupling("b3.z", "b2.z", 0.0))},
    ],
    ids=["default", "as_printed", "weak", "cut"],
)
def test_parts_at_rest_are_the_parts_without_an_orbit(settings):
    network, gain, without = chain(3, **settings), 5.5, []
    for part in parts(network):
        try:
            limit_cycle(network, np.ones((2, 3)), np.full(3, gain), part)
        except NoRhythmError:
            without += part
    assert resting(network, 1.0, gain, gain) == sorted(without)
