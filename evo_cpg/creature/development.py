"""Development of a graph into bodies (Sims 1994, "Evolving virtual creatures").

The root part is the first body. Bodies grow breadth-first along the connections of their nodes:

- A node occurs at most ``recursion`` times on a path from the root. A terminal connection grows
  only on a body whose own node has reached its recursion.
- A connection's place is projected to the parent's surface. The child's +x axis is along the
  outward normal of that face, then turned by yaw, pitch and roll.
- A reflecting connection grows a second body, mirrored at the plane y = 0 of the parent's frame.
  A mirrored body mirrors all that grows on it: a place p becomes S p, and a rotation R becomes
  S R S, where S = diag(1, -1, 1).
- All mirror images of a body grow or none does. They do not grow if one of them would overlap an
  earlier body other than its parent in the neutral pose, or another image, or if they are more
  bodies than there is room for. Nothing hangs on a body that did not grow.
- If the volume of all bodies is too large, all lengths shrink by the same factor.

Growth is a choice of bodies and has no derivative. The bodies that grew have derivatives by sizes,
places, strengths, limits and control genes. These take no notice of rounding and of the limit of
the volume.

Frames are at the centres of the boxes. Every body but the root has its joint at the centre of its
near end face, ``(-half_x, 0, 0)`` in its own frame. The root faces +x, and z is up.

Differs from Sims 1994: a part that would overlap does not grow. Sims discards creatures with parts
that overlap too much. A rule of growth keeps the rest of the creature instead.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from evo_cpg.creature.algebra.linear import matmul, matvec, matvec_t, t_matmul
from evo_cpg.creature.graph import JOINT_AXES, MOST_RECURSION, GraphLayout, PlanGraph, infinitesimal
from evo_cpg.creature.walk import walk_order

# Numbers of the growth are whole, so that the compiler cannot round them in different ways. Then a
# plan has the same bodies alone, in any batch, in float32 and in float64. Cosines, and places on
# faces, are multiples of 2^-15. Lengths are multiples of 2^-13 of the largest half extent. The
# error of a body's place is about 0.1 mm then. Only the overlap test depends on it.
_BITS, _LENGTH = 15, 2**13
_ONE = 2**_BITS
# Steps of the logarithm from the smallest to the largest half extent, 0.2 % of a length each, and
# a step of the logarithm of all lengths if the volume is too large.
_SIZES, _SHRINKING = 1024, 0.001
# Largest factors by which a connection enlarges and shrinks.
_LARGER, _SMALLER = 1.5, 2.0
# Added to rounded cosines, so that the cross product of nearly parallel edges separates no boxes.
_PARALLEL = 4
LEAST_TURN = 1 / 16
"""Least fraction of the largest joint angle, because a joint without any range is no joint."""


@dataclasses.dataclass(frozen=True)
class PlanBounds:
    """Limits of all plans.

    Attributes:
        bodies: largest number of bodies.
        half: smallest and largest half extent before the volume is limited, m.
        volume: largest volume of all bodies, m^3.
        turns: largest yaw, pitch and roll of a child from the surface normal, rad.
        angles: largest joint angles about x, y and z, rad.
        overlap: depth to which boxes may overlap, m. All may overlap if it is above all extents.
    """

    bodies: int = 20
    half: tuple[float, float] = (0.03, 0.3)
    volume: float = 0.1
    turns: tuple[float, float, float] = (math.pi / 3, math.pi / 3, math.pi / 2)
    angles: tuple[float, float, float] = (math.pi / 3, math.pi / 3, math.pi / 3)
    overlap: float = 0.01


class Plan(NamedTuple):
    """Bodies of a plan: each after its parent, subtrees contiguous (`walk_order`).

    The numbers of absent bodies are 0, their parent and slot are -1, their rotation is the
    identity, and their mirror is 1.

    Attributes:
        present: whether the body exists. Present bodies are first.
        parent: index of the parent, or -1 for the root.
        half: half extents, m. The body is longest along x only by chance.
        place: joint on the parent's surface in the parent's frame, m. The root has zeros.
        rotation: matrix from the body's frame to the parent's in the neutral pose.
        mirror: -1 for a mirrored body, otherwise 1.
        axes: whether the joint turns about the body's x, y and z axis.
        limit: largest joint angle about x, y and z in both directions, rad. It is 0 if the joint
            does not turn about the axis.
        strength: strength of the joint's motor, as a fraction of the strongest.
        label: label of the body's node.
        copy: number of earlier bodies with the same label.
        eye: whether the body has an eye.
        control: genes of the controller for each axis.
        slot: place in memory of a body with several children (`walk_order`), otherwise -1.
    """

    present: Bool[Array, " b"]
    parent: Int[Array, " b"]
    half: Float[Array, "b 3"]
    place: Float[Array, "b 3"]
    rotation: Float[Array, "b 3 3"]
    mirror: Float[Array, " b"]
    axes: Bool[Array, "b 3"]
    limit: Float[Array, "b 3"]
    strength: Float[Array, " b"]
    label: Int[Array, " b"]
    copy: Int[Array, " b"]
    eye: Bool[Array, " b"]
    control: Float[Array, "b 3 a"]
    slot: Int[Array, " b"]


def developed(graph: PlanGraph, layout: GraphLayout, bounds: PlanBounds) -> Plan:
    """Return the bodies that a graph grows into.

    Args:
        graph: graph with genes in their ranges. It need not be tidy. Genes are rounded to their
            steps.
        layout: sizes of the graph.
        bounds: limits of the plan.
    """
    growth = _grown(_rules(graph, bounds), layout, bounds)
    index = jnp.arange(bounds.bodies)
    present = index < growth.count
    order, slot = walk_order(jnp.where(present, growth.bodies.parent, -1))
    bodies = jax.tree.map(lambda x: x[..., order], growth.bodies)
    parent = jnp.where(index == 0, -1, jnp.argsort(order)[bodies.parent])
    half, place, rotation = _geometry(graph, bodies, parent, present, bounds)
    node = bodies.node
    kind = jnp.clip(jnp.round(graph.kind[node]), 0, len(JOINT_AXES) - 1).astype(int)
    axes = jnp.asarray(JOINT_AXES)[kind] & (index > 0)[:, None]
    label = graph.label[node].astype(int)
    earlier = (label[:, None] == label[None]) & (index[None] < index[:, None])
    turning = LEAST_TURN + (1 - LEAST_TURN) * graph.limits
    plan = Plan(
        present,
        parent,
        half,
        place,
        rotation,
        mirror=bodies.mirror.astype(half.dtype),
        axes=axes,
        limit=jnp.where(axes, turning[node] * jnp.array(bounds.angles)[None], 0.0),
        strength=graph.strength[node],
        label=label,
        copy=earlier.sum(1),
        eye=graph.eye[node] > 0.5,
        control=graph.control[node],
        slot=slot,
    )
    shown = [present.reshape(-1, *(1,) * (x.ndim - 1)) for x in plan]
    absent = False, -1, 0, 0, jnp.eye(3)[None], 1, False, 0, 0, 0, 0, False, 0, -1
    return Plan(*map(jnp.where, shown, plan, absent))


def _geometry(
    graph: PlanGraph,
    bodies: "_Bodies",
    parent: Int[Array, " b"],
    present: Bool[Array, " b"],
    bounds: PlanBounds,
) -> tuple[Float[Array, "b 3"], Float[Array, "b 3"], Float[Array, "b 3 3"]]:
    """Return half extents, joint places (m) and rotations of bodies in their final order."""
    lengths = jnp.asarray(_lengths(bounds), float)[bodies.size]
    span = math.log(bounds.half[1] / bounds.half[0])
    change = jnp.exp(span * infinitesimal(graph.size.T)[:, bodies.node])
    # A sum of whole numbers below 2^24 is exact, so its order does not matter.
    unit = 2.0 ** math.ceil(math.log2(8 * bounds.half[1] ** 3 * bounds.bodies)) / 2**23
    x, y, z = 2 * lengths
    volumes = jnp.where(present, jnp.round(x * y * z / unit), 0.0)
    half = lengths * _shrunk(volumes.sum() * unit, bounds) * change
    sides = _sides(bodies.mirror)
    place, depth = _places(graph)
    moved = 128 * infinitesimal(jnp.moveaxis(graph.place, -1, 0))
    beyond = (moved * jnp.sign(place) * (jnp.abs(place) == depth[None])).sum(0)
    face = ((place + moved) / (depth + beyond)[None]).reshape(3, -1)[:, bodies.via]
    rotation = _rotations(graph, bounds, lambda x: jnp.asarray(x, float), _float_product)
    rotation = rotation.reshape(3, 3, -1)[..., bodies.via] * sides[:, None] * sides[None]
    root = jnp.arange(len(parent)) == 0
    place = jnp.where(root[None], 0.0, face * half[:, parent] * sides)
    rotation = jnp.where(root[None, None], jnp.eye(3)[..., None], rotation)
    return half.T, place.T, jnp.moveaxis(rotation, -1, 0)


def _shrunk(volume: Float[Array, ""], bounds: PlanBounds) -> Float[Array, ""]:
    """Return the largest factor on lengths, of a table, that reduces a volume enough.

    A cube root would round differently alone and in vectors.
    """
    most = 8 * bounds.half[1] ** 3 * bounds.bodies
    steps = 1 + max(math.ceil(math.log(most / bounds.volume) / 3 / _SHRINKING), 0)
    factors = np.exp(-_SHRINKING * np.arange(steps + 1))
    above = volume * jnp.asarray(factors**3, float) > bounds.volume
    return jnp.asarray(factors, float)[above.sum()]


class _Rules(NamedTuple):
    """A graph in whole numbers, with the components first and nodes or connections last."""

    used: Bool[Array, " k"]
    size: Int[Array, "3 k"]
    recursion: Int[Array, " k"]
    on: Bool[Array, "k c"]
    to: Int[Array, "k c"]
    terminal: Bool[Array, "k c"]
    copies: Int[Array, "k c"]
    enlarged: Int[Array, "k c"]
    face: Int[Array, "3 k c"]
    rotation: Int[Array, "3 3 k c"]


def _rules(graph: PlanGraph, bounds: PlanBounds) -> _Rules:
    steps, nodes = np.arange(-128, 129) / 128, len(graph.used)
    logs = steps * np.log(np.where(steps < 0, _SMALLER, _LARGER))
    logs = np.round(logs / np.log(bounds.half[1] / bounds.half[0]) * _SIZES)
    place, depth = _places(graph)
    size = jnp.clip(jnp.round(graph.size.T * 256), 0, 256).astype(int)
    return _Rules(
        used=(graph.used > 0.5) | (jnp.arange(nodes) == 0),
        size=size * (_SIZES // 256),
        recursion=jnp.clip(jnp.round(graph.recursion), 1, MOST_RECURSION).astype(int),
        on=graph.on > 0.5,
        to=jnp.clip(jnp.round(graph.to), 0, nodes - 1).astype(int),
        terminal=graph.terminal > 0.5,
        copies=1 + (graph.reflect > 0.5).astype(int),
        enlarged=jnp.asarray(logs, int)[_signed(graph.scale) + 128],
        face=place * _ONE // depth[None],
        rotation=_rotations(
            graph, bounds, lambda x: jnp.asarray(np.round(x * _ONE), int), _product
        ),
    )


def _signed(gene: Array) -> Int[Array, "..."]:
    """Return signed fractions as whole numbers from -128 to 128."""
    return jnp.clip(jnp.round(gene * 128), -128, 128).astype(int)


def _product(a: Array, b: Array) -> Array:
    """Return a product of which one factor is a multiple of 2^-15."""
    return (a * b + _ONE // 2) >> _BITS


def _float_product(a: Array, b: Array) -> Array:
    """Return a product of numbers up to 1, rounded so that sums of two products are exact.

    Otherwise the compiler may join a product and a sum, with another rounding.
    """
    steps = 2.0 ** (jnp.finfo(a.dtype).nmant - 1)
    return jnp.round(a * b * steps) / steps


def _lengths(bounds: PlanBounds) -> np.ndarray:
    """Return the half extent for each step of its logarithm, m."""
    low, high = bounds.half
    return low * (high / low) ** (np.arange(_SIZES + 1) / _SIZES)


def _places(graph: PlanGraph) -> tuple[Int[Array, "3 k c"], Int[Array, "k c"]]:
    """Return directions to the joints, and their largest components.

    A place at the centre has no direction. It becomes the middle of the front face.
    """
    place = jnp.moveaxis(_signed(graph.place), -1, 0)
    depth = jnp.abs(place).max(0)
    front = jnp.array([1, 0, 0])[:, None, None]
    return jnp.where((depth == 0)[None], front, place), jnp.maximum(depth, 1)


def _rotations(
    graph: PlanGraph,
    bounds: PlanBounds,
    table: Callable[[np.ndarray], Array],
    product: Callable[[Array, Array], Array],
) -> Array:
    """Return rotations from the child's frame to the parent's, without mirroring.

    The first column is the outward normal, turned by yaw about z, pitch about the new y, and roll
    about the new x. Without turns, the child keeps the parent's z axis on the front, back and
    sides, and its y axis elsewhere.
    """
    angles = np.array(bounds.turns)[:, None] * (np.arange(-128, 129) / 128)
    turn = jnp.moveaxis(_signed(graph.turn) + 128, -1, 0)
    (cz, cy, cx), (sz, sy, sx) = (
        [table(row)[gene] for row, gene in zip(f(angles), turn, strict=True)]
        for f in (np.cos, np.sin)
    )
    czsy, szsy = product(cz, sy), product(sz, sy)
    turned = [
        [product(cz, cy), product(czsy, sx) - product(sz, cx), product(czsy, cx) + product(sz, sx)],
        [product(sz, cy), product(szsy, sx) + product(cz, cx), product(szsy, cx) - product(cz, sx)],
        [-sy, product(cy, sx), product(cy, cx)],
    ]
    place, _ = _places(graph)
    axis = jnp.abs(place).argmax(0)
    x, y, z = jnp.where(axis[None] == jnp.arange(3)[:, None, None], jnp.sign(place), 0)
    upright = jnp.abs(z)
    frame = [[x, -y, -z], [y, x + upright, 0 * z], [z, 0 * z, 1 - upright]]
    return matmul(*(jnp.stack([*map(jnp.stack, each)]) for each in (frame, turned)))


class _Bodies(NamedTuple):
    """Bodies, with the bodies last. Centres and attitudes are in the root's frame."""

    node: Int[Array, " b"]
    parent: Int[Array, " b"]
    via: Int[Array, " b"]
    mirror: Int[Array, " b"]
    enlarged: Int[Array, " b"]
    occurred: Int[Array, "k b"]
    size: Int[Array, "3 b"]
    centre: Int[Array, "3 b"]
    attitude: Int[Array, "3 3 b"]


