"""Buoyancy across the surface of the water, in closed form.

Water displaced by a cell of a body has the potential energy ``rho g V E(d, u)``. Here d is the
depth of the cell's centre, and u is the upward direction in the cell's axes. E gives all the rest:

    fraction under water   f = dE/dd,        force   rho g V f upwards,
    first moment           m = -dE/du,       moment  rho g V (m x u) about the centre.

So buoyancy is the gradient of a potential, and bodies that cross the surface neither gain nor lose
energy. E depends on the distribution of height over the cell (`Cell.profile`):

- *Ball and disc.* The distribution is a polynomial between -H and H, ``H^2 = sum a_i^2 u_i^2``, in
  every position. It is exact for an ellipsoid.
- *Box.* Height is the sum of three independent uniform variables of half-widths
  ``w_i = b_i |u_i|``. This gives a sum over the corners,

      f = sum_s s_1 s_2 s_3 max(0, d + s.w)^3 / (48 w_1 w_2 w_3),      s_i = +1 or -1.

  The sum takes some 240 operations. A lattice would need seven points along each edge for a
  righting moment within 1 %.
- *Cylinder.* Height is the sum of that of a disc of reach H and a uniform variable of half-width w.
  With e the integral of the disc's f and g the integral of e,

      f = H (e(s_1) - e(s_2)) / (2 w),   E = H^2 (g(s_1) - g(s_2)) / (2 w),
      s_1 = (d + w) / H,   s_2 = (d - w) / H.

- *Polyhedron.* E is an integral over the triangles (Gauss). A triangle has the area A, the outward
  normal n and corners at the depths t,

      V E = -2 sum_triangles A (n.u) [t_1, t_2, t_3] max(0, t)^4 / 24,

  and the bracket is a divided difference.

| symbol | name |
|---|---|
| d | ``depth`` of the cell's centre |
| u | ``up`` |
| t | ``depths`` |
| a, b | ``half_axes`` |
| H; w | ``reach`` |
"""

import itertools
import math
import typing
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import dot, expand_dims_like, matmul_t
from evo_cpg.creature.algebra.numerics import Numbers, xp
from evo_cpg.creature.creature import Creature
from evo_cpg.creature.per_body import take
from evo_cpg.creature.shapes import Cell, Profile
from evo_cpg.creature.tree import Tree

# Least w_i as a fraction of H: a level edge of a box has w_i = 0, and w_i is a divisor. The same
# holds for w and H of a cylinder, as fractions of the root of their squares' sum. The surface
# is blurred by this fraction. A level box rights itself more strongly by 2.5 times its square,
# 0.6 %. Rounding in float32 grows with the fourth power of 1 / fraction and is smaller.
_LEAST_REACH = 0.05

# Density of height, ``(1 - s^2)(c_0 + c_1 s^2 + c_2 s^4)`` for s = -d / H from -1 to 1. The exact
# density of a disc, 2/pi sqrt(1 - s^2), has no derivative at the rim. The polynomial has the same
# integral, variance and value in the middle. The error of f is at most 0.004.
_DENSITIES = {
    "ball": (0.75, 0.0, 0.0),
    "disc": (0.6366197723675814, 0.1107606868538609, 1.0643277197192085),
}


def _integrated(coefficients: tuple[float, ...]) -> tuple[float, ...]:
    """Return the integral from -1 of a polynomial of rising powers."""
    rising = [0.0, *(c / (k + 1) for k, c in enumerate(coefficients))]
    return -sum(c * (-1) ** k for k, c in enumerate(rising)), *rising[1:]


def _horner(coefficients: tuple[float, ...], x: Array) -> Array:
    """Return a polynomial of rising powers at x."""
    value = coefficients[-1]
    for c in reversed(coefficients[:-1]):
        value = value * x + c
    return value  # pyright: ignore[reportReturnType]


# e and g of a disc within it, by rising powers of s.
_C0, _C1, _C2 = _DENSITIES["disc"]
_DISC_E = _integrated(_integrated((_C0, 0.0, _C1 - _C0, 0.0, _C2 - _C1, 0.0, -_C2)))
_DISC_G = _integrated(_DISC_E)

# Product of two differences in depth (m^2) up to which a corner counts as level with the others.
_LEAST_SIDES = 1e-12

# Least half axis, so that a cell without size has finite moments, m.
_LEAST = 1e-9


class Cells(eqx.Module):
    """Parts of the creature's bodies with the same profile and the same triangles.

    Attributes:
        profile: distribution of height (`evo_cpg.creature.shapes.Cell`).
        bodies: index in the tree of each cell's body.
        centre: centre of each cell in the body's working frame, m.
        half_axes: half axes of each cell, m.
        volume: volume of each cell, m^3.
        triangles: corners of the polyhedron's triangles about the centre, m, or None for others.
    """

    profile: Profile = eqx.field(static=True)
    bodies: tuple[int, ...] = eqx.field(static=True)
    centre: Float[Numbers, "3 c"]
    half_axes: Float[Numbers, "3 c"]
    volume: Float[Numbers, " c"]
    triangles: Float[np.ndarray, "f 3 3"] | None = None


