"""Bodies at the surface of the water against Archimedes, naval architecture and conservation."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

from creatures import STRUCTURES, coast, in_water, quick_jit, random_creature, random_state, single
from evo_cpg.analysis.cycles import upward_crossings
from evo_cpg.creature.algebra.rotation import quaternion_to_matrix
from evo_cpg.creature.shapes import Box, Capsule, Ellipsoid, Shape, Sphere
from evo_cpg.creature.tree import build_tree
from evo_cpg.physics.contact.contact_model import Ground, make_contact_model
from evo_cpg.physics.contact.terrain import Plane
from evo_cpg.physics.step.step import step
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.state import State, resting_state
from evo_cpg.physics.water.buoyancy import displacement, make_cells
from evo_cpg.physics.water.fluid import Drag, drag

GRAVITY, WATER = 9.81, 1000.0
H = 1 / 120
SHAPES = (
    Box((0.3, 0.2, 0.1)),
    Box((1.0, 0.1, 0.1)),
    Sphere(0.1),
    Ellipsoid((0.3, 0.1, 0.05)),
    Capsule(0.05, 0.3),
)


def floating(shape: Shape, density: float, drag: float = 0.0, **water) -> World:
    """Return one body in water with a surface at height 0."""
    return in_water(
        single(shape, density), form_drag=drag, skin_drag=0.05 * drag, surface=0.0, **water
    )


def start(world: World, heights, tilts=None, velocity=None) -> State:
    """Return the initial state of several individuals of one body.

    Args:
        world: their world.
        heights: heights of their centres, m.
        tilts: rotation vectors ``(3, n)``, rad, or None for level bodies.
        velocity: velocities ``(6, n)``, or None for rest.
    """
    count = len(heights)
    state = resting_state(world.tree, (count,), jnp.float64)
    tilts = np.zeros((3, count)) if tilts is None else np.asarray(tilts, float)
    half = np.linalg.norm(tilts, axis=0) / 2
    orientation = np.concatenate([np.cos(half)[None], tilts / 2 * np.sinc(half / np.pi)])
    return dataclasses.replace(
        state,
        position=state.position.at[2].set(jnp.asarray(heights)),
        orientation=jnp.asarray(orientation),
        velocity=state.velocity if velocity is None else jnp.asarray(velocity, float),
    )


def volume_points(shape: Shape, log2_count: int) -> np.ndarray:
    """Return points ``(n, 3)`` of equal volume in a shape, from a Sobol sequence in its box."""
    unit = scipy.stats.qmc.Sobol(3, seed=0).random_base2(log2_count)
    points = (2 * unit - 1) * shape.half_extents
    return points[shape.distance(points) < 0]


def period(signal: np.ndarray, h: float = H) -> float:
    """Return the mean time between upward crossings of the mean, s."""
    return float(np.diff(h * upward_crossings(signal - signal.mean())).mean())


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("shape", SHAPES, ids=lambda s: type(s).__name__)
def test_displaced_volume_and_moment_in_any_position(shape, dtype):
    """Compare with volume and first moment of some 10^5 points under the surface.

    A box is blurred where an edge or a face enters the water, and the discs and ends of a capsule
    are not exact.
    """
    rng = np.random.default_rng(0)
    creature = single(shape, 500.0)
    tree = build_tree(creature)
    points = volume_points(shape, 17)
    up = rng.normal(size=(3, 40))
    up[:, :3] = np.eye(3)
    up[:, 3] = 0.02, 0.0, 1.0
    up /= np.linalg.norm(up, axis=0)
    height = rng.uniform(-1, 1, 40) * np.linalg.norm(shape.half_extents[:, None] * up, axis=0)
    pose = np.concatenate([up, height[None]])[:, None].astype(dtype)
    cells = make_cells(creature, tree)
    found = jax.tree.map(np.asarray, quick_jit(lambda pose: displacement(cells, pose))(pose))
    assert found.volume.dtype == found.moment.dtype == dtype
    size = np.linalg.norm(shape.half_extents)
    tolerance = {Box: 0.003, Capsule: 0.01}.get(type(shape), 0.001)
    for k in range(40):
        under = points[points @ up[:, k] + height[k] < 0]
        share = len(under) / len(points)
        moment = under.sum(0) / len(points)
        arm = np.asarray(found.moment[:, 0, k]) / shape.volume
        assert found.volume[0, k] / shape.volume == pytest.approx(share, abs=tolerance)
        # The vertical component has no effect.
        np.testing.assert_allclose(
            np.cross(arm, up[:, k]), np.cross(moment, up[:, k]), atol=0.003 * size
        )


def test_sphere_displaces_its_cap():
    """The volume is pi h^2 (3 r - h) / 3 at a draught h, to rounding."""
    shape = Sphere(0.1)
    creature = single(shape, 500.0)
    draught = np.linspace(0, 0.2, 11)
    pose = np.concatenate([np.tile([[0.6], [0.0], [0.8]], 11), 0.1 - draught[None]])
    cells = make_cells(creature, build_tree(creature))
    found = quick_jit(lambda pose: displacement(cells, pose))(pose[:, None])
    cap = np.pi * draught**2 * (0.3 - draught) / 3
    np.testing.assert_allclose(found.volume[0], cap, atol=1e-12)


@pytest.mark.slow
def test_far_from_the_surface_it_has_no_effect():
    """A deep step equals a step in water without a surface, a high step equals a step on land.

    Differences are rounding and the floor of 1e-6 m/s of the tangential speed. All worlds have
    ground far below, because a world of deep water alone has no mean torques of the spin.
    """
    creature = random_creature(np.random.default_rng(3), STRUCTURES[0])
    ground = Ground(floor=Plane(height=-1e3))
    everywhere = in_water(creature, 1, current=(0.3, 0.1, 0.2))
    surfacing = in_water(creature, 1, current=(0.3, 0.1, 0.2), surface=20.0)
    state = random_state(everywhere.tree, np.random.default_rng(4), (3,))
    above = dataclasses.replace(state, position=state.position.at[2].add(40.0))

    def advance(world, state):
        world = dataclasses.replace(
            world, contact_model=make_contact_model(creature, world.tree, ground)
        )
        target = jnp.zeros_like(state.qd)
        return quick_jit(lambda s: step(world, s, target, H)[0])(state)

    both = jax.tree.map(lambda low, high: jnp.concatenate([low, high], -1), state, above)
    ours = advance(surfacing, both)
    under, dry = advance(everywhere, state), advance(World(everywhere.tree, GRAVITY), above)
    for mine, *theirs in zip(*map(jax.tree.leaves, (ours, under, dry)), strict=True):
        np.testing.assert_allclose(mine, np.concatenate(theirs, -1), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("density", [250.0, 600.0])
@pytest.mark.parametrize("kind", ["box", "sphere"])
def test_draught_follows_archimedes(kind, density):
    """A body that sinks in from above rests at Archimedes' draught, within 1 %.

    A box: density / water times its height. A sphere: h^2 (3 r - h) / (4 r^3) = density / water.
    """
    share = density / WATER
    if kind == "box":
        shape, half = Box((0.4, 0.3, 0.2)), 0.1
        draught = 0.2 * share
    else:
        shape, half = Sphere(0.1), 0.1
        roots = np.roots([-1, 3 * 0.1, 0, -4 * 0.1**3 * share]).real
        draught = float(roots[(roots > 0) & (roots < 0.2)][0])
    motion = coast(
        floating(shape, density, drag=1.0), start(floating(shape, density), [0.12]), 20.0, H
    )
    # Quadratic drag damps small bobbing slowly, so the mean is compared.
    assert half - motion.position[-480:, 2, 0].mean() == pytest.approx(draught, rel=0.01)


@pytest.mark.parametrize("density", [300.0, 600.0])
def test_bobbing_and_rolling_periods_of_a_box(density):
    """Small motion of a box a x b x c of draught d: T = 2 pi sqrt(d / g) up and down, and

        T = 2 pi k / sqrt(g GM),   k^2 = (b^2 + c^2) / 12,   GM = b^2 / (12 d) - (c - d) / 2

    about x and similarly about y, with the metacentric height GM = I / V - BG. There is
    no drag. Periods of heave agree within 0.2 %, periods of roll and pitch within 1 %.
    """
    a, b, c = size = (0.4, 0.3, 0.2)
    d = c * density / WATER
    world = floating(Box(size), density)
    level = c / 2 - d
    tilts = np.array([[0, 0, 0], [0.03, 0, 0], [0, 0.03, 0]]).T
    motion = coast(world, start(world, [level + 0.01, level, level], tilts), 10.0, H)
    assert period(motion.position[:, 2, 0]) == pytest.approx(
        2 * np.pi * np.sqrt(d / GRAVITY), rel=0.002
    )
    for width, axis in ((b, 1), (a, 2)):
        metacentre = width**2 / (12 * d) - (c - d) / 2
        radius = np.sqrt((width**2 + c**2) / 12)
        angle = motion.orientation[:, axis, axis]
        expected = 2 * np.pi * radius / np.sqrt(GRAVITY * metacentre)
        assert period(angle) == pytest.approx(expected, rel=0.01)
        # The step neither damps nor excites the motion.
        assert np.ptp(angle[-300:]) == pytest.approx(np.ptp(angle[:300]), rel=0.02)
    assert np.ptp(motion.position[-300:, 2, 0]) == pytest.approx(0.02, rel=0.02)


@pytest.mark.parametrize(
    ("shape", "section"),
    [(Box((1.0, 0.04, 0.04)), 0.04**2), (Capsule(0.02, 0.96), np.pi * 0.02**2)],
)
def test_first_accelerations_of_a_tilted_slender_body(shape, section):
    """Buoyancy acts on the middle of the submerged part of a rod that is tilted by 30 degrees.

    If the waterline is at s along the rod (0 at its centre, -L/2 at its lower end), the lift is
    rho g A (L/2 + s), at the lever (s - L/2) / 2 cos(tilt). Thickness changes this by some (b/L)^2.
    """
    tilt, height, density = np.pi / 6, 0.1, 400.0
    world = floating(shape, density)
    # A turn about -y raises the x axis.
    motion = coast(world, start(world, [height], [[0.0], [-tilt], [0.0]]), H, H)
    length, mass = shape.volume / section, density * shape.volume
    waterline = -height / np.sin(tilt)
    lift = WATER * GRAVITY * section * (length / 2 + waterline)
    arm = (waterline - length / 2) / 2 * np.cos(tilt)
    inertia = shape.inertia(mass)[1, 1]
    assert motion.velocity[0, 1, 0] / H == pytest.approx(-arm * lift / inertia, rel=0.02)
    assert motion.velocity[0, 5, 0] / H == pytest.approx(lift / mass - GRAVITY, rel=0.02)
    assert np.abs(motion.velocity[0, [0, 2, 3, 4], 0]).max() < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("shape", [Box((0.4, 0.3, 0.2)), Capsule(0.05, 0.3)])
def test_energy_is_conserved_across_the_surface(shape):
    """Tumbling bodies fall in and emerge without drag, and their energy is constant within 1 %.

    The potential energy of the displaced water is rho g times the depth, summed over the points of
    its volume. Semi-implicit Euler is the leapfrog, whose velocities belong to the middles of the
    steps. So the energy at a position uses the mean of two neighbouring velocities.
    """
    density, seconds = 500.0, 3.0
    world = floating(shape, density)
    rng = np.random.default_rng(1)
    speeds = np.concatenate([rng.normal(size=(3, 4)), np.zeros((3, 4))])
    first = start(world, [0.4, 0.3, 0.4, 0.5], rng.normal(size=(3, 4)), speeds)
    motion = coast(world, first, seconds, H)
    points = volume_points(shape, 14)
    mass = density * shape.volume
    part = WATER * GRAVITY * shape.volume / len(points)
    energies = []
    for k in range(0, len(motion.position) - 1, 6):
        rotation = np.asarray(quaternion_to_matrix(jnp.asarray(motion.orientation[k])))
        velocity = (motion.velocity[k] + motion.velocity[k + 1]) / 2
        spin = np.einsum("ijn,in->jn", rotation, velocity[:3])
        height = motion.position[k, 2]
        depth = -height - points @ rotation[2]
        energies.append(
            (np.diag(shape.inertia(mass))[:, None] * spin**2).sum(0) / 2
            + mass * ((velocity[3:] ** 2).sum(0) / 2 + GRAVITY * height)
            + part * np.maximum(depth, 0).sum(0)
        )
    energies = np.array(energies)
    under = motion.position[:, 2] < -np.min(shape.half_extents)
    assert (under.any(0) & ~under[-1]).any()
    np.testing.assert_allclose(energies, energies[:1].repeat(len(energies), 0), rtol=0.01)


def test_drag_acts_on_the_submerged_part():
    """Drag of a box that is towed level is proportional to its draught, and zero in the air.

    The wet fraction of a patch at the waterline is smooth, and exactly 1/2 at half its height.
    """
    world = floating(Box((0.4, 0.4, 0.2)), 500.0, drag=1.0)
    velocity, pose = np.zeros((6, 1, 4)), np.zeros((4, 1, 4))
    velocity[3], pose[2], pose[3, 0] = 2.0, 1.0, (-5.0, 0.0, 0.05, 5.0)
    wrench, derivative = quick_jit(lambda v, p: drag(world.law(Drag), world.water.density, v, p))(
        velocity, pose
    )
    force = np.asarray(wrench[3, 0])
    sides, bottom = 0.05 * 2 * 0.4 * 0.2, 0.05 * 0.4 * 0.4
    ends = 2 * 0.4 * 0.2
    deep = -0.5 * WATER * 4 * (ends + sides + 2 * bottom)
    assert force[0] == pytest.approx(deep, rel=1e-9)
    half = -0.5 * WATER * 4 * (ends / 2 + sides / 2 + bottom)
    assert force[1] == pytest.approx(half, rel=1e-9)
    assert half < force[2] < half / 2
    assert force[3] == 0
    assert np.all(np.asarray(derivative[2, 0, 0, 0, :3]) > 0) and derivative[2, 0, 0, 0, 3] == 0


@pytest.mark.slow
def test_gradients_through_the_surface_equal_central_differences():
    """Differentiate the height after a fall through the surface, to 1e-6."""
    world = floating(Box((0.3, 0.2, 0.1)), 500.0, drag=1.0, resolution=1)

    def depth(parameters):
        height, spin, density = parameters
        changed = eqx.tree_at(lambda w: w.water.density, world, density)
        state = start(world, [0.0], [[0.4], [0.3], [0.0]])
        state = dataclasses.replace(
            state,
            position=state.position.at[2].set(height),
            velocity=state.velocity.at[0].set(spin),
        )

        def advance(s, _):
            s = step(changed, s, jnp.zeros((0, 1)), H)[0]
            return s, s.position[2, 0]

        return jax.lax.scan(advance, state, None, 40)[1][-1]

    parameters = jnp.array([0.15, 1.0, 1000.0])
    gradient = np.asarray(quick_jit(jax.grad(depth))(parameters))
    steps = np.diag([1e-6, 1e-6, 1e-3])
    compiled = quick_jit(depth)
    values = np.array([compiled(parameters + change) for change in np.vstack([steps, -steps])])
    assert (values < 0).all()
    np.testing.assert_allclose(gradient, (values[:3] - values[3:]) / (2 * steps.sum(0)), rtol=1e-5)


def test_patches_without_depth_raise():
    world = in_water(single(Sphere(0.1), 500.0))
    pose = jnp.zeros((4, 1)).at[2].set(1.0)
    with pytest.raises(ValueError, match=r"make_patches\(\.\.\., surfacing=True\)"):
        drag(world.law(Drag), world.water.density, jnp.zeros((6, 1)), pose)


def test_a_surface_current_carries_a_floating_box():
    """The box drifts with the current at its floating height."""
    world = floating(Box((0.2, 0.2, 0.1)), 500.0, drag=1.0, current=(0.5, -0.2, 0.0))
    motion = coast(world, start(world, [0.0]), 20.0, H)
    np.testing.assert_allclose(motion.velocity[-1, 3:5, 0], [0.5, -0.2], atol=0.01)
    assert abs(motion.position[-1, 2, 0]) < 0.001
