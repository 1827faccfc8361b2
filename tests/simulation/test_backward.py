"""Slopes through a trial: the same with little memory, and forgetful where that is asked for."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import quick_jit
from evo_cpg.fusion import machine_constants
from evo_cpg.physics.state import State
from evo_cpg.simulation.backward import Backward, retention
from evo_cpg.simulation.judge import score
from evo_cpg.simulation.rollout import rollout
from trials import experiment

STEPS = 23  # not a whole number of segments


def state_of(position, angle) -> State:
    """All else at rest."""
    rest = jnp.zeros
    return State(position, jnp.array([1.0, 0, 0, 0]), rest(6), angle, rest(len(angle)))


def end_position(push, decay: float, how: Backward, steps: int = STEPS):
    """q decays while it is pushed; the position adds it up."""

    def advance(carry, _):
        state, nerves = carry
        state, nerves = how.forget(state, nerves)
        q = decay * state.q + push
        return (state_of(state.position + q.sum(), q), nerves), None

    carry = state_of(jnp.zeros(3), jnp.zeros(1)), jnp.zeros((), jnp.int32)
    state, _ = how.scan(advance, carry, steps)
    return state.position[0]


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("kept", [1.0, 0.9, 0.5])
@pytest.mark.parametrize("budget", [2**20, 0], ids=["one level", "segments"])
def test_a_faded_slope_is_that_of_a_system_that_forgets(kept, budget, monkeypatch):
    # What the position says is never forgotten, so the slope is a sum of the decay's powers.
    monkeypatch.setattr(machine_constants, "LARGEST_RESIDUALS", budget)
    decay = 0.97
    value, slope = jax.value_and_grad(end_position)(2.0, decay, Backward(kept))
    assert float(value) == pytest.approx(float(end_position(2.0, decay, Backward())), rel=1e-12)
    by_hand = sum((decay * kept) ** k for t in range(STEPS) for k in range(t + 1))
    assert float(slope) == pytest.approx(by_hand, rel=1e-12)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("kept", [None, 0.5])
def test_on_rough_ways_no_slope_is_steeper_than_ten_times_what_it_says_of_the_place(kept):
    decay, sensible, by_hand = 3.0, 10.0, 0.0
    below = 0.0
    for _ in range(STEPS):
        by_hand += below + 1
        below = (kept or 1) * min(decay * (below + 1), sensible)
    rough = Backward(kept, rough=True)
    slope = jax.grad(end_position)(2.0, decay, rough)
    assert float(slope) == pytest.approx(by_hand, rel=1e-12)
    # Where all is gentle it is the exact one.
    gentle, exact = (jax.grad(end_position)(2.0, 0.8, how) for how in (rough, Backward(kept)))
    assert float(gentle) == pytest.approx(float(exact), rel=1e-12)


@pytest.mark.parametrize("trouble", [1e15, np.inf, np.nan])
def test_on_rough_ways_a_moment_without_a_slope_is_left_out(trouble):
    def end(push):
        state = state_of(push * jnp.ones(3), push * jnp.ones(1))
        state, _ = Backward(rough=True).forget(state, None)
        return state.position[0] + state.q[0] * trouble

    assert float(quick_jit(jax.grad(end))(0.0)) == pytest.approx(11.0 if trouble == 1e15 else 1.0)


def test_on_rough_ways_slopes_of_the_height_fade():
    def end(push, how):
        state, _ = how.forget(state_of(push, jnp.zeros(1)), None)
        return state.position @ jnp.array([1.0, 2.0, 3.0])

    for rough, height in ((False, 3.0), (True, 1.5)):
        how = Backward(0.5, rough=rough)
        slope = quick_jit(jax.grad(lambda push, how=how: end(push, how)))(np.zeros(3))
        np.testing.assert_allclose(slope, [1.0, 2.0, height])


def test_a_horizon_is_the_time_in_which_a_slope_falls_to_its_eth():
    share = retention(np.array([2.0, np.inf]), 60.0)
    np.testing.assert_allclose(share**120, [np.exp(-1), 1.0], rtol=1e-12)


def slopes(how: Backward | None) -> jax.Array:
    """Of the fitness of two swimmers by their genes."""
    made = experiment(STEPS).simulation

    def fitness(genes):
        outcome = rollout(made, genes, backward=how)
        return score(made.task, outcome, {"energy": jnp.float32(1.0)}).sum()

    return quick_jit(jax.grad(fitness))(jnp.array([[1.2, 0.7], [1.1, 1.9]]))


@pytest.fixture(scope="module")
def plain():
    """The slopes with everything kept."""
    return slopes(None)


@pytest.mark.parametrize(
    "budget",
    [pytest.param(2**30, marks=pytest.mark.slow), 0],
    ids=["one level", "segments"],
)
def test_a_trial_has_the_slopes_that_it_has_with_everything_kept(budget, plain, monkeypatch):
    monkeypatch.setattr(machine_constants, "LARGEST_RESIDUALS", budget)
    frugal = slopes(Backward(jnp.ones(2)))
    assert np.abs(plain).min() > 1e-5
    np.testing.assert_allclose(frugal, plain, rtol=1e-4)


def wave(how: Backward):
    """A function of 16 numbers, through 900 steps that leave thirty times what they carry on."""

    def end(push):
        def advance(carry, _):
            state, nerves = carry
            q = state.q
            for _ in range(30):
                q = jnp.sin(q + push)
            return (state_of(state.position, q), nerves), None

        carry = state_of(jnp.zeros(3), jnp.zeros(16)), jnp.zeros((), jnp.int32)
        return how.scan(advance, carry, 900)[0].q.sum()

    return end, jnp.ones(16)


def swim(how: Backward):
    """The fitness of 16 swimmers after 900 steps, by their genes."""
    made = dataclasses.replace(experiment().simulation, steps=900)

    def fitness(genes):
        outcome = rollout(made, genes, backward=how)
        return score(made.task, outcome, {"energy": jnp.float32(1.0)}).sum()

    return fitness, jnp.ones((2, 16))


@pytest.mark.parametrize("trial", [wave, pytest.param(swim, marks=pytest.mark.slow)])
def test_segments_take_less_memory_in_long_trials(trial, monkeypatch):
    def gradient(budget: int, copies: int = 1):
        monkeypatch.setattr(machine_constants, "LARGEST_RESIDUALS", budget)
        function, at = trial(Backward(copies=copies))
        return jax.jit(jax.grad(function)).trace(at)

    def memory(traced) -> int:
        return traced.lower().compile().memory_analysis().temp_size_in_bytes

    several = gradient(2**30, copies=2**16)
    assert str(several.jaxpr) == str(gradient(0).jaxpr)
    one_level, segments = memory(gradient(2**30)), memory(several)
    # Kept are some thirty states, and what some thirty steps of the present segment leave.
    assert segments < one_level / 5