class _Growth(NamedTuple):
    """State of growth. Mirror images of a body are a group, which is contiguous.

    Attributes:
        bodies: bodies grown so far, then images that may yet grow.
        count: number of bodies grown.
        size: number of images in the group that begins at a body.
        first: first body of the group on which bodies grow now.
        member: number of its bodies on which the connection has been tried.
        link: connection that is tried.
        pending: images of the new group so far.
        clear: whether none of these images overlaps another body.
    """

    bodies: _Bodies
    count: Int[Array, ""]
    size: Int[Array, " b"]
    first: Int[Array, ""]
    member: Int[Array, ""]
    link: Int[Array, ""]
    pending: Int[Array, ""]
    clear: Bool[Array, ""]


def _grown(rules: _Rules, layout: GraphLayout, bounds: PlanBounds) -> _Growth:
    """Return the bodies after every connection of every body has been tried."""
    number = bounds.bodies
    none, zeros, ones = jnp.array(0), jnp.zeros(number, int), jnp.ones(number, int)
    bodies = _Bodies(
        node=zeros,
        parent=zeros.at[0].set(-1),
        via=zeros,
        mirror=ones,
        enlarged=zeros,
        occurred=jnp.zeros((layout.nodes, number), int).at[0, 0].set(1),
        size=jnp.broadcast_to(rules.size[:, :1], (3, number)),
        centre=jnp.zeros((3, number), int),
        attitude=jnp.zeros((3, 3, number), int).at[..., 0].set(_ONE * jnp.eye(3, dtype=int)),
    )
    start = _Growth(bodies, none + 1, ones, none, none, none, none, jnp.array(True))
    attempts = number * layout.connections
    return jax.lax.fori_loop(0, attempts, lambda _, growth: _tried(growth, rules, bounds), start)


