"""Mesh bodies in water and on the ground, against boxes, spheres, Qhull and Archimedes."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.spatial

from creatures import coast, in_water, last, quick_jit, resting, single, slope
from evo_cpg.creature.creature import Creature, lowest_height
from evo_cpg.creature.mesh import ConvexMesh
from evo_cpg.creature.shapes import Box, Sphere
from evo_cpg.creature.tree import build_tree
from evo_cpg.physics.contact.contact_points import clearance
from evo_cpg.physics.contact.terrain import Block
from evo_cpg.physics.step.step import step
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.water.added_mass import added_inertia
from evo_cpg.physics.water.buoyancy import displacement, make_cells
from evo_cpg.physics.water.fluid import Drag, drag
from on_ground import DENSITY, alone, record, released
from polyhedra import ball_mesh, box_mesh, tetrahedron, wedge

SIZE = (0.3, 0.2, 0.1)
GRAVITY, WATER = 9.81, 1000.0


def directions(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return upward directions ``(3, count)``, including the axes."""
    up = rng.normal(size=(3, count))
    up[:, :3] = np.eye(3)
    up[:, 3] = 0.02, 0.0, 1.0
    return up / np.linalg.norm(up, axis=0)


def under_water(mesh: ConvexMesh, up: np.ndarray, height: float) -> tuple[float, np.ndarray]:
    """Return volume and first moment below the surface, from the hull of this part (Qhull)."""
    (cell,) = mesh.cells()
    points = cell.triangles.reshape(-1, 3)
    z = points @ up + height
    edges = np.concatenate([cell.triangles[:, [i, (i + 1) % 3]] for i in range(3)])
    ends = edges @ up + height
    cut = ends[:, 0] * ends[:, 1] < 0
    share = (ends[cut, 0] / (ends[cut, 0] - ends[cut, 1]))[:, None]
    crossings = edges[cut, 0] + share * (edges[cut, 1] - edges[cut, 0])
    left = np.concatenate([points[z <= 0], crossings])
    if len(left) < 4:
        return 0.0, np.zeros(3)
    hull = scipy.spatial.Delaunay(left, qhull_options="QJ Pp")
    corners = left[hull.simplices]
    volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6
    return volumes.sum(), volumes @ corners.mean(1)


def displaced(creature: Creature, pose):
    """Return displaced volume and moment as NumPy arrays."""
    cells = make_cells(creature, build_tree(creature))
    return jax.tree.map(np.asarray, quick_jit(lambda pose: displacement(cells, pose))(pose))


def resistance(world, velocity) -> list[np.ndarray]:
    """Return the wrench of the drag and its derivative."""
    run = quick_jit(lambda v: drag(world.law(Drag), world.water.density, v))
    return list(map(np.asarray, run(velocity)))


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize(
    "mesh", [box_mesh(SIZE), tetrahedron(), wedge(), ball_mesh(0.1, 1)], ids="btwo"
)
def test_displaced_volume_and_moment_are_exact(mesh, dtype):
    """They equal those of the cut polyhedron in any position, to 1e-6 (Qhull's joggle) or 1e-5."""
    rng = np.random.default_rng(0)
    up = directions(rng, 20)
    height = rng.uniform(-1, 1, 20) * np.ptp(mesh.points @ up, axis=0) / 2
    creature = single(mesh)
    found = displaced(creature, np.concatenate([up, height[None]])[:, None].astype(dtype))
    size = np.linalg.norm(mesh.half_extents)
    tolerance = 1e-6 if dtype == np.float64 else 1e-5
    for k in range(20):
        volume, moment = under_water(mesh, up[:, k], height[k])
        assert found.volume[0, k] == pytest.approx(volume, abs=tolerance * mesh.volume)
        np.testing.assert_allclose(
            np.cross(found.moment[:, 0, k], up[:, k]),
            np.cross(moment, up[:, k]),
            atol=tolerance * mesh.volume * size,
        )


@pytest.mark.parametrize(("height", "share"), [(10.0, 0.0), (-10.0, 1.0), (-1e4, 1.0)])
def test_a_body_far_from_the_surface_is_wet_or_dry(height, share):
    """Compute in single precision, far from the surface."""
    creature = single(wedge())
    pose = np.array([0.6, 0.0, 0.8, height], np.float32)[:, None, None]
    found = displaced(creature, pose)
    volume = creature.bodies[0].shape.volume
    assert float(found.volume[0, 0]) / volume == pytest.approx(share, abs=1e-5)
    assert np.abs(np.cross(found.moment[:, 0, 0], pose[:3, 0, 0])).max() < 1e-6 * volume


