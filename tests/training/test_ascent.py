"""Gradient ascent: the published Adam, with a guard against exploding gradients."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest

from evo_cpg.simulation.judge import score
from evo_cpg.simulation.rollout import rollout
from evo_cpg.training.ascent import (
    Climber,
    ClimbSettings,
    GuardedAdam,
    compile_ascent,
    draw_settings,
)
from evo_cpg.training.devices import population_mesh
from trials import experiment


def climb(loss, start, size: float, slopes: int):
    solver = Climber(search=optimistix.LearningRate(size))
    return optimistix.minimise(
        lambda y, _: loss(y), solver, jnp.asarray(start), max_steps=slopes, throw=False
    ).value


def valley(y):
    """Return Rosenbrock's function."""
    return (1 - y[0]) ** 2 + 100 * (y[1] - y[0] ** 2) ** 2


@pytest.mark.usefixtures("x64")
@pytest.mark.slow
def test_the_steps_equal_the_published_algorithm():
    # Algorithm 1 of Kingma and Ba 2015.
    y, size, decays = np.array([-1.2, 1.0]), 0.01, (0.9, 0.99)
    mean, square = np.zeros(2), np.zeros(2)
    places = [y]
    for count in range(1, 40):
        slope = np.asarray(jax.grad(valley)(y))
        mean = decays[0] * mean + (1 - decays[0]) * slope
        square = decays[1] * square + (1 - decays[1]) * slope**2
        unbiased = mean / (1 - decays[0] ** count), square / (1 - decays[1] ** count)
        y = y - size * unbiased[0] / np.sqrt(unbiased[1])
        places.append(y)
    # Some points are higher than earlier points.
    for slopes, last_is_best in ((1, True), (2, True), (10, True), (30, False), (40, True)):
        best = int(np.argmin([valley(y) for y in places[:slopes]]))
        assert (best == slopes - 1) == last_is_best
        found = climb(valley, [-1.2, 1.0], size, slopes)
        np.testing.assert_allclose(found, places[best], rtol=1e-9)


def test_the_solver_descends_a_curved_valley():
    assert valley(climb(valley, [-1.2, 1.0], 0.02, 1500)) < 1e-3


@pytest.mark.parametrize("cliff", [1e8, np.nan, np.inf])
def test_a_cliff_does_not_stop_the_solver(cliff):
    # One gradient is huge or undefined. Without the guard, Adam's second moment would keep it and
    # stop the solver for hundreds of steps, or for ever.
    def loss(y):
        height = jnp.sum(y**2)
        near = jnp.abs(y[0] - 0.7) < 0.006
        return jax.lax.cond(near, lambda: height + cliff * y[0], lambda: height)

    found = climb(loss, [1.0, 1.0], 0.01, 300)
    assert float(jnp.sum(found**2)) < 1e-3


def test_the_guard_cuts_only_much_longer_gradients():
    def after(*lengths):
        descent, y = GuardedAdam(), jnp.zeros(2)
        state = descent.init(y, None)
        for length in lengths:
            slope = SimpleNamespace(f=jnp.zeros(()), grad=length * jnp.array([0.6, 0.8]))
            state = descent.query(y, slope, state)
        assert int(state.finite) == np.isfinite(lengths).sum()
        return np.asarray(state.move)

    unlike = after(1.0, 9.0)
    for guarded, equal in (
        ((1.0, 500.0), (1.0, 10.0)),
        # The mean length is 1.9 after gradients of length 1 and 10.
        ((1.0, 500.0, 500.0), (1.0, 10.0, 19.0)),
        ((1.0, np.nan), (1.0, 0.0)),
    ):
        np.testing.assert_allclose(after(*guarded), after(*equal), rtol=1e-6)
        assert np.abs(after(*guarded) - unlike).max() > 1e-3
    # A gradient that is not finite does not change the mean length.
    np.testing.assert_allclose(after(1.0, np.nan, 500.0), after(1.0, np.nan, 10.0), rtol=1e-6)


def test_an_always_infinite_loss_keeps_the_initial_point():
    solver = Climber(search=optimistix.LearningRate(0.1))
    found = optimistix.minimise(
        lambda y, _: jnp.inf + jnp.sum(y), solver, jnp.ones(2), max_steps=3, throw=False
    )
    assert found.value.tolist() == [1.0, 1.0]
    assert found.state.descent_state.least == np.inf


@pytest.mark.slow
def test_each_individual_climbs_independently():
    made = experiment(40)
    run = compile_ascent(made, population_mesh(), 6)
    genes = np.array([[1.0, 1.0, 1.4, 0.3], [1.0, 1.0, 0.8, 1.5]], np.float32)
    settings = ClimbSettings(np.array([1e-2, 3e-2, 3e-2, 3e-2], np.float32), np.ones(4, np.float32))
    scales = {"energy": np.ones(4, np.float32)}
    best, fitness, finite = run(genes, settings, scales)
    assert finite.tolist() == [7] * 4
    assert np.isneginf(run(np.nan * genes, settings, scales).fitness).all()

    def judged(genes):
        return np.asarray(
            score(
                made.simulation.task,
                rollout(made.simulation, jnp.asarray(genes)),
                {"energy": jnp.float32(1.0)},
            )
        )

    np.testing.assert_allclose(fitness, judged(best), rtol=1e-4)
    assert (fitness > judged(genes) + 1e-5).all()
    # The second lane has larger steps and gets farther from the same place.
    moved = np.abs(best - genes).max(0)
    assert 0 < moved[0] < moved[1]
    # A lane alone gives the result that it gives among others.
    alone = run(
        genes[:, 2:3],
        ClimbSettings(settings.sizes[2:3], settings.retentions[2:3]),
        {"energy": scales["energy"][:1]},
    )
    np.testing.assert_allclose(alone.genes[:, 0], best[:, 2], rtol=1e-3)


def test_settings_are_spread_over_their_ranges():
    simulation = experiment(600).simulation
    settings = draw_settings(np.random.default_rng(0), simulation, 4000)
    assert 2.9e-4 < settings.sizes.min() < 4e-4 < 8e-3 < settings.sizes.max() < 1.01e-2
    exact = settings.retentions == 1
    assert 0.2 < exact.mean() < 0.3
    horizons = -1 / (60 * np.log(settings.retentions[~exact]))
    assert 0.99 < horizons.min() < 1.1 and 80 < horizons.max() < 102
