"""Couplings beyond the tree's couplings, against closed forms from the symmetry of the network.

A ring of n equal oscillators with equal drives is symmetric. So a wave in which each oscillator
lags the previous one by k/n of a turn is an exact solution. The eigenvalues of eq. 2 show which
waves grow. Their real part is (n / 2 - 1) w / (n - 1) for the wave with the given lag and for the
opposite wave, and -w / (n - 1) for all others.
"""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from evo_cpg.analysis.chains import chains
from evo_cpg.analysis.limit_cycle import limit_cycle
from evo_cpg.control.couplings import Coupling, CouplingError, Ring, uncoupled
from evo_cpg.control.matsuoka import (
    CpgSettings,
    MatsuokaState,
    build_network,
    inhibition_matrix,
    initial_state,
    output,
    runge_kutta_step,
    sub_network,
)

A = CpgSettings().pair_weight


@pytest.fixture(scope="session")
def star(grow):
    """Function that builds a root with arms of segments, ``arm1_1`` the first of the first arm."""

    def build(arms, segments=1, axes="y"):
        plan = {"disc": (None, "")}
        for j, i in itertools.product(range(1, arms + 1), range(1, segments + 1)):
            parent = "disc" if i == 1 else f"arm{j}_{i - 1}"
            plan[f"arm{j}_{i}"] = parent, axes
        return grow(plan)

    return build


@eqx.filter_jit
def simulate(network, state, tonic_input, gain, h, steps):
    """Return outputs ``(steps, oscillators, n)`` with constant inputs, by plain JAX operations."""

    def step(state, _):
        state = runge_kutta_step(network, h, state, tonic_input, gain)
        return state, output(state)

    return jax.lax.scan(step, state, length=steps)[1]


def ring(lag, weight=0.5):
    return CpgSettings(rings=(Ring(("arm*_1.y",), lag, weight),))


def first_segments(tree):
    return [i for i, name in enumerate(tree.dof_names) if name.endswith("_1.y")]


def differences(degrees):
    return (np.asarray(degrees) + 180) % 360 - 180


def scattered(tree, count):
    """Return random states."""
    start = np.random.default_rng(0).uniform(0, 1, (2, 2, tree.dof_count, count))
    return MatsuokaState(jnp.asarray(start[0]), jnp.asarray(start[1]))