@pytest.mark.slow
@pytest.mark.parametrize("density", [200.0, 500.0, 800.0])
def test_draught_of_a_box_follows_archimedes(density):
    """The draught is the relative density times the height. Released there, the box stays."""
    world = in_water(single(box_mesh(SIZE), density), surface=0.0)
    height = SIZE[2] * (0.5 - density / WATER)
    end = last(coast(world, resting(world.tree, (1,), height), 2.0, 1 / 120))
    np.testing.assert_allclose(end.position[:, 0], [0, 0, height], atol=1e-9)
    np.testing.assert_allclose(end.orientation[:, 0], [1, 0, 0, 0], atol=1e-9)


def twist(rng: np.random.Generator, count: int) -> jax.Array:
    return jnp.asarray(rng.normal(size=(6, 1, count)))


@pytest.mark.parametrize("resolution", [1, 2])
def test_drag_of_a_box_mesh_equals_the_box(resolution):
    velocity = twist(np.random.default_rng(1), 20)
    ours, theirs = (in_water(single(shape), resolution) for shape in (box_mesh(SIZE), Box(SIZE)))
    both = (resistance(world, velocity) for world in (ours, theirs))
    for found, expected in zip(*both, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(("resolution", "tolerance"), [(2, 0.05), (4, 0.02)])
def test_drag_of_a_ball_mesh_is_near_the_sphere(resolution, tolerance):
    """It is C_d + 3 pi/4 C_f times the section in 50 directions, with a small side force."""
    mesh = ball_mesh(0.1, 3)
    world = in_water(single(mesh), resolution, form_drag=1.0, skin_drag=0.05)
    rng = np.random.default_rng(2)
    direction = rng.normal(size=(3, 50))
    direction /= np.linalg.norm(direction, axis=0)
    velocity = jnp.asarray(np.concatenate([np.zeros((3, 50)), direction])[:, None])
    wrench, _ = resistance(world, velocity)
    force = wrench[3:, 0]
    expected = 500 * (1 + 3 * np.pi / 4 * 0.05) * np.pi * 0.1**2
    along = -(force * direction).sum(0)
    np.testing.assert_allclose(along, expected, rtol=tolerance)
    assert np.linalg.norm(force + along * direction, axis=0).max() < tolerance * expected


def test_added_mass_of_meshes_equals_the_shapes():
    """A box mesh equals the box, a turned mesh turns it, and a ball moves half of its water."""
    for shape in (box_mesh(SIZE), Box(SIZE)):
        creature = single(shape)
        found = added_inertia(creature, build_tree(creature), WATER)[..., 0]
        if isinstance(shape, ConvexMesh):
            ours = found
    np.testing.assert_allclose(ours, found, rtol=1e-9, atol=1e-9)
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    mesh = box_mesh(SIZE)
    turned = ConvexMesh(tuple(map(tuple, mesh.points @ turn.T)), mesh.faces)
    creature = single(turned)
    whole = np.kron(np.eye(2), turn)
    np.testing.assert_allclose(
        added_inertia(creature, build_tree(creature), WATER)[..., 0],
        whole @ found @ whole.T,
        atol=1e-9,
    )
    creature = single(ball_mesh(0.1, 3))
    ball = added_inertia(creature, build_tree(creature), WATER)[..., 0]
    half = WATER * Sphere(0.1).volume / 2
    np.testing.assert_allclose(ball, np.diag([0, 0, 0, half, half, half]), atol=0.01 * half)


def tumbled(count: int) -> np.ndarray:
    orientation = np.random.default_rng(4).normal(size=(4, count))
    return orientation / np.linalg.norm(orientation, axis=0)


@pytest.mark.parametrize("mesh", [box_mesh(SIZE), tetrahedron(), wedge()], ids="btw")
def test_the_lowest_corner_always_counts(mesh):
    """The least clearance, and the start height, are the lowest vertex's in 200 positions."""
    count = 200
    world = alone(mesh)
    state = released(world, np.tile([[0.0], [0.0], [1.0]], count), orientation=(1.0, 0, 0, 0))
    state = dataclasses.replace(state, orientation=jnp.asarray(tumbled(count)))
    kin = quick_jit(lambda s: kinematics(world.tree, s))(state)
    found = np.asarray(quick_jit(lambda k: clearance(world.contact_model, k))(kin)).min(0)
    rotation = np.asarray(kin.rotation[:, :, 0])
    lowest = np.einsum("jn,vj->vn", rotation[2], mesh.points).min(0)
    np.testing.assert_allclose(found, 1 + lowest, atol=1e-12)
    assert lowest_height(single(mesh)) == pytest.approx(mesh.points[:, 2].min(), rel=1e-12)


@pytest.mark.slow
def test_a_box_stands_on_its_four_corners():
    """Each corner carries a quarter of the weight, for any turn about the vertical."""
    world = alone(box_mesh(SIZE))
    half = np.deg2rad([0, 10, 45, 70]) / 2
    state = released(world, np.tile([[0.0], [0.0], [0.05]], 4))
    turned = jnp.asarray([np.cos(half), 0 * half, 0 * half, np.sin(half)])
    state = dataclasses.replace(state, orientation=turned)
    _, support = record(world, state, 240)
    weight = DENSITY * Box(SIZE).volume * GRAVITY
    np.testing.assert_allclose(np.asarray(support)[-1, 2], weight / 4, rtol=1e-3)


@pytest.mark.slow
def test_a_dropped_box_mesh_rests_like_the_box():
    """A drop from 16 positions ends on a face, at the height of the box, and is never deep."""
    count = 16
    ends, depths = [], []
    for shape in (box_mesh(SIZE), Box(SIZE)):
        world = alone(shape, restitution=0.1)
        state = released(world, np.tile([[0.0], [0.0], [0.4]], count))
        state = dataclasses.replace(state, orientation=jnp.asarray(tumbled(count)))
        states, support = record(world, state, 720)
        ends.append(np.asarray(states.position)[-1, 2])
        speed = np.abs(np.asarray(states.velocity)[-1])
        assert speed.max() < 0.01
        weight = DENSITY * Box(SIZE).volume * GRAVITY
        np.testing.assert_allclose(np.asarray(support)[-1, 2].sum(0), weight, rtol=0.01)
        depths.append(np.asarray(states.position)[:, 2].min())
    for height in ends[0]:
        assert np.abs(np.array(SIZE) / 2 - height).min() < 1e-3
    assert depths[0] > 0.045
    np.testing.assert_allclose(np.mean(ends[0]), np.mean(ends[1]), atol=0.03)


@pytest.mark.slow
def test_a_ball_rolls_to_rest_without_sinking():
    """The centre of a ball of 162 vertices and 64 corners at 1 m/s stays near one radius high."""
    mesh = ball_mesh(0.1, 2)
    world = alone(mesh)
    start = released(world, [[0.0], [0.0], [0.1]], np.array([[0], [10.0], [0], [1.0], [0], [0]]))
    states, _ = record(world, start, 480)
    height = np.asarray(states.position)[:, 2, 0]
    assert height.min() > 0.09 and height.max() < 0.105
    assert np.asarray(states.position)[-1, 0, 0] > 0.2


@pytest.mark.slow
def test_a_mesh_touches_a_block_and_the_floor():
    """A box mesh rests on a block, with points of its corners and of an ellipsoid."""
    block = Block((0.0, 0.0, 0.1), (1.0, 1.0, 0.1), 0.0)
    world = alone(box_mesh(SIZE), obstacles=(block,))
    assert len(world.contact_model.bodies) == 9
    state = released(world, [[0.0], [0.0], [0.25]])
    states, _ = record(world, state, 120)
    np.testing.assert_allclose(np.asarray(states.position)[-1, :, 0], [0, 0, 0.25], atol=1e-4)


@pytest.mark.slow
def test_gradients_at_the_surface_equal_central_differences():
    """Differentiate the height after two steps by the initial height."""
    world = in_water(single(wedge(), 500.0), surface=0.0)

    def height(start):
        state = resting(world.tree, height=start)
        for _ in range(2):
            state = step(world, state, jnp.zeros(0), 1 / 120)[0]
        return state.position[2]

    found = quick_jit(jax.grad(height))(0.01)
    assert float(found) == pytest.approx(float(slope(quick_jit(height), 0.01, 1e-5)), rel=1e-5)
