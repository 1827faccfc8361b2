"""Buoyancy, drag and streams against closed forms, and the sign of the power of drag."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import (
    STRUCTURES,
    coast,
    in_water,
    last,
    quick_jit,
    random_creature,
    resting,
    single,
    surfaces_of,
    whole,
)
from evo_cpg.creature.shapes import Box, Capsule, Ellipsoid, Shape, Sphere
from evo_cpg.physics.tree.state import resting_state
from evo_cpg.physics.water.fluid import Drag, drag, make_patches
from evo_cpg.physics.water.water import Current, Vortex, Water

GRAVITY, WATER = 9.81, 1000.0
FORM_DRAG, SKIN_DRAG = 1.0, 0.05
H = 1 / 120


def sink(shape: Shape, density: float, seconds: float, resolution: int = 2, **water) -> np.ndarray:
    """Return velocities ``(steps, 6)`` of a body released at rest."""
    world = in_water(
        single(shape, density), resolution, form_drag=FORM_DRAG, skin_drag=SKIN_DRAG, **water
    )
    return coast(world, resting_state(world.tree, dtype=jnp.float64), seconds, H).velocity


def box_coefficient(size: tuple[float, float, float], law: str) -> float:
    """Return the frontal drag coefficient of a box that moves along z, including the lee face."""
    front = size[0] * size[1]
    sides = 2 * (size[0] + size[1]) * size[2]
    if law == "isotropic":
        return (FORM_DRAG + SKIN_DRAG) * (2 + sides / front)
    return 2 * FORM_DRAG + SKIN_DRAG * sides / front


def sphere_coefficient(law: str) -> float:
    """Return C_d + 3 pi/4 C_f: integrals of |cos|^3 and sin^3 over a sphere, per section.

    int |cos|^3 dA = pi r^2, and int sin^3 dA = 2 pi r^2 int sin^4 = 3 pi^2 r^2 / 4. The isotropic
    law uses the whole surface, 4 pi r^2.
    """
    if law == "isotropic":
        return 4 * (FORM_DRAG + SKIN_DRAG)
    return FORM_DRAG + 3 * np.pi / 4 * SKIN_DRAG


@pytest.mark.parametrize("law", ["normal", "isotropic"])
@pytest.mark.parametrize("kind", ["box", "sphere"])
def test_terminal_velocity_equals_the_closed_form(kind, law):
    """v = sqrt(2 (m - rho V) g / (rho A C)).

    A steady speed does not depend on the step. The tanh of the approach is within 1e-10 of 1 after
    12 time constants v / 2 a_0. The remaining error of a sphere, 3e-5, is the quadrature of
    |cos|^3, whose third derivative jumps. The quadrature of a box's faces is exact: 1e-6.
    """
    density = 1500.0
    if kind == "box":
        shape, area = Box((0.3, 0.2, 0.1)), 0.06
        coefficient, tolerance = box_coefficient(shape.size, law), 1e-6
    else:
        shape, area = Sphere(0.1), np.pi * 0.01
        coefficient, tolerance = sphere_coefficient(law), 1e-4
    excess = (density - WATER) * shape.volume * GRAVITY
    expected = np.sqrt(2 * excess / (WATER * area * coefficient))
    seconds = 12 * expected / (excess / (density * shape.volume))
    # A sphere's |cos|^3 needs many points. The isotropic law has equal drag at all points.
    resolution = 6 if (kind, law) == ("sphere", "normal") else 2
    velocity = sink(shape, density, seconds, resolution, law=law)
    assert -velocity[-1, 5] == pytest.approx(expected, rel=tolerance)
    # The points are symmetric, so the body neither drifts nor turns.
    assert np.abs(np.delete(velocity[-1], 5)).max() < 1e-12


def test_approach_to_terminal_velocity_follows_tanh():
    """v(t) = v_inf tanh(a_0 t / v_inf) for quadratic drag from rest, at first order in the step.

    A step of 1/120 s is 3 % of the time constant. The linearly implicit step has errors of at most
    a few 1e-3.
    """
    shape, density = Box((0.3, 0.2, 0.1)), 1500.0
    excess = (density - WATER) * shape.volume * GRAVITY
    initial = excess / (density * shape.volume)
    terminal = np.sqrt(2 * excess / (WATER * 0.06 * box_coefficient(shape.size, "normal")))
    velocity = -sink(shape, density, 1.0)[:, 5]
    times = H * np.arange(1, len(velocity) + 1)
    error = np.abs(velocity - terminal * np.tanh(initial * times / terminal)).max()
    assert error < 0.01 * terminal


@pytest.mark.slow
@pytest.mark.parametrize("shape", [Box((0.3, 0.2, 0.1)), Capsule(0.05, 0.2)])
@pytest.mark.parametrize("density", [500.0, 1000.0, 2000.0])
def test_bodies_sink_float_or_stay(shape, density):
    """The initial acceleration is (rho V - m) g / m upwards. A neutral body does not move.

    Drag is zero at rest. The floor of the speed, 1e-6 m/s, leaves 1e-8 of the implicit part.
    """
    velocity = sink(shape, density, 10 * H)
    expected = (WATER - density) / density * GRAVITY
    assert velocity[0, 5] / H == pytest.approx(expected, rel=1e-6, abs=1e-12)
    assert np.sign(np.round(velocity[-1, 5], 12)) == np.sign(expected)
    assert np.abs(velocity[:, :5]).max() < 1e-12


@pytest.mark.parametrize("law", ["normal", "isotropic"])
def test_drag_takes_energy_from_any_motion(law):
    """The power of drag relative to the water is never positive.

    Every point's force opposes a component of its velocity, so F . V <= 0 for every body.
    """
    rng = np.random.default_rng(0)
    world = in_water(random_creature(rng, STRUCTURES[4]), law=law)
    velocity = jnp.asarray(rng.normal(size=(6, world.tree.body_count, 500)))
    velocity = velocity * 10.0 ** rng.uniform(-3, 1, (1, 1, 500))
    wrench, derivative = quick_jit(lambda v: drag(world.law(Drag), world.water.density, v))(
        velocity
    )
    assert float((wrench * velocity).sum(0).max()) < 0
    # D is symmetric and positive semidefinite, so that the implicit step only damps.
    full = np.moveaxis(whole(np.asarray(derivative)[..., :5]), (0, 1), (2, 3))
    np.testing.assert_allclose(full, np.swapaxes(full, 2, 3), rtol=1e-12, atol=1e-9)
    assert np.linalg.eigvalsh(full).min() > -1e-9


def test_implicit_derivative_is_half_the_exact_derivative():
    """D = -1/2 df/dV exactly for form drag alone, by `jax.jacfwd` of the wrench."""
    world = in_water(single(Ellipsoid((0.2, 0.1, 0.05)), 1000.0), 4, skin_drag=0.0)
    velocity = jnp.asarray(np.random.default_rng(4).normal(size=6))

    @quick_jit
    def both(v):
        derivative = drag(world.law(Drag), world.water.density, v[:, None])[1]
        jacobian = jax.jacfwd(
            lambda v: drag(world.law(Drag), world.water.density, v[:, None])[0][:, 0]
        )(v)
        return derivative[..., 0], jacobian

    blocks, jacobian = both(velocity)
    np.testing.assert_allclose(whole(blocks), -jacobian / 2, rtol=1e-10, atol=1e-12)


def test_drag_of_a_turning_sphere_is_friction_alone():
    """A spinning sphere has no form drag, and a moment -1/2 rho C_f (3 pi^2/4) r^5 |w| w.

    |v_t| = w r sin gives 1/2 rho C_f w^2 r^3 int sin^3 dA, with int sin^3 dA = 3 pi^2 r^2 / 4.
    """
    radius, rate = 0.1, 3.0
    world = in_water(single(Sphere(radius), 1000.0), 12, skin_drag=SKIN_DRAG)
    spin = jnp.asarray([0.0, 0.0, rate, 0.0, 0.0, 0.0])[:, None]
    wrench, _ = drag(world.law(Drag), world.water.density, spin)
    expected = -0.5 * WATER * SKIN_DRAG * rate**2 * 3 * np.pi**2 / 4 * radius**5
    np.testing.assert_allclose(wrench[:, 0], [0, 0, expected, 0, 0, 0], rtol=1e-4, atol=1e-12)


@pytest.mark.slow
def test_a_body_without_skin_points_has_form_drag_alone():
    """All skin points of a small part can lie inside other parts."""
    world = in_water(single(Sphere(0.1), 1000.0), skin_drag=0.0)
    law, velocity = world.law(Drag), jnp.ones((6, 1))
    (patch,) = law.patches
    smooth = patch._replace(
        tangential=patch.tangential[:, :0], tangential_area=patch.tangential_area[:0]
    )
    found, _ = drag(dataclasses.replace(law, patches=(smooth,)), WATER, velocity)
    expected, _ = drag(law, WATER, velocity)
    np.testing.assert_allclose(found, expected, rtol=1e-6)


VORTEX = Vortex(centre=(0.5, -0.2), circulation=1.5, core=0.3)


def circle(radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Return places ``(3, n)`` around the vortex, and unit vectors along the circle."""
    angle = np.arange(200) * 2 * np.pi / 200
    x, y = np.cos(angle), np.sin(angle)
    places = np.stack([0.5 + radius * x, -0.2 + radius * y, np.full(200, 0.7)])
    return places, np.stack([-y, x, np.zeros(200)])


