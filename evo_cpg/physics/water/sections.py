"""Added mass of the sections of slender bodies, and the inertia of the water around a chain.

The water around a slender body moves across the body only. A section sets the mass ``m_k`` per
length in motion for each of two directions ``e_k`` across the body (Lamb 1932, section 71):

    ellipse    rho pi a^2, with the half-width a normal to the motion,
    rectangle  rho pi a^2 c(b/a), with the half-thickness b along the motion.

The factor c of a rectangle is from a panel method. The section of a tapered body is its mean
section. A body of finite length carries less: all sections of a chain are multiplied by Lamb's
coefficient for a spheroid with the length of the chain and the width of its widest body.

The inertia M of a body is the integral of its section's added mass along its centreline. Like
Lighthill's theory it has no part along the body and none in rolling.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from evo_cpg.creature.algebra.decisions import chosen
from evo_cpg.creature.algebra.numerics import Number, Numbers, xp
from evo_cpg.creature.creature import Creature
from evo_cpg.creature.shapes import Ellipsoid, Shape
from evo_cpg.creature.slender import SlenderChain
from evo_cpg.creature.tree import Tree
from evo_cpg.physics.water.added_mass import ellipsoid

# Added mass of a rectangle over rho pi a^2, for thicknesses b/a (panel method).
_THICKNESS = np.array([0.0, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0])
_RECTANGLE = np.array([1.0, 1.14, 1.22, 1.36, 1.51, 1.70, 1.98, 2.23])

# Least size of a section, m, so that bodies without size have no 0 / 0.
_LEAST = 1e-9


class Sections(NamedTuple):
    """Sections of the bodies of a chain, from the nose to the tail, in geometric frames.

    Attributes:
        directions: two unit vectors across each body.
        masses: added mass per length for motion along each direction, kg/m.
        sharp: whether the edges of each body are sharp.
    """

    directions: Float[Numbers, "n 2 3"]
    masses: Float[Numbers, "n 2"]
    sharp: tuple[bool, ...]


def sections(creature: Creature, chain: SlenderChain, density: Number) -> Sections:
    """Return the sections of a chain.

    Args:
        creature: the animal.
        chain: one of its chains.
        density: density of the water, kg/m^3.
    """
    shapes = [creature.bodies[body].shape for body in chain.bodies]
    found = [
        _section(shape, tangent, length)
        for shape, tangent, length in zip(shapes, chain.tangents, chain.lengths, strict=True)
    ]
    directions, masses, widths = zip(*found, strict=True)
    slenderness = _finite_length(chain.length, xp.max(xp.array(widths)))
    return Sections(
        xp.stack(directions),
        density * slenderness * xp.stack(masses),
        tuple(_is_box(shape) for shape in shapes),
    )


def chain_inertia(
    tree: Tree, creature: Creature, chain: SlenderChain, found: Sections
) -> dict[int, Float[Numbers, "6 6"]]:
    """Return M of each body of a chain in its working frame, by the body's index in the tree.

    Args:
        tree: tree of the creature.
        creature: the animal.
        chain: one of its chains.
        found: sections of the chain.
    """
    inertias = {}
    for k, body in enumerate(chain.bodies):
        i = tree.names.index(creature.bodies[body].name)
        section = xp.einsum(
            "k,ki,kj->ij", found.masses[k], found.directions[k], found.directions[k]
        )
        middle = (chain.front[k] + chain.rear[k]) / 2 + tree.centre[:, i]
        # Two Gauss points are exact: M is quadratic along the centreline.
        reach = chain.tangents[k] * chain.lengths[k] / np.sqrt(12)
        total = 0.0
        for x, y, z in (middle - reach, middle + reach):
            shift = xp.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
            rows = xp.concatenate([shift, np.eye(3)], 1)
            total = total + chain.lengths[k] / 2 * rows.T @ section @ rows
        inertias[i] = total
    return inertias


def _is_box(shape: Shape) -> bool:
    return all(cell.profile == "box" for cell in shape.cells())


def _section(shape: Shape, tangent: Numbers, length: Number) -> tuple[Numbers, Numbers, Number]:
    """Return two directions across a body, its added mass over density, and its width, m."""
    half, axes = shape.stretch
    along = chosen(lambda: int(np.argmax(np.abs(tangent @ axes))))
    one, other = (half[(along + k) % 3] for k in (1, 2))
    first = axes[:, (along + 1) % 3]
    first = first - tangent * (tangent @ first)
    first = first / xp.maximum(xp.linalg.norm(first), _LEAST)
    if _is_box(shape):
        masses = _rectangle(other, one), _rectangle(one, other)
    else:
        # The mean section; bodies that overlap at joints have no more than the largest one.
        mean = shape.volume / xp.maximum(length, _LEAST)
        fullness = xp.minimum(mean / xp.maximum(np.pi * one * other, _LEAST**2), 1.0)
        masses = fullness * np.pi * other**2, fullness * np.pi * one**2
    width = 2 * xp.maximum(one, other)
    return xp.stack([first, xp.cross(tangent, first)]), xp.array(masses), width


def _rectangle(half_width: Number, half_thickness: Number) -> Number:
    """Return the added mass over density of a rectangle that moves along its thickness, m^2."""
    ratio = half_thickness / xp.maximum(half_width, _LEAST)
    return np.pi * half_width**2 * xp.interp(ratio, _THICKNESS, _RECTANGLE)


def _finite_length(length: Number, width: Number) -> Number:
    """Return Lamb's k_2 of a spheroid: its added mass across over that of its sections."""
    long, wide = xp.maximum(length, _LEAST), xp.maximum(width, _LEAST)
    spheroid = Ellipsoid((long / 2, wide / 2, wide / 2))
    return ellipsoid(spheroid)[4] / spheroid.volume