class DisplacedWater(NamedTuple):
    """Part of each body that is under water.

    Attributes:
        volume: volume under water, m^3.
        moment: first moment of the volume about the body's origin, in body axes, m^4.
    """

    volume: Float[Array, "b *n"]
    moment: Float[Array, "3 b *n"]


def make_cells(creature: Creature, tree: Tree) -> tuple[Cells, ...]:
    """Return the cells of all bodies, grouped by profile and triangles."""
    shapes = {body.name: body.shape for body in creature.bodies}
    parts = [(i, cell) for i, name in enumerate(tree.names) for cell in shapes[name].cells()]
    kinds: dict[tuple[Profile, bytes], list[tuple[int, Cell]]] = {
        (profile, b""): [] for profile in typing.get_args(Profile)
    }
    for i, cell in parts:
        outline = b"" if cell.triangles is None else cell.triangles.tobytes()
        kinds.setdefault((cell.profile, outline), []).append((i, cell))
    groups = []
    for (profile, _), alike in kinds.items():
        if not alike:
            continue
        bodies = tuple(i for i, _ in alike)
        groups.append(
            Cells(
                profile,
                bodies,
                xp.array([cell.centre for _, cell in alike]).T + tree.centre[:, np.array(bodies)],
                xp.maximum(xp.array([cell.half_axes for _, cell in alike]).T, _LEAST),
                xp.array([cell.volume for _, cell in alike]),
                alike[0][1].triangles,
            )
        )
    return tuple(groups)


def displacement(cells: tuple[Cells, ...], pose: Float[Array, "4 b *n"]) -> DisplacedWater:
    """Return volume and first moment of the part of each body that is under water.

    Args:
        cells: cells of the creature.
        pose: upward unit vector in the axes of every body, and the height of its origin above the
            surface, m.
    """
    total = jnp.zeros_like(pose)
    for group in cells:
        bodies = np.array(group.bodies)
        own = take(pose, bodies)
        up, centre, half_axes = (
            own[:3],
            expand_dims_like(group.centre, own),
            expand_dims_like(group.half_axes, own),
        )
        depth = -own[3] - dot(up, centre)
        if group.profile == "box":
            fraction, moment = _box(half_axes, up, depth)
        elif group.profile == "cylinder":
            fraction, moment = _cylinder(half_axes, up, depth)
        elif group.profile == "polyhedron":
            fraction, moment = _polyhedron(group, up, depth)
        else:
            fraction, moment = _round(_DENSITIES[group.profile], half_axes, up, depth)
        parts = jnp.concatenate([fraction[None], fraction[None] * centre + moment])
        owner = group.volume[None] * (bodies == np.arange(pose.shape[1])[:, None])
        total = total + matmul_t(parts, expand_dims_like(owner, parts, parts.ndim))
    return DisplacedWater(total[0], total[1:])


def _round(
    density: tuple[float, float, float], half_axes: Array, up: Array, depth: Array
) -> tuple[Array, Array]:
    """Return the fraction f and first moment m of cells with a given density of height.

    ``E = H e(s)`` at ``s = d / H``, so ``m = -(e - s f) dH/du``. The factor ``e - s f`` is the
    integral of the density times its variable from s to 1.
    """
    c0, c1, c2 = density
    stretched = half_axes * half_axes * up
    reach = jnp.sqrt(dot(stretched, up))
    s = jnp.clip(depth / reach, -1.0, 1.0)
    square = s * s
    fraction = 0.5 + s * (
        c0 + square * ((c1 - c0) / 3 + square * ((c2 - c1) / 5 - square * (c2 / 7)))
    )
    cosine_squared = 1.0 - square
    lever = (cosine_squared * cosine_squared) * (
        (c0 + c1 + c2) / 4
        - cosine_squared * ((c1 + 2 * c2) / 6)
        + (cosine_squared * cosine_squared) * (c2 / 8)
    )
    return fraction, -(lever / reach)[None] * stretched


def _box(half_axes: Array, up: Array, depth: Array) -> tuple[Array, Array]:
    """Return the fraction f and first moment m of boxes, from the sum over their corners."""
    stretched = half_axes * half_axes * up
    squares = stretched * up
    least = _LEAST_REACH**2
    reach = jnp.sqrt((1 - least) * squares + least * squares.sum(0, keepdims=True))
    # The result is constant beyond the limit, and powers of large depths would cancel badly.
    limit = reach.sum(0)
    depth = jnp.clip(depth, -limit, limit)
    scale = 1.0 / (48.0 * reach[0] * reach[1] * reach[2])
    fraction = energy = jnp.zeros_like(depth)
    derivative = jnp.zeros_like(reach)
    for corner in itertools.product((1.0, -1.0), repeat=3):
        signs = expand_dims_like(np.array(corner), reach)
        below = jnp.maximum(depth + dot(signs, reach), 0.0)
        cube = math.prod(corner) * below * below * below
        fraction, energy, derivative = (
            fraction + cube,
            energy + cube * below,
            derivative + signs * cube[None],
        )
    fraction, energy = scale * fraction, 0.25 * scale * energy
    # dE/dw_i over w_i. Every w_j depends on every u_i.
    derivative = (scale[None] * derivative - energy[None] / reach) / reach
    moment = -stretched * ((1 - least) * derivative + least * derivative.sum(0, keepdims=True))
    return fraction, moment