@pytest.mark.parametrize("radius", [0.01, 0.3, 30.0])
def test_circulation_around_a_vortex_equals_the_closed_form(radius):
    """Gamma r^2 / (r^2 + c^2): Gamma far away, half at the core, rigid rotation inside."""
    places, along = circle(radius)
    velocity = VORTEX.velocity(jnp.asarray(places))
    circulation = (velocity * along).sum(0).mean() * 2 * np.pi * radius
    assert circulation == pytest.approx(1.5 * radius**2 / (radius**2 + 0.09), rel=1e-9)
    assert np.abs(velocity[2]).max() == 0


def test_the_gradient_is_the_jacobian_and_divergence_is_zero():
    """``dv_i / dx_j = G_ij``, and the divergence is 0, with the vortex too."""
    gradient = ((0.1, 0.2, 0.3), (0.4, 0.1, 0.6), (0.7, 0.8, -0.2))
    place = jnp.array([0.3, 0.2, -0.4])

    def velocity(vortices):
        water = Water(1000.0, streams=(Current((1.0, 2.0, 3.0), gradient), *vortices))
        return lambda x: water.velocity(x[:, None])[:, 0]

    np.testing.assert_allclose(velocity(())(jnp.zeros(3)), [1, 2, 3])
    np.testing.assert_allclose(jax.jacfwd(velocity(()))(place), gradient, rtol=1e-12)
    assert abs(np.trace(jax.jacfwd(velocity((VORTEX,)))(place))) < 1e-12


