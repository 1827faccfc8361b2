"""Derivatives through half a second of swimming against central differences."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from creatures import box_chain, in_water, quick_jit

from evo_cpg.creature.creature import Actuator
from evo_cpg.physics.state import resting_state
from evo_cpg.physics.step import step

H = 1 / 120
STEPS = 60
# Wave amplitude (rad/s), frequency (Hz) and C_d.
PARAMETERS = np.array([3.0, 1.3, 1.1])
# Rounding gives 1e-10, curvature less: 1e-6 leaves room for both.
DIFFERENCE = 1e-6


@pytest.fixture(scope="module")
def displacement():
    """Distance (m, with weights on x, y and z) as a function of `PARAMETERS`.

    The chain bends both ways and its motors have limits which are not reached.
    """
    world = in_water(box_chain(4, "yz", Actuator(5.0, 50.0)))
    dofs = world.tree.dof_count
    phase = np.repeat(np.arange(dofs // 2), 2) * 0.9 + np.tile([0.0, 1.0], dofs // 2)

    def swim(parameters):
        amplitude, frequency, form_drag = parameters
        changed = eqx.tree_at(lambda w: w.water.form_drag, world, form_drag)

        def advance(state, n):
            target = amplitude * jnp.sin(2 * jnp.pi * frequency * n * H - phase)
            state, effort = step(changed, state, target, H)
            return state, jnp.abs(effort.torque).max()

        start = resting_state(world.tree, dtype=jnp.float64)
        state, torque = jax.lax.scan(advance, start, jnp.arange(STEPS))
        return state.position @ jnp.array([1.0, 0.7, 0.4]), torque.max()

    return swim


def test_gradients_equal_central_differences(displacement):
    """Reverse and forward mode within 1e-6 of (f(p + e) - f(p - e)) / 2e, relative, in float64.

    The step has kinks where a point's normal velocity changes sign; the chance that one lies
    within e of this path is negligible, and the two modes would show it.
    """
    value = quick_jit(displacement)
    _, torque = value(PARAMETERS)
    assert 0 < torque < 50.0
    differences = [
        (value(PARAMETERS + e)[0] - value(PARAMETERS - e)[0]) / (2 * DIFFERENCE)
        for e in DIFFERENCE * np.eye(len(PARAMETERS))
    ]
    assert np.abs(differences).min() > 1e-4
    reverse, _ = quick_jit(jax.grad(displacement, has_aux=True))(PARAMETERS)
    np.testing.assert_allclose(reverse, differences, rtol=1e-6)

    @quick_jit
    def forward(direction):
        return jax.jvp(displacement, (jnp.asarray(PARAMETERS),), (direction,))[1][0]

    for n, direction in enumerate(np.eye(len(PARAMETERS))):
        np.testing.assert_allclose(forward(jnp.asarray(direction)), differences[n], rtol=1e-6)
