"""Water whose velocity depends on the place."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import in_water, quick_jit
from evo_cpg.creature.creature import Body, Creature, Material
from evo_cpg.creature.shapes import Sphere
from evo_cpg.physics.step.step import step
from evo_cpg.physics.tree.state import resting_state
from evo_cpg.physics.water.water import Current, Vortex, Water

H = 1 / 120
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
    creature = Creature("ball", (Body("b", Sphere(0.05), Material(1000.0)),))
    world = in_water(creature, skin_drag=0.05, current=(0.0, 0.1, 0.0), gradient=shear)
    heights = np.array([-1.0, 0.0, 2.0])
    state = resting_state(world.tree, (3,), jnp.float64)
    position = state.position.at[2].set(jnp.asarray(heights))
    state = dataclasses.replace(state, position=position)
    rest = jnp.zeros((0, 3))

    @quick_jit
    def drift(state):
        return jax.lax.scan(lambda s, _: (step(world, s, rest, H)[0], None), state, None, 2400)[0]

    end = drift(state)
    np.testing.assert_allclose(end.velocity[4], 0.1 + 0.5 * heights, atol=0.01)
    np.testing.assert_allclose(end.position[2], heights, atol=1e-9)
