"""Bodies do not pass through the ground, at any speed and any thickness of the ground."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import ConvexHull

from creatures import quick_jit
from evo_cpg.creature.mesh import convex_mesh
from evo_cpg.creature.shapes import Box, Capsule, Ellipsoid, Sphere
from evo_cpg.physics.contact.contact import find_contacts
from evo_cpg.physics.contact.contact_points import contact_points
from evo_cpg.physics.contact.terrain import Block, Boulder, Plane, Relief, Shore
from evo_cpg.physics.tree.kinematics import kinematics
from on_ground import H, alone, record, released

ABYSS = Plane(height=-1000.0)
THIN = Block((0.0, 0.0, 0.0), (1.0, 1.0, 0.001))
SPEEDS = np.array([5.0, 20.0, 44.0, 100.0, 300.0])


def brick():
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    hull = ConvexHull(signs)
    faces = [face if np.linalg.det(signs[face]) > 0 else face[::-1] for face in hull.simplices]
    return convex_mesh(signs * [0.05, 0.04, 0.03], np.array(faces))[0]


SHAPES = {
    "ball": (Sphere(0.05), 0.05),
    "box": (Box((0.1, 0.1, 0.06)), 0.03),
    "plate": (Box((0.3, 0.3, 0.004)), 0.002),
    "capsule": (Capsule(0.02, 0.1), 0.02),
    "ellipsoid": (Ellipsoid((0.05, 0.04, 0.03)), 0.03),
    "mesh": (brick(), 0.03),
}
# Each shape has its own rule for its nearest point. `make test-slow` tests all of them.
ALL = [
    pytest.param(name, marks=[] if name in ("ball", "box") else pytest.mark.slow) for name in SHAPES
]


def thrown(world, place, velocity, steps, h=H):
    """Return positions and velocities of thrown, level bodies, ``(steps, 3 or 6, n)``."""
    place, velocity = (np.array(x, float).T for x in (place, velocity))
    turning = np.zeros_like(velocity)
    states, _ = record(world, released(world, place, np.concatenate([turning, velocity])), steps, h)
    return states.position, states.velocity


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL)
def test_nothing_falls_through_a_thin_block(name):
    """The block is 2 mm thick, and steps begin at any distance from it."""
    shape, half = SHAPES[name]
    world = alone(shape, obstacles=(THIN,), floor=ABYSS)
    speeds = np.repeat(SPEEDS, 4)
    height = 0.3 + np.tile([0.0, 0.13, 0.31, 0.57], len(SPEEDS))
    start = np.stack([0.1 + 0 * height, 0 * height, height], 1)
    place, velocity = thrown(world, start, np.outer(speeds, [0.0, 0.0, -1.0]), 50)
    assert place[:, 2].min() > half
    fast = (speeds > 10) & (speeds < 50)
    np.testing.assert_allclose(place[-1, 2, fast], 0.001 + half, atol=0.015)
    # They hardly bounce without restitution.
    assert (velocity[-1, 5] < 0.02 * speeds).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "ball",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in SHAPES
            if name not in ("ball", "plate")
        ),
    ],
)
def test_nothing_falls_through_a_pebble(name):
    """The radius is 1 cm. Some bodies fall next to it and do not touch it."""
    shape, half = SHAPES[name]
    world = alone(shape, obstacles=(Boulder((0.0, 0.0, 0.0), 0.01),), floor=ABYSS)
    speeds = np.repeat([20.0, 44.0, 100.0], 3)
    height, aside = np.tile([0.3, 0.43, 0.61], 3), np.tile([0.0, 0.0, 0.2], 3)
    start = np.stack([aside, 0 * height, height], 1)
    # The path ends up to two steps after the contact.
    place, velocity = thrown(world, start, np.outer(speeds, [0.0, 0.0, -1.0]), 12)
    after = np.ceil(height / speeds / H).astype(int) + 2
    met = aside == 0
    for k in np.flatnonzero(met):
        assert place[: after[k], 2, k].min() > 0.5 * half
        assert velocity[min(after[k], 11), 5, k] > -0.05 * speeds[k]
    np.testing.assert_allclose(velocity[-1, 5, ~met], -speeds[~met] - 12 * H * 9.81, rtol=1e-6)


@pytest.mark.slow
def test_a_ball_stops_at_the_first_of_several_walls():
    walls = tuple(Block((1.0 + 0.2 * k, 0.0, 1.0), (0.001, 1.0, 1.0)) for k in range(4))
    # The ball also slides on a block, which touches it on the whole path.
    path = Block((0.0, 0.0, -0.5), (3.0, 1.0, 0.5))
    world = alone(Sphere(0.05), obstacles=(*walls, path), floor=ABYSS)
    start = [[0.0, 0.0, 0.5], [0.13, 0.2, 1.0], [0.3, 0.0, 1.9], [0.0, 0.0, 0.05], [0.3, 0.0, 2.1]]
    place, _ = thrown(world, start, np.tile([50.0, 0.0, 0.0], (5, 1)), 12)
    assert (place[:, 0, :4] < 0.95).all()
    np.testing.assert_allclose(place[-1, 0, :4], 0.949, atol=0.01)
    assert place[-1, 0, 4] > 2.0


@pytest.mark.slow
def test_a_small_margin_stops_bodies_too():
    world = alone(Sphere(0.05), obstacles=(THIN,), floor=ABYSS, margin=1e-3)
    start = [[0.0, 0.0, 0.3], [0.0, 0.0, 0.3], [0.0, 0.0, 0.0515]]
    place, _ = thrown(world, start, [[0.0, 0.0, -44.0], [0.0, 0.0, -1.0], [0.0, 0.0, 0.0]], 90)
    np.testing.assert_allclose(place[-1, 2], 0.051, atol=1e-4)
    assert place[:, 2].min() > 0.05


@pytest.mark.parametrize(
    ("name", "floor"),
    [
        ("ball", "hills"),
        pytest.param("box", "cliff", marks=pytest.mark.slow),
        pytest.param("ball", "slope", marks=pytest.mark.slow),
        pytest.param("ball", "cliff", marks=pytest.mark.slow),
        pytest.param("box", "level", marks=pytest.mark.slow),
    ],
)
@pytest.mark.slow
def test_no_body_enters_a_floor(name, floor):
    """Centres stay outside at 50 m/s, although one step would move them 0.2 m into the floor."""
    shape, _ = SHAPES[name]
    grid = np.arange(41) * 0.05 - 1.0
    ground = {
        "level": Plane(),
        "slope": Shore("x", 0.0, 1.0, 0.0, 1.0),
        "cliff": Shore("x", 0.0, 0.05, 0.0, 1.0),
        "hills": Relief(0.1 * np.sin(8.0 * grid)[:, None] + np.zeros(41), (-1.0, -1.0), 0.05),
    }[floor]
    world = alone(shape, floor=ground)
    start = [[-0.5, 0.0, 0.2], [-0.3, 0.0, 0.2], [-0.3, 0.0, 1.5]]
    speed = [[50.0, 0.0, 0.0], [50.0, 0.0, 0.0], [0.0, 0.0, -60.0]]
    place, _ = thrown(world, start, speed, 10)
    depth = np.asarray(ground.distance(jnp.asarray(place.swapaxes(0, 1)))[0])
    # In a kink of the floor, a ball touches only the plane under its centre and enters the other.
    assert depth.min() > -0.025


@pytest.mark.slow
def test_a_rod_that_whirls_does_not_pass_a_post():
    """It turns by up to a quarter per step. Steps a fiftieth as long give the same result."""
    post = Block((0.25, 0.12, 0.0), (0.005, 0.005, 1.0))
    world = alone(Capsule(0.02, 0.56), obstacles=(post,), floor=ABYSS)
    spin = np.array([20.0, 50.0, 100.0, 150.0])
    speed = np.zeros((6, 4))
    speed[2] = spin
    start = released(world, np.zeros((3, 4)), speed)
    ends = [
        np.asarray(record(world, start, count, 0.06 / count)[0].velocity[-1, 2])
        for count in (14, 700)
    ]
    assert (ends[0] < 0.4 * spin).all()
    np.testing.assert_allclose(ends[0] / spin, ends[1] / spin, atol=0.06)


@pytest.mark.slow
def test_slow_parts_are_not_swept():
    """A displacement of 4 cm in a step is slow for a margin of 5 cm."""
    obstacles = THIN, Boulder((0.3, 0.0, 0.0), 0.1)
    floor = Shore("x", 0.0, 1.0, -0.5, 0.5)
    for name in ("ball", "mesh"):
        shape, _ = SHAPES[name]
        world = alone(shape, obstacles=obstacles, floor=floor)
        velocity = np.array([[0.0] * 5 + [v] for v in (-0.039 / H, -0.06 / H)]).T
        start = released(world, np.tile([[0.2], [0.0], [0.25]], 2), velocity)
        contact_model = world.contact_model

        @quick_jit
        def points(state, world=world, contact_model=contact_model):
            kin = kinematics(world.tree, state)
            return contact_points(contact_model, kin, H), contact_points(contact_model, kin)

        swept, still = points(start)
        assert not np.asarray(still.ahead).any()
        assert (np.asarray(swept.ahead)[:, 0] == 0).all()
        assert (np.asarray(swept.ahead)[:, 1] > 0).any()
        if name == "ball":
            np.testing.assert_array_equal(swept.gap[:, 0], still.gap[:, 0])


@pytest.mark.slow
def test_a_swept_contact_has_the_right_derivative():
    """Differentiate v* by height and speed. It is the distance to the boulder over the step."""
    world = alone(Sphere(0.05), obstacles=(Boulder((0.0, 0.0, 0.0), 0.1),), floor=ABYSS)

    def rest(height, speed):
        state = released(world, np.zeros((3, 1)))
        place = jnp.zeros((3, 1)).at[2].set(height)
        velocity = jnp.zeros((6, 1)).at[5].set(-speed)
        state = dataclasses.replace(state, position=place, velocity=velocity)
        return find_contacts(world.contact_model, kinematics(world.tree, state), H).rest_velocity[
            -1, 0
        ]

    value, slopes = quick_jit(jax.value_and_grad(rest, (0, 1)))(0.3, 44.0)
    # It is up to 2 % larger, to compensate for the compliance of the law.
    assert float(value) == pytest.approx(-0.15 / H, rel=0.02)
    assert float(slopes[0]) == pytest.approx(-1.0 / H, rel=0.02)
    assert abs(float(slopes[1])) < 0.02
