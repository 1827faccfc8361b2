"""Feedback of the senses into the spinal cord: signs, delays, spread, rhythm, limits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from evo_cpg.analysis.cycles import frequency_of, upward_crossings
from evo_cpg.control import matsuoka
from evo_cpg.control.brain_cpg import (
    BrainCpgSettings,
    FeelingState,
    build_brain_cpg,
    max_amplitude,
    silent_genes,
)
from evo_cpg.control.controller import Observation
from evo_cpg.control.couplings import CouplingError
from evo_cpg.control.feedback import (
    FeedbackSettings,
    LoadFeedback,
    StretchFeedback,
    build_feedback,
    feel,
    first_memory,
)
from evo_cpg.control.matsuoka import CpgSettings

H = 1 / 60
FREE = 100.0  # A limit that no test reaches.


def stretch(unit: float = 1.0, limit: float = FREE, **settings) -> CpgSettings:
    """Return the settings of a cord with one sense of stretch."""
    sense = StretchFeedback(**settings)
    return CpgSettings(max_tonic_input=unit, feedback=FeedbackSettings((sense,), limit=limit))


def seen(angle, rate=None, load=None) -> Observation:
    angle = jnp.asarray(angle, float)
    none = jnp.zeros((0, *angle.shape[1:]))
    rate = jnp.zeros_like(angle) if rate is None else jnp.asarray(rate, float)
    return Observation(none, none, none, none, angle, rate, none, None, load)


def inputs(tree, settings: CpgSettings, angle, rate=0.0, load=None, genes=None):
    """Return the input to each neuron for senses ``(t, ...)``, one control step after another."""
    assert settings.feedback is not None
    feedback = build_feedback(tree, settings.feedback, settings.max_tonic_input, H)
    angle = jnp.asarray(angle, float)
    rate = jnp.broadcast_to(jnp.asarray(rate, float), angle.shape)
    memory = first_memory(feedback, tree.dof_count, angle.shape[2:], float)
    found = []
    for i in range(len(angle)):
        own = None if load is None else jnp.asarray(load[i], float)
        felt, memory = feel(feedback, genes, memory, angle[i], rate[i], own)
        found.append(felt)
    return np.array(found)


@pytest.mark.slow
def test_cord_without_feedback_keeps_its_state_and_its_bits(chain):
    tree, genes = chain(4, "z"), None
    results = []
    for feedback in (None, FeedbackSettings(), FeedbackSettings((StretchFeedback(),))):
        grown = build_brain_cpg(tree, 0, 0, BrainCpgSettings(cpg=CpgSettings(feedback=feedback)))
        genes = grown.random_genes(jax.random.key(0), (2,), float) if genes is None else genes
        state = grown.initial_state((2,), float)
        assert isinstance(state, FeelingState) is (feedback is not None)
        if feedback is None:
            assert len(jax.tree.leaves(state)) == 2
        else:
            # The limit of the output grows with the possible feedback, so fix the brain's input.
            grown = grown.__class__(**vars(grown) | {"max_amplitude": 1.3})
        for angle in (0.1, -0.3, 0.2):
            state, command = grown.act(grown.decode(genes), state, seen(np.full((3, 2), angle)))
        results.append((state.potential, state.adaptation, command.target_rate))
    for other in results[1:]:
        for one, two in zip(results[0], other, strict=True):
            np.testing.assert_array_equal(one, two)


def test_positive_weight_excites_the_stretched_side(chain):
    """At positive angles the extensor's side is short and the flexor's side is stretched."""
    settings = stretch(unit=2.0, angle_weight=0.5, rate_weight=0.25)
    extensor, flexor = inputs(chain(2, "z"), settings, [[0.4]], [[0.2]])[0][:, 0]
    assert flexor == pytest.approx(2 * (0.5 * 0.4 + 0.25 * 0.2))
    assert extensor == -flexor
    negative = stretch(angle_weight=-0.5)
    assert inputs(chain(2, "z"), negative, [[0.4]])[0][0, 0] == pytest.approx(0.2)


@pytest.mark.parametrize("delay", [0.0, H, 0.02, 0.05, 0.5])
def test_delay_interpolates_between_samples(chain, delay):
    rng = np.random.default_rng(0)
    angle = rng.normal(size=(60, 1))
    found = inputs(chain(2, "z"), stretch(angle_weight=1.0, delay=delay), angle)[:, 1, 0]
    time = H * np.arange(60)
    before = np.concatenate([np.zeros(40), angle[:, 0]])
    expected = np.interp(time - delay, H * np.arange(-40, 60), before)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


def test_spread_decreases_linearly_along_the_chain(chain):
    settings = stretch(angle_weight=1.0, from_parents=2, from_children=1)
    angle = np.eye(5)[None]  # Five individuals: each has one bent joint.
    found = inputs(chain(6, "z"), settings, angle)[0, 1]
    expected = np.eye(5) + 2 / 3 * np.eye(5, k=-1) + 1 / 3 * np.eye(5, k=-2) + 0.5 * np.eye(5, k=1)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-15)


def test_neighbour_with_the_opposite_axis_receives_the_opposite_sign(grow):
    tree = grow({"root": (None, ""), "a": ("root", "z"), "b": ("a", "Z")})
    found = inputs(tree, stretch(angle_weight=1.0, from_parents=1), [[0.3, 0.0]])[0, 1]
    np.testing.assert_allclose(found, [0.3, -0.15], rtol=0, atol=1e-15)


def test_only_chosen_joints_feel(chain):
    settings = stretch(angle_weight=1.0, joints=("b[23].z",), from_parents=5, from_children=5)
    found = inputs(chain(5, "z"), settings, [[1.0, 0.0, 0.0, 1.0]])
    assert not found.any()
    assert inputs(chain(5, "z"), settings, [[0.0, 1.0, 0.0, 0.0]])[0, 1].tolist()[0::3] == [0, 0]


def test_genes_set_weights_within_their_range(chain):
    tree = chain(2, "z")
    cpg = stretch(angle_weight=(-2.0, 4.0), rate_weight=(0.0, 1.0))
    grown = build_brain_cpg(tree, 0, 0, BrainCpgSettings(cpg=cpg))
    assert grown.gene_count == grown.brain.gene_count + 2
    assert grown.random_genes(jax.random.key(0), (3,), float).shape == (grown.gene_count, 3)
    assert len(silent_genes(grown)) == grown.gene_count
    genes = jnp.concatenate([jnp.zeros(grown.brain.gene_count), jnp.array([0.0, 50.0])])
    decoded = grown.decode(genes)
    found = inputs(tree, cpg, [[0.1]], [[0.2]], genes=decoded.feedback)[0, 1, 0]
    assert found == pytest.approx(1.0 * 0.1 + 1.0 * 0.2)
    several = jnp.array([[-50.0, 50.0], [0.0, 0.0]])
    batch = inputs(tree, cpg, np.ones((1, 1, 2)), genes=several)[0, 1, 0]
    assert batch == pytest.approx([-2.0, 4.0])
    extremes = [inputs(tree, cpg, [[1.0]], genes=jnp.array([g, 0.0]))[0, 1, 0] for g in (-50, 50)]
    assert extremes == pytest.approx([-2.0, 4.0])


def test_output_stays_below_its_bound_with_strong_feedback(chain):
    cpg = stretch(limit=0.7, angle_weight=50.0)
    settings = BrainCpgSettings(cpg=cpg)
    grown = build_brain_cpg(chain(4, "z"), 0, 0, settings)
    genes = 3 * grown.random_genes(jax.random.key(1), (8,), float)
    state, largest = grown.initial_state((8,), float), 0.0
    act = jax.jit(lambda state, angle: grown.act(grown.decode(genes), state, seen(angle))[0])
    for i in range(200):
        state = act(state, np.full((3, 8), np.sin(0.2 * i)))
        largest = max(largest, float(jnp.abs(matsuoka.output(state)).max()))
    assert 1.0 < largest <= max_amplitude(settings) == 1 + 0.3 + 0.7


def forced(cpg: CpgSettings, tree, gain: float, angles: np.ndarray) -> np.ndarray:
    """Return the outputs of a cord at u = 1 for joint angles ``(t, d)``."""
    grown = build_brain_cpg(tree, 0, 0, BrainCpgSettings(cpg=cpg))
    tonic, gains = jnp.ones((2, tree.dof_count)), jnp.full((tree.dof_count,), gain)

    def advance(state, angle):
        state = grown.cord(state, tonic, gains, seen(angle))
        return state, matsuoka.output(state)

    start = grown.initial_state((), float)
    return np.asarray(jax.jit(lambda x: jax.lax.scan(advance, start, x)[1])(jnp.asarray(angles)))


PAIR = {"pair_weight": 1.5, "time_scale": 0.5}


def with_stretch(weight: float, delay: float = 0.0) -> CpgSettings:
    sense = StretchFeedback(angle_weight=weight, delay=delay)
    return CpgSettings(**PAIR, feedback=FeedbackSettings((sense,), limit=FREE))


def test_pair_with_delayed_feedback_agrees_with_scipy(chain):
    """SciPy has the continuous delay of D + h/2 that sampling and holding stand for."""
    weight, delay, gain = 0.8, 0.04, 3.0
    times = H * np.arange(360)

    def angle(time):
        return np.where(time > 0, 0.5 * np.sin(5.0 * time), 0.0)

    found = forced(with_stretch(weight, delay), chain(2, "z"), gain, angle(times)[:, None])[:, 0]
    rise, adaptation = (0.5 * x for x in matsuoka.TIME_CONSTANTS["swapped"])

    def change(time, state):
        x, z = state[:2], state[2:]
        y, felt = np.maximum(x, 0), weight * angle(time - delay - H / 2)
        drive = 1.0 + felt * np.array([-1.0, 1.0])
        return [*((drive - x - 1.5 * y[::-1] - gain * z) / rise), *((y - z) / adaptation)]

    start = [0.1, 0.0, 0.0, 0.0]
    solved = solve_ivp(change, (0, 6), start, t_eval=times[1:], rtol=1e-9, atol=1e-9, max_step=H)
    expected = np.maximum(solved.y[0], 0) - np.maximum(solved.y[1], 0)
    error = np.sqrt(np.mean((found[:-1] - expected) ** 2) / np.mean(expected**2))
    assert error < 0.005
    late = np.sqrt(np.mean((found[3:-1] - expected[:-3]) ** 2) / np.mean(expected**2))
    assert late > 0.1


def mean_frequency(outputs: np.ndarray) -> float:
    """Return the mean frequency from upward zero crossings, Hz."""
    return frequency_of(H * upward_crossings(outputs))


def test_bending_entrains_a_pair_around_its_own_frequency(chain):
    """One pair, 12 degrees of bending: it follows from 0.8 to 1.25 times its own frequency."""
    tree, gain = chain(2, "z"), 3.0
    own = mean_frequency(forced(with_stretch(0.0), tree, gain, np.zeros((1800, 1)))[600:, 0])
    for ratio in (0.8, 0.9, 1.1, 1.25):
        angle = np.deg2rad(12) * np.sin(2 * np.pi * ratio * own * H * np.arange(1800))[:, None]
        follows = mean_frequency(forced(with_stretch(1.5), tree, gain, angle)[600:, 0])
        assert follows == pytest.approx(ratio * own, rel=0.01)
        alone = mean_frequency(forced(with_stretch(0.0), tree, gain, angle)[600:, 0])
        assert alone == pytest.approx(own, rel=1e-6)


LIMBS = {
    "trunk": (None, ""),
    "left": ("trunk", "z"),
    "left_foot": ("left", "y"),
    "right": ("trunk", "z"),
    "right_foot": ("right", "y"),
}


def test_load_enters_its_own_limb_and_the_neighbours(grow):
    tree = grow(LIMBS)
    load = LoadFeedback(("left", "right"), ("*.z",), weight=0.5, neighbour_weight=-0.25)
    cpg = CpgSettings(feedback=FeedbackSettings(load=(load,)))
    on_left = np.zeros(5)
    on_left[tree.names.index("left_foot")] = 0.6
    extensor, flexor = inputs(tree, cpg, np.zeros((1, 4)), load=[on_left])[0]
    by_name = dict(zip(tree.dof_names, extensor, strict=True))
    expected = {"left.z": 0.3, "right.z": -0.15, "left_foot.y": 0, "right_foot.y": 0}
    assert by_name == pytest.approx(expected)
    np.testing.assert_array_equal(flexor, -extensor)


def test_loads_without_readings_are_refused(grow):
    tree = grow(LIMBS)
    cpg = CpgSettings(feedback=FeedbackSettings(load=(LoadFeedback(("left",)),)))
    with pytest.raises(ValueError, match=r"got no Observation\.load"):
        inputs(tree, cpg, np.zeros((1, 4)))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (LoadFeedback(("arm",)), "'arm' matches no body"),
        (LoadFeedback(()), "names no limb"),
        (LoadFeedback(("left*",)), "'left_foot' is part of the limb 'left'"),
        (LoadFeedback(("left", "right"), ("left*",)), "matches no joint of the limb 'right'"),
        (LoadFeedback(("left",), ("knee",)), "'knee' is no degree of freedom"),
    ],
)
def test_limbs_that_do_not_fit_are_refused(grow, settings, message):
    with pytest.raises(CouplingError, match=message):
        build_feedback(grow(LIMBS), FeedbackSettings(load=(settings,)), 1.0, H)
