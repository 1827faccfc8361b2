"""CMA-ES of many searches, on functions with a known optimum."""

import numpy as np

from evo_cpg.evolution import cma


def searched(fitness_of, count, size, generations, children=20, seed=0):
    """Return the searches after some generations, from the middle of the cube."""
    draw, searches = np.random.default_rng(seed), cma.started(np.full((count, size), 0.5), 0.3)
    for _ in range(generations):
        points = cma.children(searches, draw.standard_normal((count, children, size)))
        searches = cma.updated(searches, points, fitness_of(points))
    return searches


def test_optima_of_ill_conditioned_quadratics_are_found():
    """The axes are rotated, and the condition number is 10^6."""
    draw = np.random.default_rng(1)
    optima, axes = draw.uniform(0.2, 0.8, (6, 5)), np.linalg.qr(draw.normal(size=(6, 5, 5)))[0]
    scales = np.logspace(0, 6, 5)

    def fitness_of(points):
        apart = (points - optima[:, None]) @ axes
        return -(scales * apart**2).sum(-1)

    found = searched(fitness_of, 6, 5, 250)
    np.testing.assert_allclose(found.mean, optima, atol=1e-6)
    # C becomes the inverse of the Hessian up to a factor (Hansen 2016, section 1.1).
    shaped = np.swapaxes(axes, 1, 2) @ found.covariance @ axes * scales
    learned = np.diagonal(shaped, axis1=1, axis2=2)
    assert (learned.max(1) / learned.min(1) < 30).all()


def test_searches_do_not_depend_on_each_other():
    draw = np.random.default_rng(2)
    numbers, optima = draw.standard_normal((30, 3, 8, 2)), draw.random((3, 1, 2))

    def run(chosen):
        searches = cma.started(np.full((len(chosen), 2), 0.5), 0.3)
        for normal in numbers:
            points = cma.children(searches, normal[chosen])
            searches = cma.updated(searches, points, -np.abs(points - optima[chosen]).sum(-1))
        return searches.mean

    np.testing.assert_allclose(run([2]), run([0, 1, 2])[2:], atol=1e-12)


def test_an_optimum_in_a_corner_is_reached():
    found = searched(lambda points: points.sum(-1), 4, 5, 60)
    best = cma.children(found, np.zeros((4, 1, 5)))
    np.testing.assert_allclose(best, 1, atol=1e-3)
