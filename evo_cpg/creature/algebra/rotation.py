"""Rotations: unit quaternions ``(w, x, y, z)`` and rotation matrices.

The components are the first axes of an array. Other axes, such as the individuals, follow.

A rotation matrix ``R`` takes body coordinates to world coordinates, ``x_world = R x_body``.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import array_of, expand_dims_like
from evo_cpg.creature.algebra.numerics import Number, Numbers, xp

# Squared half angle (rad^2) below which the series of sin(x)/x is used. The next term is
# then below float32's resolution, and the gradient at rest is finite.
_SMALL_ANGLE_SQUARED = 1e-6


def quaternion_to_matrix(q: Float[Array, "4 *rest"]) -> Float[Array, "3 3 *rest"]:
    """Return the rotation matrix of a unit quaternion ``(w, x, y, z)``."""
    w, x, y, z = q
    return jnp.stack(
        [
            1 - 2 * (y * y + z * z),
            2 * (x * y - w * z),
            2 * (x * z + w * y),
            2 * (x * y + w * z),
            1 - 2 * (x * x + z * z),
            2 * (y * z - w * x),
            2 * (x * z - w * y),
            2 * (y * z + w * x),
            1 - 2 * (x * x + y * y),
        ]
    ).reshape(3, 3, *q.shape[1:])


def matrix_to_quaternion(r: Float[Array, "3 3 *rest"]) -> Float[Array, "4 *rest"]:
    """Return the unit quaternion ``(w, x, y, z)`` of a rotation matrix.

    The rows of ``4 q q^T`` are sums of the matrix's elements. The row with the largest diagonal
    element is normalised, so no digits are lost at any angle (Shepperd 1978).
    """
    trace = r[0, 0] + r[1, 1] + r[2, 2]
    a, b, c = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    d, e, f = r[0, 1] + r[1, 0], r[0, 2] + r[2, 0], r[1, 2] + r[2, 1]
    x, y, z = (1.0 + 2.0 * r[i, i] - trace for i in range(3))
    best = jnp.stack([1.0 + trace, a, b, c])
    largest = best[0]
    for diagonal, row in ((x, (a, x, d, e)), (y, (b, d, y, f)), (z, (c, e, f, z))):
        better = diagonal > largest
        best = jnp.where(better[None], jnp.stack(row), best)
        largest = jnp.where(better, diagonal, largest)
    return best / jnp.sqrt((best * best).sum(0, keepdims=True))


def quaternion_product(
    a: Float[Array, "4 *rest"], b: Float[Array, "4 *rest"]
) -> Float[Array, "4 *rest"]:
    """Return the Hamilton product ``a b``: the rotation ``b`` followed by ``a``."""
    return jnp.stack(
        [
            a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
            a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
            a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
            a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
        ]
    )


def integrate_quaternion(
    q: Float[Array, "4 *rest"], omega: Float[Array, "3 *rest"], h: float | Float[Array, ""]
) -> Float[Array, "4 *rest"]:
    """Turn ``q`` for the time ``h`` (s) at the constant world angular velocity ``omega`` (rad/s).

    The result is exact for a constant ``omega``. It is normalised, so rounding does not accumulate.
    """
    turned = quaternion_product(half_rotation_to_quaternion(0.5 * h * omega), q)
    return turned / jnp.sqrt((turned * turned).sum(0, keepdims=True))


def quaternion_to_rotation_vector(q: Float[Array, "4 *rest"]) -> Float[Array, "3 *rest"]:
    """Return the rotation vector of a unit quaternion, of at most pi (rad)."""
    q = jnp.where(q[:1] < 0, -q, q)
    w, vector = q[0], q[1:]
    squared = (vector * vector).sum(0)
    small = squared < _SMALL_ANGLE_SQUARED
    size = jnp.sqrt(jnp.where(small, 1.0, squared))
    cosine = jnp.where(small, w, 1.0)
    ratio = jnp.where(small, squared, 0.0) / (cosine * cosine)
    near = (1.0 - ratio / 3.0) / cosine
    return 2.0 * jnp.where(small, near, jnp.arctan2(size, w) / size)[None] * vector


def half_rotation_to_quaternion(half: Float[Array, "3 *rest"]) -> Float[Array, "4 *rest"]:
    """Return the unit quaternion of half a rotation vector (rad)."""
    squared = (half * half).sum(0)
    small = squared < _SMALL_ANGLE_SQUARED
    angle = jnp.sqrt(jnp.where(small, 1.0, squared))
    sinc = jnp.where(small, 1.0 - squared / 6.0, jnp.sin(angle) / angle)
    cosine = jnp.where(small, 1.0 - squared / 2.0, jnp.cos(angle))
    return jnp.concatenate([cosine[None], sinc[None] * half])


def axis_rotation(
    axis: np.ndarray | Array, sine: Float[Array, " *rest"], cosine: Float[Array, " *rest"]
) -> Float[Array, "3 3 *rest"]:
    """Return rotations about one common unit axis ``(3,)`` by Rodrigues' formula."""
    x, y, z = axis
    cross_matrix = array_of(((0 * z, -z, y), (z, 0 * z, -x), (-y, x, 0 * z)))
    along = axis[:, None] * axis[None]
    sine, cosine = sine[None, None], cosine[None, None]
    return (
        expand_dims_like(along, sine)
        + expand_dims_like(np.eye(3) - along, sine) * cosine
        + expand_dims_like(cross_matrix, sine) * sine
    )


def euler_to_matrix(roll: Number, pitch: Number, yaw: Number) -> Float[Numbers, "3 3"]:
    """Return the rotation matrix ``(3, 3)`` of angles (rad): ``Rz(yaw) Ry(pitch) Rx(roll)``."""
    angles = xp.array([roll, pitch, yaw])
    (sr, sp, sy), (cr, cp, cy) = xp.sin(angles), xp.cos(angles)
    return xp.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def matrix_to_euler(rotation: np.ndarray) -> tuple[float, float, float]:
    """Return roll, pitch and yaw (rad) of a rotation matrix ``(3, 3)``, for `euler_to_matrix`.

    At a pitch of 90 degrees only the sum or difference of roll and yaw is defined. Roll is computed
    from the rotation left after pitch and yaw, so the three angles always give the matrix.
    """
    r = rotation
    yaw = np.arctan2(r[1, 0], r[0, 0])
    pitch = np.arctan2(-r[2, 0], np.hypot(r[0, 0], r[1, 0]))
    s, c = np.sin(yaw), np.cos(yaw)
    roll = np.arctan2(s * r[0, 2] - c * r[1, 2], c * r[1, 1] - s * r[0, 1])
    return float(roll), float(pitch), float(yaw)
