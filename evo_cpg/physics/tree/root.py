"""The root of a tree: its degrees of freedom, its motion, and its place in generalized vectors.

The root moves freely in space, or hangs on the fixed world (`evo_cpg.physics.tree.hanging`). Its
velocity is angular (rad/s), then linear at its centre (m/s), in
world axes. Its pose is the position of its centre (m) and a unit quaternion (w, x, y, z).

A generalized vector ``(v, *n)`` holds the root's `ROOT_DOFS` components, then the joints' in the
tree's order. A root that hangs moves by the first of the joints' components: its own components
are zero, with a mass matrix of 1. Other modules rely only on the root coming first and, in static
coordinates, on displacement before rotation (`evo_cpg.physics.step.statics`).
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import (
    cross,
    inverse_symmetric,
    matmul,
    matmul_t,
    matvec,
    matvec_t,
)
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


def motion(velocity: Float[Array, "6 *n"]) -> BodyMotion:
    """Return velocity and velocity-product acceleration of the root's body."""
    w, v = velocity[:3], velocity[3:]
    return BodyMotion(w, v, jnp.zeros_like(w), cross(v, w))


def solved(inertia: Inertia, bias: Wrench) -> Motion:
    """Return the root's acceleration ``-I^-1 p``, by eliminating the linear part.

    ``I`` and ``p`` are the articulated inertia and bias of the whole tree at the root.
    """
    linear_inverse = inverse_symmetric(inertia.linear)
    coupling = matmul(inertia.mixed, linear_inverse)
    schur = symmetric(inertia.angular - matmul_t(coupling, inertia.mixed))
    turning = matvec(inverse_symmetric(schur), matvec(coupling, bias.force) - bias.moment)
    moving = matvec(linear_inverse, -bias.force - matvec_t(inertia.mixed, turning))
    return Motion(turning, moving)
