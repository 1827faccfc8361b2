"""Fits of recorded motion: known results, and coverage of the confidence intervals."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize, stats

from creatures import quick_jit
from evo_cpg.analysis.fit import fit
from evo_cpg.control.commanded import Commanded
from evo_cpg.io.load import load_config
from evo_cpg.io.parameters import parametrise
from evo_cpg.simulation.track import track
from tiny_run import CONFIG, TINY

TRIALS = 100
# Bounds of successes of 100 intervals: 90 to 99 hold the truth in 98 of 100 cases.
FEWEST, MOST = 90, 99
X = np.linspace(0, 3, 40)

pytestmark = pytest.mark.usefixtures("x64")


def fitted(model, data, start, positive, wrapped=False):
    """Fit a model in JAX to data with one or more columns."""
    data = np.asarray(data).reshape(len(data), -1)
    both = quick_jit(lambda p: (model(p), jax.jacfwd(model)(p)))
    columns = np.full(data.shape[1], wrapped)
    return fit(lambda p: both(jnp.asarray(p)), data, np.array(start), np.array(positive), columns)


def test_a_line_equals_linear_regression():
    """Slope, intercept and errors equal SciPy's, with gaps and whole turns in the data."""
    rng = np.random.default_rng(4)
    y = 0.7 * X - 0.2 + 0.1 * rng.normal(size=40)
    gap = rng.random(40) < 0.2
    data = np.where(gap, np.nan, y) + 2 * np.pi * (X > 2)
    found = fitted(lambda p: (p[0] * X + p[1])[:, None], data, [0.5, 0.0], [False] * 2, True)
    line = stats.linregress(X[~gap], y[~gap])
    np.testing.assert_allclose(found.values, [line.slope, line.intercept], rtol=1e-6)
    np.testing.assert_allclose(found.errors, [line.stderr, line.intercept_stderr], rtol=1e-6)
    reach = stats.t.ppf(0.975, (~gap).sum() - 2) * line.stderr
    assert found.upper[0] - found.values[0] == pytest.approx(reach, rel=1e-6)
    assert found.found


def test_an_exponential_decay_equals_scipys_fit(monkeypatch):
    """A nonlinear model from a poor start. A search that is stopped early gives a warning."""
    data = 2.0 * np.exp(-1.5 * X) + 0.02 * np.random.default_rng(5).normal(size=40)

    def search():
        decay = lambda p: (p[0] * jnp.exp(-p[1] * X))[:, None]  # noqa: E731
        return fitted(decay, data, [0.5, 4.0], [True] * 2)

    found = search()
    theta, covariance = optimize.curve_fit(
        lambda x, a, b: np.exp(a) * np.exp(-np.exp(b) * x), X, data, [0.0, 0.0], ftol=1e-14
    )
    np.testing.assert_allclose(found.values, np.exp(theta), rtol=1e-5)
    np.testing.assert_allclose(found.errors, np.sqrt(np.diag(covariance)), rtol=1e-3)
    assert found.found
    monkeypatch.setattr("evo_cpg.analysis.fit._MOST_STEPS", 3)
    words = search().warnings(("height", "rate"), np.array([True, True]))
    assert any("converge" in each for each in words)


@pytest.mark.parametrize(("slope", "count"), [(0.5, 0), (0.0, 1)])
def test_a_parameter_consistent_with_zero_is_reported(slope, count):
    """Slopes of 0.5 and 0, with a standard error of 0.01."""
    data = slope * X + 0.04 * np.random.default_rng(2).normal(size=40)
    found = fitted(lambda p: (p[0] * X)[:, None], data, [0.2], [False])
    assert len(found.warnings(("slope",), np.array([False]))) == count


def test_undetermined_parameters_are_reported():
    """Only the product of two factors affects the data."""
    data = 2.0 * X + 0.1 * np.random.default_rng(4).normal(size=40)
    found = fitted(lambda p: (p[0] * p[1] * X)[:, None], data, [1.0, 1.5], [True] * 2)
    words = " ".join(found.warnings(("mass", "gain"), np.array([True, True])))
    assert "distinguish mass from gain" in words and "determine mass" in words


def coverage(model, truth, start, sigma, seed):
    """Return the number of intervals that hold each parameter, of 100 random experiments."""
    both = quick_jit(lambda p: (model(p), jax.jacfwd(model)(p)))
    exact = np.asarray(both(jnp.asarray(truth))[0])
    rng, positive = np.random.default_rng(seed), np.ones(len(truth), bool)
    held, noise, errors = np.zeros(len(truth)), [], []
    for _ in range(TRIALS):
        data = exact + sigma * rng.normal(size=exact.shape)
        found = fit(
            lambda p: both(jnp.asarray(p)), data, np.array(start), positive,
            np.zeros(exact.shape[1], bool),
        )  # fmt: skip
        assert found.found
        held += (found.lower < truth) & (truth < found.upper)
        noise.append(found.noise)
        errors.append(found.errors)
    np.testing.assert_allclose(np.mean(noise), sigma, rtol=0.05)
    return held, np.array(errors)


def test_intervals_hold_a_decaying_oscillation():
    times = np.linspace(0, 6, 60)

    def model(p):
        wave = p[2] * jnp.exp(-p[1] * times)
        return jnp.stack([wave * jnp.cos(p[0] * times), wave / 2 * jnp.sin(p[0] * times)], 1)

    held, _ = coverage(model, np.array([2.0, 0.3, 0.4]), [2.1, 0.33, 0.42], 0.02, 1)
    assert (held >= FEWEST).all() and (held <= MOST).all(), held


@pytest.mark.slow
def test_intervals_hold_the_drag_of_a_driven_swimmer():
    """Use the path of the head with 2 mm of noise, while the joints follow a known wave.

    This case is hard: the path determines the drags only to a fifth of their values.
    """
    keys = ["world.water.form_drag", "world.water.skin_drag"]
    overrides = ["simulation.seconds=1.5", "simulation.substeps=1", "world.water.skin_drag=0.1"]
    parameters = parametrise(load_config(CONFIG, [*TINY, *overrides]), CONFIG, keys)
    simulation = parameters.experiment.simulation
    dofs = simulation.world.tree.dof_count
    phase = 2 * np.pi * np.arange(90)[:, None] / 60 - np.arange(dofs)
    driver = Commanded(tree=simulation.world.tree, rates=2.0 * np.sin(phase))
    times = np.linspace(0.05, 1.5, 60)

    def model(values):
        driven = eqx.tree_at(lambda s: s.controller, parameters.simulation(values), driver)
        columns = ("x", "y", "z")
        return track(driven, jnp.zeros(0), times, columns, {"velocity.x": jnp.asarray(0.5)})

    held, errors = coverage(model, parameters.values, [0.7, 0.15], 2e-3, 1)
    assert (held >= FEWEST).all() and (held <= MOST).all(), held
    assert (errors < 0.5).all()
