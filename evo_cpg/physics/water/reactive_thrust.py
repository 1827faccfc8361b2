"""Reactive thrust: the momentum of the water that leaves a chain of slender bodies at its tail.

Lighthill's large-amplitude elongated-body theory (1971), in three dimensions. The centreline of the
body has the unit tangent t towards the head, and the velocity V relative to the water. Let
``u = V . t``, ``w = V - u t`` and ``p = M_a w``, with the added mass M_a of a section
(`sections`). The water's force on the body per length is

    f = -dp/dt + d/da (u p - 1/2 (w . p) t),    a from the tail to the head.

For a rigid body the integral of f along the centreline has two parts:

- Kirchhoff's equations with the inertia of the sections (`evo_cpg.physics.water.added_mass`). They
  conserve the momentum of body and water.
- A force at each end: q at the rear end, and -q at the front end, with

      q = 1/2 (w . p) t - u p.

Their moments about any point add up to the moment of f. The moment ``w x p`` of a section about its
own centre is an addition of Kirchhoff's equations. It is along t.

At a joint, water leaves one body and flows along the next. The forces q and -q then act at the same
point of the two bodies, so they cancel in the equations of motion. They are left out. What remains
are the edges at which a chain sheds water:

- The free end of the tail, and in backward motion the nose.
- A sharp edge at a joint, if the next body has a smaller section: the difference is shed (Wu 1971).
  Round bodies hand all water on.

The water arrives at the nose without momentum, so p = 0 there and no force acts. In general, water
leaves an edge only if u > 0, with t from the edge into the body. The force is multiplied by a
smooth function of the angle between V and t, which is 0 for u < 0 and 1 for ``u > |w| / 5``. The
power ``q . V = -1/2 u w . p`` is then never positive: an edge only takes energy from the body. The
theory is silent about u < 0 at a tail, where it would return energy.

The water around a slender body moves across the body only. A section sets the mass ``m_k`` per
length in motion for each of two directions ``e_k`` across the body (Lamb 1932, section 71):

    ellipse    rho pi a^2, with the half-width a normal to the motion,
    rectangle  rho pi a^2 c(b/a), with the half-thickness b along the motion.

The factor c of a rectangle is from a panel method. The section of a tapered body is its mean
section. A body of finite length carries less: all sections of a chain are multiplied by Lamb's
coefficient for a spheroid with the length of the chain and the width of its widest body. The
inertia M of a body is the integral of its section's added mass along its centreline. It has no part
along the body and none in rolling.

The derivative of q by V is ``t p^T - p t^T - u M_a``. Its first part is skew, and its second part
resists. The smooth function counts as constant within a step.
"""

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.decisions import chosen, some_hold
from evo_cpg.creature.algebra.linear import as_matrix_of, cross, dot, expand_dims_like
from evo_cpg.creature.algebra.numerics import Number, Numbers, smooth_step, xp
from evo_cpg.creature.creature import Creature, neutral_pose
from evo_cpg.creature.per_body import spread, take
from evo_cpg.creature.shapes import Ellipsoid
from evo_cpg.creature.slender import LEAST_BODIES, SlenderChain, slender_chains
from evo_cpg.creature.tree import Tree
from evo_cpg.physics.water.added_mass import ellipsoid
from evo_cpg.physics.water.force_law import Bodies, ForceLaw, WrenchPart, blocks

