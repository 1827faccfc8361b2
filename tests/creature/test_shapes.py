"""Masses, areas and distances of shapes against closed forms, MuJoCo and sampling."""

import mujoco
import numpy as np
import pytest
from scipy.special import ellipeinc, ellipkinc

from benchmarks.mujoco_model import mujoco_model
from evo_cpg.creature.creature import Body, Creature, Material
from evo_cpg.creature.cylinder import Cylinder
from evo_cpg.creature.shapes import Box, Capsule, Ellipsoid, NoShape, Shape, Sphere

SHAPES = {
    "box": Box((0.3, 0.2, 0.1)),
    "sphere": Sphere(0.15),
    "ellipsoid": Ellipsoid((0.3, 0.2, 0.1)),
    "capsule": Capsule(0.05, 0.2),
    "cylinder": Cylinder(0.1, 0.25),
}
each_shape = pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES.keys())


def exact_area(shape: Shape) -> float:
    """Return the area in closed form, with Legendre's elliptic integrals for ellipsoids."""
    if isinstance(shape, Box):
        x, y, z = shape.size
        return 2 * (x * y + y * z + z * x)
    if isinstance(shape, Sphere):
        return 4 * np.pi * shape.radius**2
    if isinstance(shape, Capsule):
        return 2 * np.pi * shape.radius * (shape.length + 2 * shape.radius)
    if isinstance(shape, Cylinder):
        return 2 * np.pi * shape.radius * (shape.length + shape.radius)
    a, b, c = sorted(shape.radii, reverse=True)
    phi = np.arccos(c / a)
    modulus = a**2 * (b**2 - c**2) / (b**2 * (a**2 - c**2))
    series = ellipeinc(phi, modulus) * np.sin(phi) ** 2
    series += ellipkinc(phi, modulus) * np.cos(phi) ** 2
    return 2 * np.pi * (c**2 + a * b / np.sin(phi) * series)


@each_shape
def test_mass_and_inertia_equal_mujocos(shape):
    """Compare mass and inertia with MuJoCo's, computed from the density, to 1e-12."""
    creature = Creature("single", (Body("b", shape, Material(1234.0)),))
    model = mujoco_model(creature)
    body = model.body("b")
    assert 1234.0 * shape.volume == pytest.approx(body.mass[0], rel=1e-12)
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, body.iquat)
    rotation = rotation.reshape(3, 3)
    full = rotation @ np.diag(body.inertia) @ rotation.T
    np.testing.assert_allclose(
        shape.inertia(creature.mass), full, rtol=1e-12, atol=1e-12 * full.max()
    )


@each_shape
def test_volume_and_inertia_equal_samples_inside(shape):
    """Compare with grid points of negative distance: their fraction and second moments.

    A grid of 80^3 has random errors along the surface of a few 1e-3.
    """
    ticks = (np.arange(80) + 0.5) / 40 - 1
    points = np.stack(np.meshgrid(ticks, ticks, ticks), -1).reshape(-1, 3) * shape.half_extents
    inside = points[shape.distance(points) < 0]
    fraction = len(inside) / len(points)
    assert fraction * 8 * np.prod(shape.half_extents) == pytest.approx(shape.volume, rel=5e-3)
    squares = (inside**2).mean(0)
    np.testing.assert_allclose(squares.sum() - squares, np.diag(shape.inertia(1.0)), rtol=5e-3)


@each_shape
def test_cells_have_the_moments_of_the_shape(shape):
    """Compare volume, centre and second moments.

    The variance of a cell is 1/3 (box), 1/5 (ball) or 1/4 (disc) of its squared half axis. A
    cylinder is a box along x and a disc across.
    """
    variance = {"box": 1 / 3, "ball": 1 / 5, "disc": 1 / 4}
    variance["cylinder"] = np.array([1 / 3, 1 / 4, 1 / 4])
    volume = np.array([cell.volume for cell in shape.cells()])
    centre = np.array([cell.centre for cell in shape.cells()])
    own = np.array([variance[cell.profile] * np.square(cell.half_axes) for cell in shape.cells()])
    assert volume.sum() == pytest.approx(shape.volume, rel=1e-12)
    np.testing.assert_allclose(volume @ centre, 0, atol=1e-15)
    second = volume @ (own + centre**2)
    np.testing.assert_allclose(
        second.sum() - second, np.diag(shape.inertia(1.0)) * shape.volume, rtol=1e-12
    )


@each_shape
def test_area(shape):
    """The quadrature's weights sum to the area, exactly except for the ellipsoid."""
    tolerance = 1e-6 if type(shape) is Ellipsoid else 1e-12
    assert shape.surface(10).areas.sum() == pytest.approx(exact_area(shape), rel=tolerance)


@each_shape
@pytest.mark.parametrize("resolution", [2, 5])
def test_divergence_theorem(shape, resolution):
    """int n dA = 0, int x n^T dA = V 1, and hence int n.x dA = 3 V.

    The rules integrate all integrands exactly, because they are polynomials. For the ellipsoid,
    n dA is linear in the direction on the sphere, so x n^T dA is quadratic. For the capsule it is
    quadratic on either end, which needs two nodes per end (resolution 2).
    """
    points, normals, areas = shape.surface(resolution)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, rtol=1e-14)
    assert (areas > 0).all()
    np.testing.assert_allclose(areas @ normals, 0, atol=1e-14)
    moment = np.einsum("p,pi,pj->ij", areas, points, normals)
    np.testing.assert_allclose(moment, shape.volume * np.eye(3), atol=1e-12 * shape.volume)


