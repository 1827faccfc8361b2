"""What Euler's equations add to a step of a body that tumbles.

Alone, a body turns by ``I w' = -w x I w``. The torque of a step's start, held over the step, makes
that grow: a capsule that spins at 40 rad/s about its axis and wobbles is 3 times as fast after a
second of steps of 1/240 s. Taken as Kahan's method takes it (1993; Hirota and Kimura 2000),

    I (w_1 - w) / h = -1/2 (w x I w_1 + w_1 x I w),

it keeps energy and momentum but for a bounded wobble, whatever the step, and so do steps whose
first solution it makes (`evo_cpg.physics.equations.with_mean_products`). Joints, drag and contact
change w_1; the torque is that of the body alone, and differs from that of the start as h does.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.creature.tree import Tree
from evo_cpg.spatial.linear import cross, dot, expand_dims_like, matmul, matvec, skew, toward_one
from evo_cpg.spatial.numerics import Numbers, xp


def gyroscopic_change(
    tree: Tree, angular: Float[Array, "3 b *n"], h: float
) -> Float[Array, "3 b *n"]:
    """Mean of ``w x I w`` over a step less that at its start, body axes, N m.

    Args:
        tree: whose bodies turn.
        angular: w in body axes, rad/s.
        h: s.
    """
    own = central_inertia(tree)
    # Cramer's rule multiplies three moments of inertia.
    scale = toward_one(xp.trace(own)) ** 2
    inertia = expand_dims_like(scale[None, None] * own, angular, angular.ndim + 1)
    momentum = matvec(inertia, angular)
    torque = cross(angular, momentum)
    slope = matmul(skew(angular), inertia) - skew(momentum)
    change = _solve(inertia + 0.5 * h * slope, -h * torque)
    return expand_dims_like(0.5 / scale, angular[0])[None] * matvec(slope, change)


def central_inertia(tree: Tree) -> Float[Numbers, "3 3 b"]:
    """About the centres of mass, in the working frames, kg m^2."""
    x, y, z = tree.com
    none = xp.zeros_like(x)
    arm = xp.array([[none, -z, y], [z, none, -x], [-y, x, none]])
    square = (arm[:, :, None] * arm[None]).sum(1)
    return tree.inertia[:3, :3] + tree.mass[None, None] * square


def _solve(m: Float[Array, "3 3 b *n"], v: Float[Array, "3 b *n"]) -> Float[Array, "3 b *n"]:
    """By Cramer's rule."""
    a, b, c = m[:, 0], m[:, 1], m[:, 2]
    across = cross(b, c)
    parts = [dot(v, across), dot(a, cross(v, c)), dot(a, cross(b, v))]
    return jnp.stack(parts) / dot(a, across)[None]