# Thicknesses b/a of rectangles, and their added mass over rho pi a^2 (panel method).
_RECTANGLE = (
    np.array([0.0, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0]),
    np.array([1.0, 1.14, 1.22, 1.36, 1.51, 1.70, 1.98, 2.23]),
)

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
    """Return the sections of a chain."""
    shapes = [creature.bodies[body].shape for body in chain.bodies]
    directions, masses, widths, sharp = [], [], [], []
    for shape, tangent, length in zip(shapes, chain.tangents, chain.lengths, strict=True):
        half, axes = shape.stretch
        aligned = xp.abs(tangent @ axes)
        along = chosen(
            lambda aligned=aligned: int(np.argmax(aligned)),
            lambda k, aligned=aligned: aligned[k] >= xp.max(aligned),
        )
        one, other = (half[(along + k) % 3] for k in (1, 2))
        first = axes[:, (along + 1) % 3]
        first = first - tangent * (tangent @ first)
        first = first / xp.maximum(xp.linalg.norm(first), _LEAST)
        directions.append(xp.stack([first, xp.cross(tangent, first)]))
        sharp.append(all(cell.profile == "box" for cell in shape.cells()))
        if sharp[-1]:
            own = [
                np.pi * width**2 * xp.interp(thin / xp.maximum(width, _LEAST), *_RECTANGLE)
                for width, thin in ((other, one), (one, other))
            ]
        else:
            # The mean section; bodies that overlap at joints have no more than the largest one.
            mean = shape.volume / xp.maximum(length, _LEAST)
            fullness = xp.minimum(mean / xp.maximum(np.pi * one * other, _LEAST**2), 1.0)
            own = fullness * np.pi * other**2, fullness * np.pi * one**2
        masses.append(xp.array(own))
        widths.append(2 * xp.maximum(one, other))
    # Lamb's k_2 of a spheroid: its added mass across over that of its sections.
    long, wide = (xp.maximum(x, _LEAST) for x in (chain.lengths.sum(), xp.max(xp.array(widths))))
    spheroid = Ellipsoid((long / 2, wide / 2, wide / 2))
    slenderness = ellipsoid(spheroid)[4] / spheroid.volume
    return Sections(xp.stack(directions), density * slenderness * xp.stack(masses), tuple(sharp))


def chain_inertia(
    tree: Tree, creature: Creature, chain: SlenderChain, found: Sections
) -> dict[int, Float[Numbers, "6 6"]]:
    """Return M of each body of a chain in its working frame, by the body's index in the tree."""
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


# Ratio u / |w| at which an edge sheds all water, 79 degrees from the tangent.
_ALL_SHED = 0.2

# Squared speed (m^2/s^2) added under the root so that its gradient exists at rest.
_SPEED_FLOOR = 1e-12

# Fraction of a section's added mass below which a difference counts as none. Length below which a
# body counts as missing, m.
_NO_DIFFERENCE, _MISSING = 1e-9, 1e-9


class Edges(NamedTuple):
    """Edges at which chains shed water, in working frames.

    Attributes:
        points: positions, m.
        tangents: unit vectors from the edge into the body.
        directions: two unit vectors across the body.
        masses: shed added mass per length for motion along each direction, kg/m.
    """

    points: Float[Numbers, "3 e"]
    tangents: Float[Numbers, "3 e"]
    directions: Float[Numbers, "3 2 e"]
    masses: Float[Numbers, "2 e"]


class _Flow(NamedTuple):
    """Motion and momentum of the water at every edge.

    Attributes:
        tangent: unit vector from the edge into the body.
        directions: two unit vectors across the body.
        masses: shed added mass per length under water, times the fraction that is shed, kg/m.
        along: u, m/s.
        across: velocity along each of the directions, m/s.
        momentum: momentum p of the shed water per length, kg/s.
    """

    tangent: Float[Array, "3 e *n"]
    directions: Float[Array, "3 2 e *n"]
    masses: Float[Array, "2 e *n"]
    along: Float[Array, "e *n"]
    across: Float[Array, "2 e *n"]
    momentum: Float[Array, "3 e *n"]