def _tried(growth: _Growth, rules: _Rules, bounds: PlanBounds) -> _Growth:
    """Return the state after a connection has been tried on one body of a group."""
    index, own = jnp.arange(bounds.bodies), growth.first + growth.member
    parent = jax.tree.map(lambda x: x[..., own], growth.bodies)
    copies = rules.copies[parent.node, growth.link]
    begin = growth.count + growth.pending
    images = _images(parent, own, growth.link, rules, bounds)
    bodies = jax.tree.map(lambda new, old: _inserted(new, old, begin), images, growth.bodies)
    place = begin + jnp.arange(2)
    others = (index < begin + copies) & (index != own)
    pairs = others[None] & (index[None] != place[:, None]) & (jnp.arange(2) < copies)[:, None]
    clear = growth.clear & ~(pairs & _overlap(images, bodies, bounds)).any()
    # The members of a group have the same node and ancestors, so all or none may grow.
    total = growth.pending + copies
    last = growth.member + 1 == growth.size[growth.first]
    room = growth.count + total <= bounds.bodies
    grows = last & room & clear & _may_grow(parent, growth, rules)
    tried = last & (growth.link + 1 == rules.on.shape[1])
    return _Growth(
        bodies,
        count=growth.count + jnp.where(grows, total, 0),
        size=jnp.where(grows & (index == growth.count), total, growth.size),
        first=growth.first + jnp.where(tried, growth.size[growth.first], 0),
        member=jnp.where(last, 0, growth.member + 1),
        link=jnp.where(tried, 0, growth.link + last),
        pending=jnp.where(last, 0, total),
        clear=clear | last,
    )


