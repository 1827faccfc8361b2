"""The root of a tree: its degrees of freedom, its motion, and its place in generalized vectors.

The root moves freely in space, or hangs on the fixed world (`evo_cpg.physics.tree.hanging`). Its
velocity is angular (rad/s), then linear at its centre (m/s), in
world axes. Its pose is the position of its centre (m) and a unit quaternion (w, x, y, z).

A generalized vector ``(v, *n)`` holds the root's `ROOT_DOFS` components, then the joints' in the
tree's order. A root that hangs moves by the first of the joints' components: its own components
are zero, with a mass matrix of 1. Other modules rely only on the root coming first and, in static
coordinates, on displacement before rotation (`evo_cpg.physics.step.statics`).
"""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import (
    cross,
    inverse_symmetric,
    matmul,
    matmul_t,
    matvec,
    matvec_t,
    transpose,
)
from evo_cpg.creature.algebra.rotation import integrate_quaternion, quaternion_to_matrix
from evo_cpg.native.fuse import symmetric
from evo_cpg.physics.tree.spatial_algebra import BodyMotion, Inertia, Motion, Wrench

# Degrees of freedom of the root.
ROOT_DOFS = 6

# Slices of a generalized vector: components of the root, then of the joints.
ROOT, JOINTS = slice(0, ROOT_DOFS), slice(ROOT_DOFS, None)

# Static coordinates of the root (`evo_cpg.physics.step.statics`): displacement, then rotation
# vector. The first `LENGTHS` are in m. Motion along `SYMMETRIES` (x, y, turn about z) does not
# change the height above level ground.
LENGTHS, SYMMETRIES = 3, (0, 1, 5)


# Pose and velocity.


def angular(velocity: Float[Array, "6 *n"]) -> Float[Array, "3 *n"]:
    """Return the angular part of a velocity of the root, rad/s."""
    return velocity[:3]


def linear(velocity: Float[Array, "6 *n"]) -> Float[Array, "3 *n"]:
    """Return the linear part of a velocity of the root, m/s."""
    return velocity[3:]


def at_rest(joint_rates: Float[Array, "d *n"]) -> Float[Array, "6 *n"]:
    """Return the velocity of a root at rest, for joint rates of the same batch."""
    return jnp.zeros((ROOT_DOFS, *joint_rates.shape[1:]), joint_rates.dtype)


def rotation(orientation: Float[Array, "4 *n"]) -> Float[Array, "3 3 *n"]:
    """Return the matrix that rotates vectors from root axes to world axes."""
    return quaternion_to_matrix(orientation)


def motion(velocity: Float[Array, "6 *n"]) -> BodyMotion:
    """Return velocity and velocity-product acceleration of the root's body."""
    w, v = angular(velocity), linear(velocity)
    return BodyMotion(w, v, jnp.zeros_like(w), cross(v, w))


def moved(
    position: Float[Array, "3 *n"],
    orientation: Float[Array, "4 *n"],
    velocity: Float[Array, "6 *n"],
    h: float | Float[Array, ""],
) -> tuple[Float[Array, "3 *n"], Float[Array, "4 *n"]]:
    """Return the pose after h seconds (negative: before) at a constant velocity."""
    return (
        position + h * linear(velocity),
        integrate_quaternion(orientation, angular(velocity), h),
    )


def displaced(
    position: Float[Array, "3"], orientation: Float[Array, "4"], x: Float[Array, " k"]
) -> tuple[Float[Array, "3"], Float[Array, "4"]]:
    """Return the pose that the root's static coordinates x reach from a given pose."""
    return position + x[:LENGTHS], integrate_quaternion(orientation, x[LENGTHS:ROOT_DOFS], 1.0)


# Generalized vectors.


def root_part(vector: Float[Array, "v *n"]) -> Float[Array, "6 *n"]:
    """Return the root's components."""
    return vector[ROOT]


def joint_part(vector: Float[Array, "v *n"]) -> Float[Array, "d *n"]:
    """Return the components of the joints."""
    return vector[JOINTS]


def size_of(dof_count: int) -> int:
    """Return the size of a generalized vector, from the number of joint degrees of freedom."""
    return ROOT_DOFS + dof_count


def joint_rows(dofs: np.ndarray) -> np.ndarray:
    """Return the indices of the joints' degrees of freedom in a generalized vector."""
    return ROOT_DOFS + dofs


def acceleration(y: Float[Array, "v *n"]) -> Motion:
    """Return the root's part of a vector of generalized accelerations."""
    return Motion(y[:3], y[3:ROOT_DOFS])


def solved(inertia: Inertia, bias: Wrench) -> Motion:
    """Return the root's acceleration ``-I^-1 p``, by eliminating the linear part.

    Args:
        inertia: I, the articulated inertia of the whole tree at the root.
        bias: p, the bias wrench.
    """
    linear_inverse = inverse_symmetric(inertia.linear)
    coupling = matmul(inertia.mixed, linear_inverse)
    schur = symmetric(inertia.angular - matmul_t(coupling, inertia.mixed))
    turning = matvec(inverse_symmetric(schur), matvec(coupling, bias.force) - bias.moment)
    moving = matvec(linear_inverse, -bias.force - matvec_t(inertia.mixed, turning))
    return Motion(turning, moving)


def vector(
    part: Motion | Wrench, joints: Sequence[Float[Array, "_ *n"]] = ()
) -> Float[Array, "v *n"]:
    """Return the generalized vector of the root's acceleration or wrench, then the joints'."""
    return jnp.concatenate([*part, *joints])


def components(part: Wrench) -> list[Float[Array, "*n"]]:
    """Return the components of wrenches on the root, in the order of generalized vectors."""
    return [*part.moment, *part.force]


def mass_block(inertia: Inertia) -> Float[Array, "6 6 *n"]:
    """Return the root's block of the mass matrix, from a composite inertia."""
    rows = [[inertia.angular, inertia.mixed], [transpose(inertia.mixed), inertia.linear]]
    return jnp.concatenate([jnp.concatenate(row, 1) for row in rows])


def plus_torque(force: Float[Array, "v *n"], torque: Float[Array, "d *n"]) -> Float[Array, "v *n"]:
    """Add joint torques to a generalized force."""
    return force.at[JOINTS].add(torque)


def joint_block(matrix: Float[Array, "v v *n"]) -> Float[Array, "d d *n"]:
    """Return the joints' part of a generalized matrix."""
    return matrix[JOINTS, JOINTS]


def plus_joint_block(
    matrix: Float[Array, "v v *n"], block: Float[Array, "d d *n"]
) -> Float[Array, "v v *n"]:
    """Add a matrix of the joints to a generalized matrix."""
    return matrix.at[JOINTS, JOINTS].add(block)


def plus_joint_diagonal(
    matrix: Float[Array, "v v *n"], diagonal: Float[Array, "d *#n"]
) -> Float[Array, "v v *n"]:
    """Add a diagonal of the joints to a generalized matrix."""
    joints = np.arange(ROOT_DOFS, len(matrix))
    return matrix.at[joints, joints].add(diagonal)