class ReactiveThrust(ForceLaw):
    """Momentum of the water that leaves slender chains at their edges.

    Attributes:
        bodies: index of the body of each edge in the tree.
    """

    of_water: ClassVar[bool] = True

    bodies: tuple[int, ...] = eqx.field(static=True)
    edges: Edges

    def wrench(self, bodies: Bodies) -> Float[Array, "6 b *n"]:
        """Return the wrench of q on every body (`ForceLaw.wrench`)."""
        flow = self._flow(bodies)
        carried = (flow.masses * flow.across**2).sum(0)
        force = 0.5 * carried[None] * flow.tangent - flow.along[None] * flow.momentum
        return spread(self._wrenches(force), self.bodies, bodies.tree.body_count)

    def parts(self, bodies: Bodies) -> tuple[WrenchPart]:
        """Return the wrench, with half of ``u M_a`` as D (`ForceLaw.parts`)."""
        flow = self._flow(bodies)
        rows = jnp.stack([self._wrenches(flow.directions[:, k]) for k in range(2)])
        weights = 0.5 * bodies.h * flow.masses * flow.along[None]
        outer = (weights[:, None, None] * rows[:, :, None] * rows[:, None]).sum(0)
        resistance = spread(blocks(outer), self.bodies, bodies.tree.body_count, 3)
        return (WrenchPart(self.wrench(bodies), resistance),)

    def averaged(self, start: Bodies, moving: Bodies) -> Float[Array, "6 b *n"]:
        """Return the wrench of ``t p^T - p t^T`` (`ForceLaw.averaged`)."""
        flow, velocity = self._flow(start), self._velocity(moving)
        momentum, tangent = flow.momentum, flow.tangent
        force = tangent * dot(momentum, velocity)[None] - momentum * dot(tangent, velocity)[None]
        return spread(self._wrenches(force), self.bodies, start.tree.body_count)

    def _velocity(self, bodies: Bodies) -> Float[Array, "3 e *n"]:
        """Return the velocity of every edge relative to the water, m/s."""
        relative = take(bodies.relative, np.array(self.bodies))
        points = expand_dims_like(self.edges.points, relative)
        return relative[3:] + cross(relative[:3], points)

    def _flow(self, bodies: Bodies) -> _Flow:
        velocity = self._velocity(bodies)
        tangent = expand_dims_like(self.edges.tangents, velocity)
        directions = as_matrix_of(self.edges.directions, velocity)
        masses = expand_dims_like(self.edges.masses, velocity)
        along = dot(tangent, velocity)
        across = (directions * velocity[:, None]).sum(0)
        speed = jnp.sqrt((across * across).sum(0) + _SPEED_FLOOR)
        shed = smooth_step(along / (_ALL_SHED * speed))
        if bodies.displaced is not None:
            shed = shed * take(bodies.under_water, np.array(self.bodies), 0)
        masses = masses * shed[None]
        momentum = (directions * (masses * across)[None]).sum(1)
        return _Flow(tangent, directions, masses, along, across, momentum)

    def _wrenches(self, force: Float[Array, "3 e *n"]) -> Float[Array, "6 e *n"]:
        """Return the wrenches of forces at the edges."""
        points = jnp.broadcast_to(expand_dims_like(self.edges.points, force), force.shape)
        return jnp.concatenate([cross(points, force), force])


def reactive_water(
    creature: Creature,
    tree: Tree,
    density: Number,
    others: Float[Numbers, "6 6 b"],
    every_edge: bool = False,
) -> tuple[Float[Numbers, "6 6 b"], ReactiveThrust] | None:
    """Return the inertia M of the water around each body, and the law of what chains shed.

    Args:
        creature: the animal.
        tree: tree of the creature.
        density: density of the water, kg/m^3.
        others: M of bodies outside chains of at least `LEAST_BODIES` bodies, in working frames.
        every_edge: whether to keep edges that shed nothing, for the common layout of a batch.

    Returns:
        M in working frames and the law, or None without a slender chain.
    """
    _, rotations = neutral_pose(creature)
    inertias: dict[int, Numbers] = {}
    places, edges = [], []
    for chain in slender_chains(creature):
        if len(chain.bodies) < LEAST_BODIES:
            continue
        found = sections(creature, chain, density)
        inertias |= chain_inertia(tree, creature, chain, found)
        # Place in the chain, whether the edge is at the rear end, and the masses that it sheds.
        last = len(chain.bodies) - 1
        shedding = [(0, False, found.masses[0]), (last, True, found.masses[last])]
        for front in range(last):
            for own, other, toward_tail in ((front, front + 1, True), (front + 1, front, False)):
                masses = found.masses[own]
                turn = rotations[chain.bodies[own]].T @ rotations[chain.bodies[other]]
                cosines = found.directions[own] @ turn @ found.directions[other].T
                difference = masses - (cosines**2 * found.masses[other]).sum(-1)
                kept = xp.where(chain.lengths[other] > _MISSING, 0.0, masses)
                masses = xp.maximum(difference, 0.0) if found.sharp[own] else kept
                least = _NO_DIFFERENCE * found.masses[own]
                if every_edge or some_hold(lambda own=masses, least=least: own > least):
                    shedding.append((own, toward_tail, masses))
        for k, toward_tail, masses in shedding:
            body = tree.names.index(creature.bodies[chain.bodies[k]].name)
            point = (chain.rear if toward_tail else chain.front)[k] + tree.centre[:, body]
            tangent = chain.tangents[k] if toward_tail else -chain.tangents[k]
            places.append(body)
            edges.append((point, tangent, found.directions[k].T, masses))
    if not edges:
        return None
    each = range(tree.body_count)
    inertia = xp.stack([inertias.get(i, others[..., i]) for i in each], -1)
    stacked = Edges(*(xp.stack(column, -1) for column in zip(*edges, strict=True)))
    return inertia, ReactiveThrust(tuple(places), stacked)