def _inserted(new: Array, old: Array, begin: Array) -> Array:
    """Return arrays of bodies with two new bodies from an index on, if there is room."""
    index = jnp.arange(old.shape[-1]).reshape(*(1,) * (old.ndim - 1), -1)
    kept = jnp.where(index == begin + 1, new[..., 1:], old)
    return jnp.where(index == begin, new[..., :1], kept)


def _may_grow(parent: _Bodies, growth: _Growth, rules: _Rules) -> Bool[Array, ""]:
    """Return whether a connection exists and the recursion of its nodes allows it to grow."""
    node, link = parent.node, growth.link
    target = rules.to[node, link]
    exhausted = parent.occurred >= rules.recursion
    exists = rules.on[node, link] & rules.used[target] & (growth.first < growth.count)
    return exists & ~exhausted[target] & (~rules.terminal[node, link] | exhausted[node])


def _images(parent: _Bodies, own: Array, link: Array, rules: _Rules, bounds: PlanBounds) -> _Bodies:
    """Return the body that grows at a connection, then its mirrored copy."""
    node, two = parent.node, jnp.ones(2, int)
    target, units = rules.to[node, link], _units(bounds)
    mirror = parent.mirror * jnp.array([1, -1])
    enlarged = parent.enlarged + rules.enlarged[node, link]
    size = jnp.clip(rules.size[:, target] + enlarged, 0, _SIZES)
    place = _product(units[parent.size], rules.face[:, node, link])
    sides = _sides(mirror)
    rotation = rules.rotation[:, :, node, link][..., None] * sides[:, None] * sides[None]
    attitude = parent.attitude[..., None]
    offset = place[:, None] * sides + _product(units[size[0]], rotation[:, 0])
    occurred = parent.occurred + (jnp.arange(len(parent.occurred)) == target)
    return _Bodies(
        node=target * two,
        parent=own * two,
        via=(node * rules.on.shape[1] + link) * two,
        mirror=mirror,
        enlarged=enlarged * two,
        occurred=occurred[:, None] * two[None],
        size=size[:, None] * two[None],
        centre=parent.centre[:, None] + ((matvec(attitude, offset) + _ONE // 2) >> _BITS),
        attitude=(matmul(attitude, rotation) + _ONE // 2) >> _BITS,
    )


def _sides(mirror: Array) -> Array:
    """Return the diagonal of diag(1, mirror, 1)."""
    return jnp.stack([jnp.ones_like(mirror), mirror, jnp.ones_like(mirror)])


def _units(bounds: PlanBounds) -> Int[Array, " sizes"]:
    return jnp.asarray(np.round(_lengths(bounds) / bounds.half[1] * _LENGTH), int)


def _overlap(images: _Bodies, bodies: _Bodies, bounds: PlanBounds) -> Bool[Array, "2 b"]:
    """Return which boxes overlap by more than the allowed depth.

    Boxes that are smaller by half the depth on all sides meet unless one of 15 axes separates them
    (Gottschalk, Lin and Manocha 1996, "OBBTree").
    """
    units = _units(bounds) - round(bounds.overlap / 2 / bounds.half[1] * _LENGTH)
    a, b = units[images.size][..., None], units[bodies.size][:, None]
    attitude, other = images.attitude[..., None], bodies.attitude[:, :, None]
    cosines = (t_matmul(attitude, other) + _ONE // 2) >> _BITS
    # Boxes that are farther apart than 4 half extents on an axis are apart at this distance, too.
    # Products of whole numbers of 32 bits are then exact.
    apart = bodies.centre[:, None] - images.centre[..., None]
    apart = jnp.clip(apart, -4 * _LENGTH, 4 * _LENGTH)
    t = (matvec_t(attitude, apart) + _ONE // 2) >> _BITS
    size = jnp.abs(cosines) + _PARALLEL
    (a1, a2), (b1, b2), (t1, t2) = ([jnp.roll(x, -k, 0) for k in (1, 2)] for x in (a, b, t))
    (c1, c2), (rows1, rows2) = ([jnp.roll(x, -k, 0) for k in (1, 2)] for x in (cosines, size))
    columns1, columns2 = (jnp.roll(size, -k, 1) for k in (1, 2))
    faces = jnp.abs(t) * _ONE > a * _ONE + matvec(size, b)
    other_faces = jnp.abs(matvec_t(cosines, t)) > b * _ONE + matvec_t(size, a)
    reach = a1[:, None] * rows2 + a2[:, None] * rows1 + b1[None] * columns2 + b2[None] * columns1
    edges = jnp.abs(t2[:, None] * c1 - t1[:, None] * c2) > reach
    return ~(faces.any(0) | other_faces.any(0) | edges.any((0, 1)))
