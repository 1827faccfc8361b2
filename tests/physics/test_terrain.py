"""Uneven ground: distances by their definition, and bodies on it against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import quick_jit
from evo_cpg.creature.shapes import Box, Sphere
from evo_cpg.physics.contact.terrain import Block, Boulder, Plane, Relief, Shore, nearest
from on_ground import GRAVITY, H, alone, record, released

SLOPE = 0.2


def tilted_grid(slope: float) -> Relief:
    """Return heights of a plane that rises along x, on a grid from -4 to 4 m."""
    x = np.arange(81) * 0.1 - 4.0
    return Relief(np.repeat(slope * x[:, None], 81, 1), (-4.0, -4.0), 0.1)


PARTS = {
    "plane": Plane((0.3, 0.0, 0.954), 0.2),
    "shore": Shore("y", -0.5, 1.5, 0.3, -0.4),
    "relief": tilted_grid(SLOPE),
    "boulder": Boulder((0.2, 0.1, -0.1), 0.5),
    "block": Block((0.1, -0.2, 0.0), (0.5, 0.3, 0.2), 0.4),
}


@pytest.mark.parametrize("name", PARTS)
def test_the_normal_is_the_gradient_of_the_distance(name):
    """This holds except on edges. Parts that rise along x or y have constant slopes."""
    points = np.random.default_rng(1).uniform(-1, 1, (3, 200))
    part = PARTS[name]

    @quick_jit
    def both(points):
        slope = jax.vmap(jax.grad(lambda p: part.distance(p)[0]), -1, -1)
        return part.distance(points)[1], slope(points)

    normal, gradient = map(np.asarray, both(points))
    normal = np.broadcast_to(normal, points.shape)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=0), 1.0, rtol=1e-6)
    np.testing.assert_allclose(gradient, normal, atol=1e-6)


@pytest.mark.parametrize("name", ["plane", "boulder", "block"])
def test_the_distance_leads_to_the_surface(name):
    """A displacement by minus the distance along the normal ends at distance 0."""
    points = np.random.default_rng(2).uniform(-1, 1, (3, 200))
    distance = quick_jit(PARTS[name].distance)
    gap, normal = map(np.asarray, distance(points))
    left, _ = distance(points - gap[None] * normal)
    np.testing.assert_allclose(left, 0.0, atol=2e-6)


def test_the_distance_is_to_the_nearest_part():
    parts = Plane(), Boulder((0.0, 0.0, 0.0), 1.0)
    gap, normal = quick_jit(lambda points: nearest(parts, points))(np.array([[0.0, 3.0]] * 3))
    np.testing.assert_allclose(gap, [-1.0, 3.0], atol=1e-6)
    np.testing.assert_allclose(normal[:, 1], [0.0, 0.0, 1.0])


def test_a_relief_is_bilinear_and_level_beyond_its_edges():
    heights = np.random.default_rng(3).normal(size=(4, 5))
    relief = Relief(heights, (1.0, 2.0), 0.5)

    @quick_jit
    def height(x, y):
        gap, normal = relief.distance(jnp.stack([x, y, jnp.zeros_like(x)]))
        return -gap / normal[2], normal

    x, y = np.meshgrid(1 + 0.5 * np.arange(4), 2 + 0.5 * np.arange(5), indexing="ij")
    np.testing.assert_allclose(height(x, y)[0], heights, atol=1e-12)
    middle, _ = height(x[:-1, :-1] + 0.25, y[:-1, :-1] + 0.25)
    corners = heights[:-1, :-1] + heights[1:, :-1] + heights[:-1, 1:] + heights[1:, 1:]
    np.testing.assert_allclose(middle, corners / 4, atol=1e-12)
    outside, normal = height(np.array([-3.0]), np.array([9.0]))
    np.testing.assert_allclose(outside, heights[:1, -1])
    np.testing.assert_allclose(normal[:, 0], [0.0, 0.0, 1.0])


@pytest.mark.slow
def test_a_relief_accelerates_a_block_like_a_plane():
    """The acceleration is g (sin - mu cos), and the block never leaves the ground."""
    tilt = np.arctan(SLOPE)
    turned = (np.cos(tilt / 2), 0.0, -np.sin(tilt / 2), 0.0)
    world = alone(Box((0.2, 0.2, 0.1)), static=0.1, dynamic=0.1, floor=tilted_grid(SLOPE))
    rest = 0.05 / np.cos(tilt)
    start = released(world, [[1.0], [0.0], [SLOPE + rest]], orientation=turned)
    states, _ = record(world, start, 240)
    down = (np.asarray(states.position)[:, :, 0] @ [np.cos(tilt), 0.0, np.sin(tilt)])[[60, -1]]
    seconds = np.array([61, 240]) * H
    travelled = down[0] - down[1]
    expected = GRAVITY * (np.sin(tilt) - 0.1 * np.cos(tilt)) / 2 * np.diff(seconds**2)[0]
    assert travelled == pytest.approx(expected, rel=0.01)
    above = states.position[:, 2, 0] - SLOPE * states.position[:, 0, 0]
    np.testing.assert_allclose(above, rest, atol=1e-4)


@pytest.mark.slow
def test_a_ball_bounces_off_a_wall():
    """The floor has no friction, and the wall returns half of the speed."""
    wall = Block((2.0, 0.0, 0.0), (0.5, 3.0, 1.0))
    world = alone(Sphere(0.1), restitution=0.5, static=0.0, dynamic=0.0, obstacles=(wall,))
    start = released(world, [[1.0], [0.0], [0.1]], np.array([[0.0, 0, 0, 2.0, 0, 0]]).T)
    states, _ = record(world, start, 120)
    x, speed = states.position[:, 0, 0], states.velocity[:, 3, 0]
    # The step before the impact gets the speed of the return.
    assert 1.4 - 2.0 * H < float(x.max()) < 1.4 + 1e-6
    assert float(speed[-1]) == pytest.approx(-1.0, abs=0.05)
    np.testing.assert_allclose(states.position[:, 2, 0], 0.1, atol=1e-3)
