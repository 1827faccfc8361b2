"""Gradients through a trial: equal with little memory, and faded or cut on request."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import quick_jit
from evo_cpg.native import machine_constants
from evo_cpg.physics.tree.state import State
from evo_cpg.simulation.backward import Backward, retention
from evo_cpg.simulation.judge import score
from evo_cpg.simulation.rollout import rollout
from trials import experiment

STEPS = 23  # Not a whole number of segments.


def state_of(position, angle) -> State:
    """Return a state at rest with this position and these joint angles."""
    rest = jnp.zeros
    return State(position, jnp.array([1.0, 0, 0, 0]), rest(6), angle, rest(len(angle)))


def end_position(push, decay: float, how: Backward, steps: int = STEPS):
    """Return the sum of a joint angle that decays while it is pushed."""

    def advance(carry, _):
        state, nerves = carry
        state, nerves = how.forget(state, nerves)
        q = decay * state.q + push
        return (state_of(state.position + q.sum(), q), nerves), None

    carry = state_of(jnp.zeros(3), jnp.zeros(1)), jnp.zeros((), jnp.int32)
    state, _ = how.scan(advance, carry, steps, ())
    return state.position[0]


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("kept", [1.0, 0.9, 0.5])
@pytest.mark.parametrize("budget", [2**20, 0], ids=["one level", "segments"])
def test_faded_gradients_equal_the_closed_form(kept, budget, monkeypatch):
    # The gradient of the position never fades, so the derivative is a sum of powers of the decay.
    monkeypatch.setattr(machine_constants, "LARGEST_RESIDUALS", budget)
    decay = 0.97
    value, slope = jax.value_and_grad(end_position)(2.0, decay, Backward(kept))
    assert float(value) == pytest.approx(float(end_position(2.0, decay, Backward())), rel=1e-12)
    by_hand = sum((decay * kept) ** k for t in range(STEPS) for k in range(t + 1))
    assert float(slope) == pytest.approx(by_hand, rel=1e-12)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("kept", [None, 0.5])
def test_gradients_over_rough_ground_are_cut_at_ten_times_the_positions(kept):
    decay, limit, by_hand = 3.0, 10.0, 0.0
    below = 0.0
    for _ in range(STEPS):
        by_hand += below + 1
        below = (kept or 1) * min(decay * (below + 1), limit)
    rough = Backward(kept, rough=True)
    slope = jax.grad(end_position)(2.0, decay, rough)
    assert float(slope) == pytest.approx(by_hand, rel=1e-12)
    # Gradients that do not grow are not cut.
    gentle, exact = (jax.grad(end_position)(2.0, 0.8, how) for how in (rough, Backward(kept)))
    assert float(gentle) == pytest.approx(float(exact), rel=1e-12)


@pytest.mark.parametrize("trouble", [1e15, np.inf, np.nan])
def test_non_finite_gradients_over_rough_ground_are_dropped(trouble):
    def end(push):
        state = state_of(push * jnp.ones(3), push * jnp.ones(1))
        state, _ = Backward(rough=True).forget(state, None)
        return state.position[0] + state.q[0] * trouble

    assert float(quick_jit(jax.grad(end))(0.0)) == pytest.approx(11.0 if trouble == 1e15 else 1.0)


def test_gradients_of_the_height_fade_over_rough_ground():
    def end(push, how):
        state, _ = how.forget(state_of(push, jnp.zeros(1)), None)
        return state.position @ jnp.array([1.0, 2.0, 3.0])

    for rough, height in ((False, 3.0), (True, 1.5)):
        how = Backward(0.5, rough=rough)
        slope = quick_jit(jax.grad(lambda push, how=how: end(push, how)))(np.zeros(3))
        np.testing.assert_allclose(slope, [1.0, 2.0, height])


def test_a_horizon_is_the_time_in_which_gradients_fade_to_1_over_e():
    kept = retention(np.array([2.0, np.inf]), 60.0)
    np.testing.assert_allclose(kept**120, [np.exp(-1), 1.0], rtol=1e-12)


def slopes(how: Backward | None) -> jax.Array:
    """Return the gradient of the fitness of two swimmers with respect to their genes."""
    made = experiment(STEPS).simulation

    def fitness(genes):
        outcome = rollout(made, genes, backward=how)
        return score(made.task, outcome, {"energy": jnp.float32(1.0)}).sum()

    return quick_jit(jax.grad(fitness))(jnp.array([[1.2, 0.7], [1.1, 1.9]]))


@pytest.fixture(scope="module")
def plain():
    """Gradient with all residuals stored."""
    return slopes(None)


@pytest.mark.slow
@pytest.mark.parametrize("budget", [2**30, 0], ids=["one level", "segments"])
def test_gradients_do_not_depend_on_the_memory_budget(budget, plain, monkeypatch):
    monkeypatch.setattr(machine_constants, "LARGEST_RESIDUALS", budget)
    frugal = slopes(Backward(1.0))
    assert np.abs(plain).min() > 1e-5
    np.testing.assert_allclose(frugal, plain, rtol=1e-4)


def wave(how: Backward):
    """Return a function of 16 numbers over 900 steps, with residuals of thirty times its state."""

    def end(push):
        def advance(carry, _):
            state, nerves = carry
            q = state.q
            for _ in range(30):
                q = jnp.sin(q + push)
            return (state_of(state.position, q), nerves), None

        carry = state_of(jnp.zeros(3), jnp.zeros(16)), jnp.zeros((), jnp.int32)
        return how.scan(advance, carry, 900, ())[0].q.sum()

    return end, jnp.ones(16)


def swim(how: Backward):
    """Return the fitness of 16 swimmers after 900 steps, as a function of their genes."""
    made = dataclasses.replace(experiment().simulation, steps=900)

    def fitness(genes):
        outcome = rollout(made, genes, backward=how)
        return score(made.task, outcome, {"energy": jnp.float32(1.0)}).sum()

    return fitness, jnp.ones((2, 16))


@pytest.mark.parametrize("trial", [wave, pytest.param(swim, marks=pytest.mark.slow)])
def test_segments_take_less_memory_in_long_trials(trial, monkeypatch):
    def memory(budget: int) -> int:
        monkeypatch.setattr(machine_constants, "LARGEST_RESIDUALS", budget)
        function, at = trial(Backward())
        compiled = jax.jit(jax.grad(function)).lower(at).compile()
        return compiled.memory_analysis().temp_size_in_bytes  # pyright: ignore

    one_level, segments = memory(2**30), memory(0)
    # Segments store about thirty states, and residuals of about thirty steps.
    assert segments < one_level / 5
