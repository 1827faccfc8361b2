"""Rotations against `scipy.spatial.transform.Rotation`."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from evo_cpg.creature.algebra.rotation import (
    axis_rotation,
    euler_to_matrix,
    integrate_quaternion,
    matrix_to_euler,
    quaternion_product,
    quaternion_to_matrix,
)

pytestmark = pytest.mark.usefixtures("x64")

COUNT = 50


def turns(seed: int) -> Rotation:
    return Rotation.random(COUNT, np.random.default_rng(seed))


def ours(rotation: Rotation) -> jax.Array:
    """Return quaternions (w, x, y, z), components first."""
    return jnp.asarray(np.roll(rotation.as_quat(), 1, axis=-1).T)


def test_matrix_of_a_quaternion():
    """The matrix rotates from body to world, as SciPy's does."""
    rotation = turns(0)
    matrices = np.moveaxis(np.asarray(quaternion_to_matrix(ours(rotation))), -1, 0)
    np.testing.assert_allclose(matrices, rotation.as_matrix(), atol=1e-14)


def test_product_turns_by_the_second_first():
    """The product a b is b followed by a, like SciPy's ``a * b``."""
    a, b = turns(1), turns(2)
    product = np.asarray(quaternion_product(ours(a), ours(b))).T
    expected = np.roll((a * b).as_quat(), 1, axis=-1)
    signs = np.sign((product * expected).sum(1, keepdims=True))
    np.testing.assert_allclose(signs * product, expected, atol=1e-14)


@pytest.mark.parametrize("speed", [0.0, 1e-9, 1e-3, 0.3, 30.0])
def test_integration_is_exact_for_a_constant_rate(speed):
    """One step of 0.1 s and 100 steps of 1 ms give exp(h [w]) R, at any speed.

    Below 2 mrad the series of sin(x) / x omits x^4 / 120, 1e-14. Rounding adds up to 1e-13.
    """
    rng = np.random.default_rng(3)
    omega = rng.normal(size=(3, COUNT))
    omega *= speed / np.linalg.norm(omega, axis=0)
    start = turns(4)
    expected = (Rotation.from_rotvec(0.1 * omega.T) * start).as_matrix()
    once = integrate_quaternion(ours(start), jnp.asarray(omega), 0.1)
    many = jax.lax.fori_loop(
        0, 100, lambda _, q: integrate_quaternion(q, jnp.asarray(omega), 0.001), ours(start)
    )
    for result in (once, many):
        matrices = np.moveaxis(np.asarray(quaternion_to_matrix(result)), -1, 0)
        np.testing.assert_allclose(matrices, expected, atol=2e-13)
        np.testing.assert_allclose(np.linalg.norm(result, axis=0), 1, rtol=1e-15)


@pytest.mark.slow
def test_integration_has_a_gradient_at_rest():
    """The derivative of the vector part, h w / 2, at w = 0 is h / 2, not NaN."""
    identity = jnp.array([1.0, 0.0, 0.0, 0.0])
    slope = jax.jacfwd(lambda w: integrate_quaternion(identity, w, 0.1))(jnp.zeros(3))
    np.testing.assert_allclose(slope, np.vstack([np.zeros(3), 0.05 * np.eye(3)]), atol=1e-15)


def test_rotation_about_a_constant_axis():
    """Compare with Rodrigues' formula for an oblique axis and an aligned axis."""
    angles = np.linspace(-np.pi, np.pi, COUNT)
    for axis in (np.array([2.0, -1.0, 2.0]) / 3, np.array([0.0, 0.0, -1.0])):
        matrices = axis_rotation(axis, jnp.sin(angles), jnp.cos(angles))
        expected = Rotation.from_rotvec(angles[:, None] * axis).as_matrix()
        np.testing.assert_allclose(np.moveaxis(np.asarray(matrices), -1, 0), expected, atol=1e-14)


def test_roll_pitch_yaw():
    """Compare Rz(yaw) Ry(pitch) Rx(roll) with SciPy's extrinsic "xyz"."""
    for angles in np.random.default_rng(5).uniform(-3, 3, (10, 3)):
        expected = Rotation.from_euler("xyz", angles).as_matrix()
        np.testing.assert_allclose(euler_to_matrix(*angles), expected, atol=1e-14)


def test_euler_angles_of_a_matrix_give_the_matrix():
    """This also holds at and near a pitch of 90 degrees, where the angles are not unique."""
    poles = [
        euler_to_matrix(roll, pitch, yaw)
        for roll, yaw in ((0.3, -1.1), (2.0, 2.0))
        for pitch in (np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-9)
    ]
    for matrix in [*turns(4).as_matrix(), *poles]:
        np.testing.assert_allclose(euler_to_matrix(*matrix_to_euler(matrix)), matrix, atol=1e-15)
