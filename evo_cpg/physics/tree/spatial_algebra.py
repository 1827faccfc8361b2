"""Spatial vectors and inertias by their blocks of three (Featherstone 2008, chapter 2).

All quantities have world axes and refer to the origin of a body. The transforms from parent to
child are therefore displacements by an ``offset`` r:

| transform | function |
|---|---|
| ``m_i = X m_p`` | `motion_at_child` |
| ``f_p = X^T f_i`` | `wrench_at_parent` |
| ``I_p = X^T I_i X`` | `inertia_at_parent` |

Arrays are ``(components, ...)``, and all further axes broadcast.
"""

from typing import NamedTuple

from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import cross, matmul, matmul_t, skew
from evo_cpg.native.fuse import symmetric


class Motion(NamedTuple):
    """A velocity or acceleration: angular (rad/s, rad/s^2), and of the origin (m/s, m/s^2)."""

    angular: Float[Array, "3 *rest"]
    linear: Float[Array, "3 *rest"]


class BodyMotion(NamedTuple):
    """Velocities of bodies, with the accelerations that they have at constant joint rates.

    Attributes:
        angular: velocity, rad/s.
        linear: velocity of the origin, m/s.
        bias_angular: velocity-product acceleration, rad/s^2.
        bias_linear: velocity-product acceleration of the origin, m/s^2.
    """

    angular: Float[Array, "3 *rest"]
    linear: Float[Array, "3 *rest"]
    bias_angular: Float[Array, "3 *rest"]
    bias_linear: Float[Array, "3 *rest"]


class Wrench(NamedTuple):
    """Moment (N m) and force (N)."""

    moment: Float[Array, "3 *rest"]
    force: Float[Array, "3 *rest"]


class Inertia(NamedTuple):
    """Symmetric 6x6 matrices by their 3x3 blocks, ``[[angular, mixed], [mixed^T, linear]]``."""

    angular: Float[Array, "3 3 *rest"]
    mixed: Float[Array, "3 3 *rest"]
    linear: Float[Array, "3 3 *rest"]


def make_inertia(
    angular: Float[Array, "3 3 *rest"],
    mixed: Float[Array, "3 3 *rest"],
    linear: Float[Array, "3 3 *rest"],
) -> Inertia:
    """Return the inertia with the given blocks.

    The blocks ``angular`` and ``linear`` are symmetric. Fused functions read only their upper
    triangles.
    """
    return Inertia(symmetric(angular), mixed, symmetric(linear))


def motion_at_child(motion: Motion, offset: Float[Array, "3 *#rest"]) -> Motion:
    """Return a motion at a point that is ``offset`` away."""
    return Motion(motion.angular, motion.linear + cross(motion.angular, offset))


def wrench_at_parent(wrench: Wrench, offset: Float[Array, "3 *#rest"]) -> Wrench:
    """Return a wrench about a point that is ``-offset`` away."""
    return Wrench(wrench.moment + cross(offset, wrench.force), wrench.force)


def inertia_at_parent(inertia: Inertia, offset: Float[Array, "3 *#rest"]) -> Inertia:
    """Return an inertia about a point that is ``-offset`` away."""
    shift = skew(offset)
    mixed = inertia.mixed + matmul(shift, inertia.linear)
    angular = inertia.angular + matmul_t(shift, inertia.mixed) - matmul(mixed, shift)
    return Inertia(symmetric(angular), mixed, inertia.linear)