def _cylinder(half_axes: Array, up: Array, depth: Array) -> tuple[Array, Array]:
    """Return the fraction f and first moment m of cylinders along x."""
    stretched = half_axes * half_axes * up
    squares = stretched * up
    least = _LEAST_REACH**2
    every = squares.sum(0)
    along = jnp.sqrt((1 - least) * squares[0] + least * every)
    across = jnp.sqrt((1 - least) * (squares[1] + squares[2]) + least * every)
    depth = jnp.clip(depth, -along - across, along + across)
    parts = []
    for sign in (1.0, -1.0):
        # e and g of the disc at a depth over its reach, and ``2 g - s e``.
        s = (depth + sign * along) / across
        inner, beyond = jnp.clip(s, -1.0, 1.0), jnp.maximum(s - 1.0, 0.0)
        e, g = _horner(_DISC_E, inner), _horner(_DISC_G, inner)
        e, g = e + beyond, g + beyond * (1.0 + 0.5 * beyond)
        parts.append((e, g, 2.0 * g - s * e))
    (e1, g1, h1), (e2, g2, h2) = parts
    scale = 0.5 / along
    fraction = scale * across * (e1 - e2)
    energy = scale * across * across * (g1 - g2)
    # dE/dw over w and dE/dH over H. Both depend on every u_i.
    by_along = (scale * across * (e1 + e2) - energy / along) / along
    by_across = scale * (h1 - h2)
    each = jnp.stack([by_along, by_across, by_across])
    moment = -stretched * ((1 - least) * each + least * (by_along + by_across)[None])
    return fraction, moment


def _polyhedron(cells: Cells, up: Array, depth: Array) -> tuple[Array, Array]:
    """Return the fraction f and first moment m of equal polyhedra."""
    triangles = cells.triangles
    assert triangles is not None
    corners = jnp.asarray(triangles.swapaxes(0, 1), up.dtype)
    a, b, c = triangles.swapaxes(0, 1)
    faces = jnp.asarray(np.cross(b - a, c - a) / cells.volume[0], up.dtype)
    # The result is constant beyond the limit, and powers of large depths would cancel badly.
    limit = float(np.linalg.norm(triangles, axis=-1).max())
    flat_up, flat_depth = up.reshape(3, -1), jnp.clip(depth, -limit, limit).reshape(-1)
    first, second, third = (flat_depth[None] - corner @ flat_up for corner in corners)
    # The divided difference of max(0, t)^4 / 24 at the three depths, and its gradient. A lone wet
    # corner t_0 gives 24 times the value t_0^4 / ((t_0 - t_1)(t_0 - t_2)). A lone dry corner
    # subtracts this term from the value of a wet triangle. The other corners are at least |t_0|
    # away from t_0.
    wet = [depths > 0 for depths in (first, second, third)]
    lone = [(wet[i] != wet[i - 1]) & (wet[i] != wet[i - 2]) for i in range(3)]
    tip = jnp.where(lone[0], first, jnp.where(lone[1], second, third))
    others = jnp.where(lone[0], second, first), jnp.where(lone[2], second, third)
    sides = [tip - other for other in others]
    counts = (lone[0] | lone[1] | lone[2]) & (sides[0] * sides[1] > _LEAST_SIDES)
    fractions = [tip / jnp.where(counts, side, 1.0) for side in sides]
    most = (wet[0] & (wet[1] | wet[2])) | (wet[1] & wet[2])
    sign = jnp.where(counts, jnp.where(most, -1.0, 1.0), 0.0).astype(tip.dtype)
    both = sign * fractions[0] * fractions[1] * tip
    own = both * (4.0 - fractions[0] - fractions[1])
    theirs = [both * fraction for fraction in fractions]
    total = jnp.where(most, first + second + third, 0.0)
    squares = jnp.where(most, first * first + second * second + third * third, 0.0) + total * total
    value = (squares / 2 + both * tip) / 24
    at_second = jnp.where(lone[1], own, jnp.where(lone[0], theirs[0], theirs[1]))
    derivatives = (
        (total + jnp.where(most, first, 0.0) + jnp.where(lone[0], own, theirs[0])) / 24,
        (total + jnp.where(most, second, 0.0) + at_second) / 24,
        (total + jnp.where(most, third, 0.0) + jnp.where(lone[2] | ~counts, own, theirs[1])) / 24,
    )
    facing = faces @ flat_up
    fraction = -(facing * (derivatives[0] + derivatives[1] + derivatives[2])).sum(0)
    moment = faces.T @ value
    for corner, derivative in zip(corners, derivatives, strict=True):
        moment = moment - corner.T @ (facing * derivative)
    return fraction.reshape(depth.shape), moment.reshape(up.shape)
