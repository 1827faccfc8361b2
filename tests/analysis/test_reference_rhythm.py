"""Settings for a reference rhythm, against time-stepping simulation."""

import dataclasses
import functools

import jax
import numpy as np
import pytest
from test_limit_cycle import simulate

from creatures import box_chain
from evo_cpg.analysis.chains import chains
from evo_cpg.analysis.gait import dominant_frequency, fourier_component
from evo_cpg.analysis.limit_cycle import NoRhythmError
from evo_cpg.analysis.reference_rhythm import (
    GAINS,
    RATIOS,
    STRONGER,
    Rhythm,
    UnreachableRhythmError,
    reference_rhythm,
    rhythm,
)
from evo_cpg.control.matsuoka import CpgSettings, build_network
from evo_cpg.creature.tree import Tree, build_tree


@functools.cache
def body(joints: int, axes: str = "z") -> Tree:
    return build_tree(box_chain(joints + 1, axes))


def simulated(tree: Tree, settings: CpgSettings, gain: float) -> tuple[float, float, float]:
    """Return frequency, mean lag and least swing of a chain after a long time."""
    network = build_network(tree, settings)
    count = network.oscillator_count
    h = network.rise_time / 16
    seconds = 500 * network.adaptation_time
    with jax.enable_x64(True):
        signals, _ = simulate(network, np.ones((2, count)), np.full(count, gain), seconds, h=h)
    tail = signals[len(signals) // 2 :]
    frequency = float(np.median(dominant_frequency(tail, h)))
    component = fourier_component(tail, h, frequency)
    lag = np.rad2deg(np.angle(component[:-1] / component[1:])).mean()
    return frequency, float(lag), float(np.ptp(tail[-len(tail) // 4 :], axis=0).min())


def solved(joints: int, frequency: float | None, lag: float | None, **changes) -> Rhythm:
    tree, settings = body(joints), CpgSettings()
    return reference_rhythm(
        tree, settings, chains(tree, settings)[0], 5.5, frequency, lag, **changes
    )


def is_reached(joints: int, found: Rhythm, frequency: float, lag: float) -> None:
    there = simulated(body(joints), found.settings, found.adaptation_gain)
    assert there[0] == pytest.approx(frequency, rel=1e-3)
    assert there[1] == pytest.approx(lag, abs=0.1)
    assert found.cycle.frequency == pytest.approx(there[0], rel=1e-3)
    assert found.lag == pytest.approx(there[1], rel=1e-3, abs=0.01)


def within_reach(joints: int, rng: np.random.Generator) -> float:
    """Return the lag of a random chain within the bounds."""
    while True:
        gain, stronger, ratio = np.exp([rng.uniform(*np.log(x)) for x in (GAINS, STRONGER, RATIOS)])
        weights = {"parent_weight": stronger, "child_weight": stronger * ratio}
        _, lag, swing = simulated(body(joints), CpgSettings(**weights), gain)
        if swing > 0.01:
            return float(lag * rng.choice([-1, 1]))


@pytest.mark.slow
@pytest.mark.parametrize("joints", [2, 3, 6, 9])
def test_random_targets_are_reached(joints):
    rng = np.random.default_rng(joints)
    for _ in range(5):
        frequency = float(np.exp(rng.uniform(np.log(0.2), np.log(3))))
        lag = within_reach(joints, rng)
        found = solved(joints, frequency, lag)
        is_reached(joints, found, frequency, lag)
        low, high = np.transpose([GAINS, STRONGER, RATIOS])
        weights = found.settings.parent_weight, found.settings.child_weight
        x = np.array([found.adaptation_gain, max(weights), min(weights) / max(weights)])
        assert (x >= low * (1 - 1e-4)).all() and (x <= high * (1 + 1e-4)).all()


def test_a_frequency_alone_changes_the_time_scale_alone():
    settings = CpgSettings()
    found = solved(3, 0.5, None)
    is_reached(3, found, 0.5, simulated(body(3), settings, 5.5)[1])
    scale = found.settings.time_scale
    assert found.settings == dataclasses.replace(settings, time_scale=scale)
    assert found.adaptation_gain == 5.5


@pytest.mark.slow
def test_a_lag_alone_keeps_the_time_scale_and_a_held_b():
    found = solved(3, None, 20.0, hold_gain=True)
    assert found.adaptation_gain == 5.5 and found.settings.time_scale == 1
    is_reached(3, found, found.cycle.frequency, 20.0)


@pytest.mark.slow
def test_the_present_lag_keeps_the_settings():
    tree, settings = body(3), CpgSettings()
    lag = simulated(tree, settings, 5.5)[1]
    found = solved(3, None, lag)
    x = [found.adaptation_gain, found.settings.parent_weight, found.settings.child_weight]
    np.testing.assert_allclose(x, [5.5, 1.0, 0.2], rtol=0.01)


@pytest.mark.slow
def test_an_unreachable_lag_raises_with_the_reachable_range():
    with pytest.raises(UnreachableRhythmError, match=r"70 degrees is out of reach\. Allowed") as e:
        solved(3, 1.0, 70.0)
    # The largest lag is at the largest b, at one of these corners.
    reachable = str(e.value).split("head to tail: ")[1].split(" (with")[0]
    low, high = map(float, reachable.split(" to "))
    corners = [
        simulated(body(3), CpgSettings(parent_weight=s, child_weight=s * r), GAINS[1])[1]
        for s in STRONGER
        for r in RATIOS
    ]
    assert high == pytest.approx(max(corners), abs=0.15)
    assert 0 < low < min(corners)
    with pytest.raises(UnreachableRhythmError, match="a lag of 0 degrees is out of reach"):
        solved(3, 1.0, 0.0)
    with pytest.raises(UnreachableRhythmError, match=r"from tail to head .*: -50\.\d to -"):
        solved(3, 1.0, -70.0)


def test_networks_that_never_oscillate_raise():
    tree, settings = body(3), CpgSettings(constants="as_printed")
    chain = chains(tree, settings)[0]
    with pytest.raises(NoRhythmError, match="rest"):
        reference_rhythm(tree, settings, chain, 5.5, frequency=1.0)
    with pytest.raises(UnreachableRhythmError, match="no steady rhythm"):
        reference_rhythm(tree, settings, chain, 5.5, lag=30.0)
    pair = chains(body(1), CpgSettings())[0]
    with pytest.raises(UnreachableRhythmError, match="single oscillator"):
        reference_rhythm(body(1), CpgSettings(), pair, 5.5, lag=30.0)


def test_chains_follow_the_axes_longest_first():
    tree = body(4, "yz")
    found = chains(tree, CpgSettings())
    assert [chain.oscillators for chain in found] == [(0, 2, 4, 6), (1, 3, 5, 7)]
    assert found[1].part == (1, 3, 5, 7)
    assert found[0].name == f"{tree.dof_names[0]} + 3"
    uncoupled = CpgSettings(pair_weight=0.0, parent_weight=0.0, child_weight=0.0)
    assert [chain.part for chain in chains(tree, uncoupled)] == [chain.part for chain in found]
    joined = chains(tree, CpgSettings(cross_weight=0.3))
    assert joined[1].part == tuple(range(8))
    turned = chains(tree, CpgSettings(opposite=(tree.names[2],)))
    assert turned[0].sides.tolist() == [-1, 1, 1]


@pytest.mark.slow
def test_lags_of_opposite_neighbours_leave_out_half_a_period():
    tree = body(3)
    plain, turned = CpgSettings(), CpgSettings(opposite=(tree.names[2],))
    lags = [rhythm(tree, s, chains(tree, s)[0], 5.5).lags for s in (plain, turned)]
    np.testing.assert_allclose(*lags, atol=0.01)
