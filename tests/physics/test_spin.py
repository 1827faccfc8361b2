"""Fast spinning bodies in free flight keep energy and momentum, at any step."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import quick_jit
from evo_cpg.creature.algebra.rotation import quaternion_to_matrix
from evo_cpg.creature.shapes import Box, Capsule, Ellipsoid
from evo_cpg.physics.step.step import step
from on_ground import alone, released


@pytest.mark.parametrize(
    ("shape", "h"),
    [
        (Capsule(0.03, 0.3), 1 / 240),
        pytest.param(Ellipsoid((0.15, 0.06, 0.03)), 1 / 240, marks=pytest.mark.slow),
        (Box((0.3, 0.12, 0.06)), 1 / 240),
        pytest.param(Capsule(0.03, 0.3), 1 / 60, marks=pytest.mark.slow),
    ],
)
def test_a_tumbling_body_keeps_its_energy_and_momentum(x64, shape, h):
    """The magnitudes are kept. The momentum's direction drifts: positions use the new velocity."""
    world, count = alone(shape), 12
    rng = np.random.default_rng(0)
    spin = rng.normal(size=(3, count))
    spin *= np.array([5.0, 20.0, 40.0])[np.arange(count) % 3] / np.linalg.norm(spin, axis=0)
    start = released(world, np.full((3, count), 50.0), np.concatenate([spin, 0 * spin]))

    def advance(state, _):
        state, _ = step(world, state, jnp.zeros_like(state.q), h)
        return state, (state.orientation, state.velocity)

    steps = round(2 / h)
    orientation, velocity = quick_jit(lambda s: jax.lax.scan(advance, s, length=steps)[1])(start)
    turn = np.asarray(quaternion_to_matrix(jnp.moveaxis(orientation, 1, 0)))
    own = np.einsum("ijtn,tin->jtn", turn, np.asarray(velocity)[:, :3])
    momentum = np.einsum("ij,jtn->itn", world.tree.inertia[:3, :3, 0], own)
    energy, size = (own * momentum).sum(0), np.linalg.norm(momentum, axis=0)
    # The error grows with the square of the angle of a step: 0.17 or 0.67 rad at 40 rad/s.
    wobble = 0.3 if h > 1 / 100 else 0.02
    assert (energy.max(0) / energy[0]).max() < 1 + wobble
    assert (energy.min(0) / energy[0]).min() > 1 - wobble
    assert (size.max(0) / size.min(0)).max() < 1 + wobble
    # The second half of the time has no larger errors than the first half.
    first, second = np.split(energy, 2)
    assert (second.max(0) / first.max(0)).max() < 1.01
