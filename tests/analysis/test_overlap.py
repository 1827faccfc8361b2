"""Distances and depths of convex shapes, against closed forms and minimisation."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from evo_cpg.analysis.excursions import gaps
from evo_cpg.creature.mesh import convex_mesh
from evo_cpg.creature.shapes import Box, Capsule, Ellipsoid, Sphere

EGG = Ellipsoid((0.18, 0.08, 0.03))
OCTAHEDRON, _ = convex_mesh(
    0.1 * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]),
    np.array(
        [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
    ),
)
# An asymmetric shape with its centre of mass at the origin.
WEDGE, _ = convex_mesh(
    0.1 * np.array([[3, 0, 0], [-1, 2, 0], [-1, -1, 1.5], [-1, -1, -1.5]]),
    np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]),
)


def gap(first, second, offset, turn=None):
    """Return the gap of two shapes, the first in the world's frame."""
    turn = np.eye(3) if turn is None else turn
    (found,) = gaps(
        (first, second),
        (np.zeros((1, 3)), np.array([offset], float)),
        (np.eye(3)[None], turn[None]),
    )
    return found


@pytest.mark.parametrize(
    ("first", "second", "offset", "expected"),
    [
        (Sphere(0.1), Sphere(0.2), (0.5, 0.1, 0.2), np.sqrt(0.3) - 0.3),
        (Sphere(0.1), Sphere(0.2), (0.0, 0.25, 0.0), -0.05),
        (EGG, EGG, (0.4, 0.0, 0.0), 0.04),
        (EGG, EGG, (0.0, 0.0, 0.05), -0.01),
        (EGG, Box((0.1, 0.1, 0.1)), (0.0, 0.15, 0.0), 0.02),
        (Capsule(0.05, 0.2), EGG, (0.0, 0.0, 0.1), 0.02),
        # The nearest point is on a face.
        (OCTAHEDRON, Sphere(0.05), (0.1, 0.1, 0.1), np.sqrt(3) * (0.1 - 0.1 / 3) - 0.05),
        (WEDGE, Sphere(0.05), (0.4, 0.0, 0.0), 0.05),
        (WEDGE, Sphere(0.05), (-0.4, 0.0, 0.0), 0.25),
        (OCTAHEDRON, OCTAHEDRON, (0.06, 0.06, 0.06), (0.18 - 0.2) / np.sqrt(3)),
    ],
)
def test_distances_equal_closed_forms(first, second, offset, expected):
    assert gap(first, second, offset) == pytest.approx(expected, abs=1e-6)
    assert gap(second, first, -np.array(offset)) == pytest.approx(expected, abs=1e-6)


def test_distance_of_ellipsoids_equals_minimisation():
    rng = np.random.default_rng(4)
    found = 0
    for _ in range(12):
        turn = Rotation.random(None, rng).as_matrix()
        other = Ellipsoid(tuple(rng.uniform(0.03, 0.2, 3)))
        offset = rng.normal(size=3)
        offset *= 0.35 / np.linalg.norm(offset)

        def between(x, turn=turn, other=other, offset=offset):
            one = np.array(EGG.radii) * x[:3] / np.linalg.norm(x[:3])
            two = offset + turn @ (np.array(other.radii) * x[3:] / np.linalg.norm(x[3:]))
            return np.linalg.norm(one - two)

        start = np.concatenate([offset, -(turn.T @ offset)])
        nearest = minimize(between, start, tol=1e-12).fun
        mine = gap(EGG, other, offset, turn)
        if mine > 0:
            found += 1
            assert mine == pytest.approx(nearest, abs=1e-5)
    assert found > 5


def test_shapes_that_fill_their_rounded_boxes():
    fill = (Sphere(0.1), Box((0.1, 0.2, 0.3)), Capsule(0.05, 0.2))
    assert all(shape.fills_rounded_box for shape in fill)
    assert not any(shape.fills_rounded_box for shape in (EGG, OCTAHEDRON))