def test_neutral_spheres_reach_the_local_velocity():
    """Spheres in a shear flow, and in the centre of a vortex, approach the stream's speed as 1 / t.

    The shear is along y, so that the spheres keep their heights. The drag is quadratic.
    """
    shear = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.5), (0.0, 0.0, 0.0))
    world = in_water(single(Sphere(0.05)), skin_drag=0.05, current=(0.0, 0.1, 0.0), gradient=shear)
    heights = np.array([-1.0, 0.0, 2.0])
    end = last(coast(world, resting(world.tree, (3,), heights), 20.0, H))
    np.testing.assert_allclose(end.velocity[4], 0.1 + 0.5 * heights, atol=0.01)
    np.testing.assert_allclose(end.position[2], heights, atol=1e-9)


def test_skin_drags_without_points_of_form_drag():
    """Covered points of form drag leave the skin friction: v = v_0 / (1 + k v_0 t) within 1e-3."""
    size, start = (0.3, 0.2, 0.1), 2.0
    world = in_water(single(Box(size)), form_drag=FORM_DRAG, skin_drag=0.5)
    (skin,) = surfaces_of(single(Box(size)), 2)
    form = jax.tree.map(lambda x: x[:0], skin)
    patches = make_patches(world.tree, form, skin)
    world = dataclasses.replace(world, forces=(Drag(FORM_DRAG, 0.5, patches),))
    state = resting(world.tree, velocity=np.array([0, 0, 0, start, 0, 0.0]))
    velocity = coast(world, state, 1.0, H).velocity
    sides = 2 * size[0] * (size[1] + size[2])
    k = 0.5 * WATER * 0.5 * sides / (WATER * np.prod(size))
    expected = start / (1 + k * start * H * np.arange(1, 1 + len(velocity)))
    np.testing.assert_allclose(velocity[:, 3], expected, rtol=1e-3)
    assert expected[-1] < 0.5 * start