def arm_lags(tree, settings, gains, states=None, h=1 / 60):
    """Return the lag of each arm behind the previous one after 40 s, ``(arms, n)``, degrees."""
    network = build_network(tree, settings)
    count, batch = network.oscillator_count, (len(gains),)
    states = initial_state(network, batch, float) if states is None else states
    gain = jnp.broadcast_to(jnp.asarray(gains)[None], (count, *batch))
    signals = simulate(network, states, jnp.ones((2, count, *batch)), gain, h, 3600)
    late = np.asarray(signals)[-1200:, first_segments(tree)]
    spectrum = np.fft.rfft((late - late.mean(0)) * np.hanning(1200)[:, None, None], axis=0)
    peak = np.abs(spectrum).sum(1).argmax(0)
    component = np.take_along_axis(spectrum, peak[None, None], 0)[0]
    return np.rad2deg(np.angle(component / np.roll(component, -1, axis=0)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arms", "segments", "lag"),
    [(5, 3, 72), (5, 1, -72), (5, 2, 144), (4, 2, 90), (5, 2, 0), (6, 2, 180), (2, 1, 180)],
)
def test_arms_around_a_ring_keep_the_given_lag(star, arms, segments, lag):
    lags = arm_lags(star(arms, segments), ring(lag), [2.0, 5.0, 10.0])
    np.testing.assert_allclose(differences(lags - lag), 0, atol=0.2)


@pytest.mark.slow
def test_the_wave_around_a_ring_is_a_stable_orbit_of_equal_arms(star):
    network = build_network(star(5), ring(72))
    cycle = limit_cycle(network, np.ones((2, 5)), np.full(5, 5.0), tuple(range(5)))
    assert cycle.stable
    np.testing.assert_allclose(cycle.lag, 72, atol=0.01)
    assert np.ptp(cycle.amplitude) < 1e-4 * cycle.amplitude[0]


@pytest.mark.parametrize(("arms", "lag"), [(5, 72), (5, 144), (7, 360 / 7), (4, 90), (3, 120)])
def test_waves_with_the_given_lag_grow_fastest(star, arms, lag):
    matrix = inhibition_matrix(star(arms), ring(lag)) / A - np.eye(arms)
    place = np.arange(arms)
    found = {}
    for k in range(arms):
        wave = np.exp(-2j * np.pi * k * place / arms)
        value = matrix @ wave / wave
        np.testing.assert_allclose(value, value[0], atol=1e-9)
        found[k] = value[0]
    number = round(lag * arms / 360)
    weight = 0.5 / (arms - 1)
    assert found[number] == pytest.approx(weight * (arms / 2 - 1 + 1j * arms / 2))
    # The opposite wave has the conjugate eigenvalue. Eigenvalues of all others are negative.
    assert found[arms - number] == pytest.approx(found[number].conjugate())
    others = [value for k, value in found.items() if k not in (number, arms - number)]
    np.testing.assert_allclose(others, -weight, atol=1e-9)


@pytest.mark.slow
def test_rings_reach_their_lag_from_any_start(star):
    tree, count = star(5, 2), 30
    for lag in (72, 0):
        lags = arm_lags(tree, ring(lag, weight=2), [5.0] * count, scattered(tree, count))
        np.testing.assert_allclose(differences(lags - lag), 0, atol=1)


def test_lags_without_a_ring_depend_on_the_start(star):
    tree, count = star(5, 2), 30
    lags = arm_lags(tree, CpgSettings(), [5.0] * count, scattered(tree, count))
    assert (np.abs(differences(lags - 72)) < 10).all(0).mean() < 0.1
    assert (np.abs(differences(lags)) < 10).all(0).mean() < 0.1


def test_the_initial_potentials_have_the_phases_of_the_ring(star):
    tree = star(5, 2)
    potential = initial_state(build_network(tree, ring(72)), (), float).potential
    phase = np.deg2rad(72 * np.arange(5))
    start = 0.1 * np.array([np.cos(phase), -np.cos(phase)])
    expected = np.tile(np.maximum(start, 0), (1, 2))  # Second segments equal first ones.
    np.testing.assert_allclose(potential, expected, atol=1e-9)


def test_extensors_start_together_without_lags(star):
    tree = star(3, 2)
    settings = CpgSettings(couplings=(Coupling("arm1_1.y", "arm2_1.y"),))
    potential = initial_state(build_network(tree, settings), (), float).potential
    np.testing.assert_array_equal(potential, [[0.1] * 6, [0.0] * 6])


def test_a_part_of_a_network_has_the_initial_state_of_the_whole(star):
    network = build_network(star(5), ring(72))
    part = sub_network(network, (1, 3))
    np.testing.assert_array_equal(part.initial_potential, network.initial_potential[:, [1, 3]])


def test_a_coupling_is_one_way_and_a_lag_two_way(star):
    tree = star(3, 1, "yz")
    names = tree.dof_names
    settings = CpgSettings(
        couplings=(
            Coupling("arm1_1.y", "arm[23]_1.y", weight=-0.4),  # one on several
            Coupling("arm*_1.y", "arm*_1.z", weight=0.6, lag_deg=90),  # one on one
        )
    )
    matrix = inhibition_matrix(tree, settings) / A - np.eye(6)
    expected = np.zeros((6, 6))
    for arm in (2, 3):
        expected[names.index(f"arm{arm}_1.y"), names.index("arm1_1.y")] = -0.4
    for arm in (1, 2, 3):
        y, z = names.index(f"arm{arm}_1.y"), names.index(f"arm{arm}_1.z")
        expected[z, y], expected[y, z] = 0.6, -0.6
    np.testing.assert_array_equal(matrix, expected)


@pytest.mark.parametrize("lag", [-120, 0, 45, 180])
def test_a_lag_couples_by_cosine_plus_and_minus_sine(star, lag):
    tree = star(2)
    settings = CpgSettings(couplings=(Coupling("arm1_1.y", "arm2_1.y", 0.7, lag),))
    matrix = inhibition_matrix(tree, settings) / A
    cosine, sine = np.cos(np.deg2rad(lag)), np.sin(np.deg2rad(lag))
    assert matrix[1, 0] + matrix[0, 1] == pytest.approx(1.4 * cosine)
    assert matrix[1, 0] - matrix[0, 1] == pytest.approx(1.4 * sine)


@pytest.mark.parametrize(("weight", "lag"), [(0.5, 0), (-0.5, 180)])
def test_two_arms_swing_together_or_against_each_other(star, weight, lag):
    pair = ("arm1_1.y", "arm2_1.y")
    couplings = Coupling(*pair, weight), Coupling(*pair[::-1], weight)
    lags = arm_lags(star(2, 2), CpgSettings(couplings=couplings), [2.0, 5.0, 10.0])
    np.testing.assert_allclose(differences(lags - lag), 0, atol=0.01)


def test_an_explicit_coupling_replaces_the_coupling_of_the_tree(star):
    tree = star(2, 2)
    names = tree.dof_names
    cut = (Coupling("arm1_1.y", "arm1_2.y", 0.0), Coupling("arm1_2.y", "arm1_1.y", 0.0))
    matrix = inhibition_matrix(tree, CpgSettings(couplings=cut)) / A
    first, second = names.index("arm1_1.y"), names.index("arm1_2.y")
    assert matrix[second, first] == matrix[first, second] == 0
    other = names.index("arm2_1.y"), names.index("arm2_2.y")
    assert matrix[other[::-1]] == 1 and matrix[other] == pytest.approx(0.2)
    # So there is no chain along the first arm.
    assert chains(tree, CpgSettings(couplings=cut)) == [other, (first,), (second,)]


def test_uncoupled_oscillators_are_found(star):
    tree = star(5, 2, "yz")
    matrix = inhibition_matrix(tree, ring(72))
    assert uncoupled(matrix) == []
    tree = star(5, 1, "yz")
    alone = [tree.dof_names[i] for i in uncoupled(inhibition_matrix(tree, ring(72)))]
    assert alone == [f"arm{j}_1.z" for j in range(1, 6)]


@pytest.mark.parametrize(
    ("settings", "where", "expected"),
    [
        ([Coupling("arm1_1.x", "arm2_1.y")], ("couplings", 0, "source"), "mean 'arm1_1.y'"),
        ([Coupling("arm[12]_1.y", "arm*_1.y")], ("couplings", 0), "matches 2 .* matches 5"),
        ([Coupling("arm1_1.y", "arm*_1.y")], ("couplings", 0), "itself"),
        (
            [Coupling("arm1_1.y", "arm2_1.y"), Ring(("arm*_1.y",), 72.0)],
            ("rings", 0),
            "couplings.0 already",
        ),
        ([Ring(("arm*_1.y",), 70.0)], ("rings", 0, "lag_deg"), "0, 72, -72, 144, -144 .*got 70"),
        ([Ring(("arm1_1.y",), 0.0)], ("rings", 0, "oscillators"), "at least two"),
        ([Ring(("arm1_1.y", "arm*_1.y"), 0.0)], ("rings", 0, "oscillators"), "twice"),
    ],
)
def test_couplings_that_do_not_fit_the_creature_are_refused(star, settings, where, expected):
    couplings = tuple(each for each in settings if isinstance(each, Coupling))
    rings = tuple(each for each in settings if isinstance(each, Ring))
    with pytest.raises(CouplingError, match=expected) as caught:
        build_network(star(5), CpgSettings(couplings=couplings, rings=rings))
    assert caught.value.where == where
