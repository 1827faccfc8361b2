"""Reactive thrust: the momentum of the water that leaves a chain of slender bodies at its tail.

Lighthill's large-amplitude elongated-body theory (1971), in three dimensions. The centreline of the
body has the unit tangent t towards the head, and the velocity V relative to the water. Let
``u = V . t``, ``w = V - u t`` and ``p = M_a w``, with the added mass M_a of a section
(`evo_cpg.physics.water.sections`). The water's force on the body per length is

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

The derivative of q by V is ``t p^T - p t^T - u M_a``. Its first part is skew, and its second part
resists. The smooth function counts as constant within a step.
"""

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.decisions import some_hold
from evo_cpg.creature.algebra.linear import cross, dot, expand_dims_like
from evo_cpg.creature.algebra.numerics import Number, Numbers, smooth_step, xp
from evo_cpg.creature.creature import Creature, neutral_pose
from evo_cpg.creature.slender import LEAST_BODIES, SlenderChain, slender_chains
from evo_cpg.creature.tree import Tree
from evo_cpg.physics.tree.per_body import spread, take
from evo_cpg.physics.water.force_law import Bodies, ForceLaw, Part, blocks
from evo_cpg.physics.water.sections import Sections, chain_inertia, sections

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
        velocity: velocity of the edge relative to the water, m/s.
        tangent: unit vector from the edge into the body.
        directions: two unit vectors across the body.
        masses: shed added mass per length under water, times the fraction that is shed, kg/m.
        along: u, m/s.
        across: velocity along each of the directions, m/s.
    """

    velocity: Float[Array, "3 e *n"]
    tangent: Float[Array, "3 e *n"]
    directions: Float[Array, "3 2 e *n"]
    masses: Float[Array, "2 e *n"]
    along: Float[Array, "e *n"]
    across: Float[Array, "2 e *n"]

    @property
    def momentum(self) -> Float[Array, "3 e *n"]:
        """Momentum p of the shed water per length, kg/s."""
        return (self.directions * (self.masses * self.across)[None]).sum(1)


class ReactiveThrust(ForceLaw):
    """Momentum of the water that leaves slender chains at their edges.

    Attributes:
        bodies: index of the body of each edge in the tree.
        edges: the edges.
    """

    of_water: ClassVar[bool] = True

    bodies: tuple[int, ...] = eqx.field(static=True)
    edges: Edges

    def wrench(self, bodies: Bodies) -> Float[Array, "6 b *n"]:
        """Return the wrench of q on every body (`ForceLaw.wrench`)."""
        flow = self._flow(bodies)
        momentum = flow.momentum
        carried = (flow.masses * flow.across**2).sum(0)
        force = 0.5 * carried[None] * flow.tangent - flow.along[None] * momentum
        return self._on_bodies(bodies, self._wrenches(force))

    def parts(self, bodies: Bodies) -> tuple[Part]:
        """Return the wrench, with half of ``u M_a`` as D (`ForceLaw.parts`)."""
        flow = self._flow(bodies)
        rows = jnp.stack([self._wrenches(flow.directions[:, k]) for k in range(2)])
        weights = 0.5 * bodies.h * flow.masses * flow.along[None]
        outer = (weights[:, None, None] * rows[:, :, None] * rows[:, None]).sum(0)
        return (Part(self.wrench(bodies), self._on_bodies(bodies, blocks(outer))),)

    def averaged(self, start: Bodies, moving: Bodies) -> Float[Array, "6 b *n"]:
        """Return the wrench of ``t p^T - p t^T`` (`ForceLaw.averaged`)."""
        flow, velocity = self._flow(start), self._velocity(moving)
        momentum, tangent = flow.momentum, flow.tangent
        force = tangent * dot(momentum, velocity)[None] - momentum * dot(tangent, velocity)[None]
        return self._on_bodies(start, self._wrenches(force))

    def _velocity(self, bodies: Bodies) -> Float[Array, "3 e *n"]:
        """Return the velocity of every edge relative to the water, m/s."""
        relative = take(bodies.relative, np.array(self.bodies))
        points = expand_dims_like(self.edges.points, relative)
        return relative[3:] + cross(relative[:3], points)

    def _flow(self, bodies: Bodies) -> _Flow:
        velocity = self._velocity(bodies)
        tangent = expand_dims_like(self.edges.tangents, velocity)
        directions = expand_dims_like(self.edges.directions, velocity, velocity.ndim + 1)
        masses = expand_dims_like(self.edges.masses, velocity)
        along = dot(tangent, velocity)
        across = (directions * velocity[:, None]).sum(0)
        speed = jnp.sqrt((across * across).sum(0) + _SPEED_FLOOR)
        shed = smooth_step(along / (_ALL_SHED * speed))
        if bodies.displaced is not None:
            shed = shed * take(bodies.under_water, np.array(self.bodies), 0)
        return _Flow(velocity, tangent, directions, masses * shed[None], along, across)

    def _wrenches(self, force: Float[Array, "3 e *n"]) -> Float[Array, "6 e *n"]:
        """Return the wrenches of forces at the edges."""
        points = jnp.broadcast_to(expand_dims_like(self.edges.points, force), force.shape)
        return jnp.concatenate([cross(points, force), force])

    def _on_bodies(self, bodies: Bodies, parts: Array) -> Array:
        """Return the sum of parts ``(..., e, *n)`` of the edges for every body ``(..., b, *n)``."""
        axis = parts.ndim - (bodies.velocity.ndim - 1)
        return spread(parts, self.bodies, bodies.tree.body_count, axis)


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
        for k, toward_tail, masses in _shedding(chain, found, rotations, every_edge):
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


def _shedding(
    chain: SlenderChain, found: Sections, rotations: Float[Numbers, "b 3 3"], every_edge: bool
) -> list[tuple[int, bool, Float[Numbers, " 2"]]]:
    """Return the edges of a chain: the place in the chain, whether at the rear end, and masses."""
    last = len(chain.bodies) - 1
    edges = [(0, False, found.masses[0]), (last, True, found.masses[last])]
    for front in range(last):
        for own, other, toward_tail in ((front, front + 1, True), (front + 1, front, False)):
            masses = found.masses[own]
            turn = rotations[chain.bodies[own]].T @ rotations[chain.bodies[other]]
            cosines = found.directions[own] @ turn @ found.directions[other].T
            difference = masses - (cosines**2 * found.masses[other]).sum(-1)
            kept = xp.where(chain.lengths[other] > _MISSING, 0.0, masses)
            masses = xp.maximum(difference, 0.0) if found.sharp[own] else kept
            if every_edge or _sheds(masses, found.masses[own]):
                edges.append((own, toward_tail, masses))
    return edges


def _sheds(masses: Float[Numbers, " 2"], whole: Float[Numbers, " 2"]) -> bool:
    return some_hold(lambda: masses > _NO_DIFFERENCE * whole)