@each_shape
def test_surface_points_and_normals_are_on_the_surface(shape):
    """The distance is 0 at the points, negative slightly inside and positive outside."""
    points, normals, _ = shape.surface(4)
    np.testing.assert_allclose(shape.distance(points), 0, atol=1e-15)
    assert (shape.distance(points + 1e-4 * normals) > 0).all()
    assert (shape.distance(points - 1e-4 * normals) < 0).all()


def test_ellipsoid_area_converges_with_resolution():
    """Convergence is spectral: a doubling gains a factor of 50 first, and then 500."""
    shape = SHAPES["ellipsoid"]
    exact = exact_area(shape)
    errors = [abs(shape.surface(n).areas.sum() / exact - 1) for n in (2, 4, 8)]
    assert errors[0] > 50 * errors[1] and errors[1] > 500 * errors[2], errors


@each_shape
def test_layout_is_symmetric(shape):
    """Mirror images of the points are points of equal area."""
    points, _, areas = shape.surface(3)
    table = {tuple(np.round(p, 9) + 0.0): a for p, a in zip(points, areas, strict=True)}
    assert len(table) == len(points)
    for axis in range(3):
        mirror = np.ones(3)
        mirror[axis] = -1
        for point, area in zip(points, areas, strict=True):
            assert table[tuple(np.round(point * mirror, 9) + 0.0)] == pytest.approx(area)


@pytest.mark.parametrize("name", ["box", "sphere", "capsule", "cylinder"])
def test_distance_is_exact(name):
    """Compare distances outside with the nearest of many points on the surface.

    The nearest point is within 1 cm of the true foot, perpendicular to the distance. It is up to
    0.5 mm away from an edge, because Gauss points do not reach the edge.
    """
    shape = SHAPES[name]
    rng = np.random.default_rng(0)
    points = rng.normal(size=(300, 3))
    points *= (rng.uniform(1.5, 3, 300) * 0.2 / np.linalg.norm(points, axis=1))[:, None]
    ours = shape.distance(points)
    surface = shape.surface(40).points
    nearest = np.linalg.norm(points[:, None] - surface, axis=-1).min(1)
    assert (nearest >= ours - 1e-12).all()
    assert (nearest <= np.hypot(ours, 1e-2) + 5e-4).all()


def test_distance_inside_a_box_is_to_the_nearest_face():
    box = Box((0.4, 0.2, 0.2))
    np.testing.assert_allclose(
        box.distance(np.array([[0.0, 0, 0], [0.15, 0.02, 0]])), [-0.1, -0.05]
    )


def test_ellipsoid_distance_has_the_right_sign():
    """Compare with the implicit function. The centre has minus the least radius."""
    shape = SHAPES["ellipsoid"]
    points = np.random.default_rng(1).uniform(-0.35, 0.35, (1000, 3))
    level = ((points / shape.half_extents) ** 2).sum(1) - 1
    np.testing.assert_array_equal(np.sign(shape.distance(points)), np.sign(level))
    assert shape.distance(np.zeros((1, 3)))[0] == -0.1


@each_shape
def test_support_is_the_farthest_point_of_the_surface(shape):
    """The point lies on the surface, and no point of a fine quadrature is farther."""
    points = shape.surface(60).points
    for direction in (*np.eye(3), *-np.eye(3), *np.random.default_rng(2).normal(size=(20, 3))):
        point = shape.support(direction)
        assert shape.distance(point[None])[0] == pytest.approx(0, abs=1e-15)
        reach = (points - point) @ direction / np.linalg.norm(direction)
        assert -5e-4 < reach.max() < 1e-15
        np.testing.assert_allclose(shape.support(3 * direction), point, rtol=0, atol=1e-15)


@each_shape
def test_height_equals_the_support(shape):
    """Compare several directions at once with one direction at a time."""
    directions = np.random.default_rng(2).normal(size=(4, 5, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    one_by_one = [[one @ shape.support(one) for one in row] for row in directions]
    np.testing.assert_allclose(shape.height(directions), one_by_one, rtol=1e-12)


@each_shape
def test_skin_approximates_the_shape(shape):
    """Points lie in the shape, triangles look outwards, and little volume is missing.

    The default skin of a shape without edges passes the test too.
    """
    skins = [shape.skin()] if shape.blunt else [shape.skin(), Shape.skin(shape)]
    for points, normals, faces in skins:
        assert shape.distance(points).max() < 1e-12
        a, b, c = points[faces].swapaxes(0, 1)
        volume = np.linalg.det(np.stack([a, b, c], 1)).sum() / 6
        assert 0.85 * shape.volume < volume < 1.001 * shape.volume
        across = np.cross(b - a, c - a)
        assert ((normals[faces].sum(1) * across).sum(1) >= -1e-15).all()


def test_a_shape_without_contact_points_raises():
    for parts in (Shape.floor_parts, Shape.obstacle_parts):
        with pytest.raises(
            TypeError, match=rf"no contact points for a NoShape\. Define {parts.__name__}"
        ):
            parts(NoShape())


def test_support_is_in_the_middle_of_a_face():
    np.testing.assert_array_equal(SHAPES["box"].support(np.array([0, 0, -2.0])), [0, 0, -0.05])
    np.testing.assert_array_equal(SHAPES["capsule"].support(np.array([0, 0, 1.0])), [0, 0, 0.05])
