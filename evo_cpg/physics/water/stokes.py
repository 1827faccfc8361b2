"""Resistance of an ellipsoid in creeping flow.

An ellipsoid with semi-axes a, b, c moves slowly through a fluid of viscosity mu. With
``D^2 = (a^2 + l) (b^2 + l) (c^2 + l)``, ``chi = int_0^inf dl / D`` and
``alpha_i = int_0^inf dl / ((a_i^2 + l) D)``, force and torque are (Oberbeck 1876, Jeffery 1922)

    F_i = -16 pi mu U_i / (chi + a_i^2 alpha_i),
    T_i = -16/3 pi mu w_i (a_j^2 + a_k^2) / (a_j^2 alpha_j + a_k^2 alpha_k).

A sphere has 6 pi mu a and 8 pi mu a^3.
"""

import numpy as np
from jaxtyping import Float

from evo_cpg.creature.algebra.numerics import Numbers, xp

# Points of the quadrature: the error is below 1e-6 for axes of 1 to 100.
_NODES = 60


def ellipsoid_resistance(
    axes: Float[Numbers, " 3"],
) -> tuple[Float[Numbers, " 3"], Float[Numbers, " 3"]]:
    """Return force over viscosity and velocity (m), torque over viscosity and rate (m^3).

    Args:
        axes: semi-axes, m.
    """
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    # l = s^2 (x / (1 - x))^2 maps (0, 1) to (0, infinity) and leaves a smooth integrand.
    x = (nodes + 1) / 2
    scale = axes.min() * axes.max()
    squares = xp.square(axes)
    shifted = squares[:, None] + (scale * (x / (1 - x)) ** 2)[None]
    integrand = weights / 2 * scale * 2 * x / (1 - x) ** 3 / xp.sqrt(shifted.prod(0))
    chi = integrand.sum()
    part = squares * (integrand / shifted).sum(-1)
    force = 16 * np.pi / (chi + part)
    order, other = np.array([1, 2, 0]), np.array([2, 0, 1])
    torque = 16 / 3 * np.pi * (squares[order] + squares[other]) / (part[order] + part[other])
    return force, torque
