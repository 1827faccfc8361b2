"""Development of a graph into bodies (Sims 1994, "Evolving virtual creatures", section 3).

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

Frames are at the centres of the boxes. Every body but the root has its joint at the centre of its
near end face, ``(-half_x, 0, 0)`` in its own frame. The root faces +x, and z is up.

Differs from Sims 1994: he lets parts overlap.
"""

import dataclasses
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from evo_cpg.creature.algebra.linear import matmul, matvec, matvec_t, t_matmul
from evo_cpg.creature.graph import JOINT_AXES, MOST_RECURSION, Graph, GraphLayout

# Largest factor by which a connection enlarges, and smallest by which it shrinks.
_LARGER, _SMALLER = 1.5, 0.5
# Added to direction cosines, so that a cross product of nearly parallel edges separates no boxes.
_PARALLEL = 1e-5


@dataclasses.dataclass(frozen=True)
class PlanBounds:
    """Limits of all plans.

    Attributes:
        bodies: largest number of bodies.
        half: smallest and largest half extent before the volume is limited, m.
        volume: largest volume of all bodies, m^3.
        turns: largest yaw, pitch and roll of a child from the surface normal, rad.
        angles: largest joint angles about x, y and z, rad.
        overlap: depth to which boxes may overlap, m. It is less than the smallest extent.
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


def developed(graph: Graph, layout: GraphLayout, bounds: PlanBounds) -> Plan:
    """Return the bodies that a graph grows into.

    Args:
        graph: graph with genes in their ranges. It need not be tidy. Genes are rounded to their
            steps.
        layout: sizes of the graph.
        bounds: limits of the plan.
    """
    grown = _grown(_rules(graph, bounds), layout, bounds)
    bodies, index = grown.bodies, jnp.arange(bounds.bodies)
    present = index < grown.count
    order, slot = walk_order(jnp.where(present & (index > 0), bodies.parent, -1))
    position = jnp.argsort(order)
    node = bodies.node[order]
    parent = jnp.where(index == 0, -1, position[bodies.parent[order]])
    volume = jnp.where(present, 8 * bodies.half.prod(0), 0.0).sum()
    shrink = _cube_root(jnp.minimum(bounds.volume / volume, 1))
    kind = jnp.clip(jnp.round(graph.kind[node]), 0, len(JOINT_AXES) - 1).astype(int)
    axes = jnp.asarray(JOINT_AXES)[kind] & (index > 0)[:, None]
    label = graph.label[node].astype(int)
    earlier = (label[:, None] == label[None]) & (index[None] < index[:, None])
    plan = Plan(
        present,
        parent,
        half=jnp.moveaxis(bodies.half, -1, 0)[order] * shrink,
        place=jnp.moveaxis(bodies.place, -1, 0)[order] * shrink,
        rotation=jnp.moveaxis(bodies.rotation, -1, 0)[order],
        mirror=bodies.mirror[order],
        axes=axes,
        limit=jnp.where(axes, graph.limits[node] * jnp.array(bounds.angles)[None], 0.0),
        strength=graph.strength[node],
        label=label,
        copy=earlier.sum(1),
        eye=graph.eye[node] > 0.5,
        control=graph.control[node],
        slot=slot,
    )
    return _without_absent(plan)


def _without_absent(plan: Plan) -> Plan:
    """Return a plan whose absent bodies have fixed numbers, so that equal plans are equal."""
    nothing = jax.tree.map(jnp.zeros_like, plan)
    nothing = nothing._replace(
        parent=nothing.parent - 1,
        slot=nothing.slot - 1,
        mirror=nothing.mirror + 1,
        rotation=jnp.broadcast_to(jnp.eye(3, dtype=plan.half.dtype)[None], plan.rotation.shape),
    )

    def choose(value: Array, other: Array) -> Array:
        mask = plan.present.reshape(-1, *(1,) * (value.ndim - 1))
        return jnp.where(mask, value, other)

    return jax.tree.map(choose, plan, nothing)


def _cube_root(fraction: Array) -> Array:
    """Return the cube root of a number from 1e-9 to 1 by Newton's method.

    Library functions round differently alone and in vectors, arithmetic does not.
    """
    root = jnp.ones_like(fraction)
    for _ in range(24):
        root = (2 * root + fraction / (root * root)) / 3
    return root


class _Rules(NamedTuple):
    """A graph in SI units, with the components first and nodes or connections last."""

    used: Bool[Array, " k"]
    half: Float[Array, "3 k"]
    recursion: Int[Array, " k"]
    on: Bool[Array, "k c"]
    to: Int[Array, "k c"]
    terminal: Bool[Array, "k c"]
    copies: Int[Array, "k c"]
    scale: Float[Array, "k c"]
    face: Float[Array, "3 k c"]
    rotation: Float[Array, "3 3 k c"]


def _rules(graph: Graph, bounds: PlanBounds) -> _Rules:
    """Return a graph in SI units. Tables replace exponentials and sines, as for `_cube_root`."""
    steps = np.arange(-128, 129) / 128
    low, high = bounds.half
    sizes = low * (high / low) ** (np.arange(257) / 256)
    scales = np.where(steps < 0, (1 / _SMALLER) ** steps, _LARGER**steps)
    angles = np.array(bounds.turns)[:, None] * steps
    turn = jnp.moveaxis(_signed(graph.turn), -1, 0)
    cos, sin = (jnp.stack([*map(_looked_up, f(angles), turn)]) for f in (np.cos, np.sin))
    place = jnp.moveaxis(_signed(graph.place), -1, 0) - 128.0
    depth = jnp.abs(place).max(0)
    # A place at the centre has no direction, so it becomes the middle of the front face.
    place = jnp.where((depth == 0)[None], jnp.array([1.0, 0, 0])[:, None, None], place)
    face = place / jnp.maximum(depth, 1)[None]
    nodes = len(graph.used)
    return _Rules(
        used=(graph.used > 0.5) | (jnp.arange(nodes) == 0),
        half=_looked_up(sizes, jnp.clip(jnp.round(graph.size * 256), 0, 256).astype(int)).T,
        recursion=jnp.clip(jnp.round(graph.recursion), 1, MOST_RECURSION).astype(int),
        on=graph.on > 0.5,
        to=jnp.clip(jnp.round(graph.to), 0, nodes - 1).astype(int),
        terminal=graph.terminal > 0.5,
        copies=1 + (graph.reflect > 0.5).astype(int),
        scale=_looked_up(scales, _signed(graph.scale)),
        face=face,
        rotation=matmul(_normal_frame(face), _turned(cos, sin)),
    )


def _signed(gene: Array) -> Int[Array, "..."]:
    return jnp.clip(jnp.round(gene * 128) + 128, 0, 256).astype(int)


def _looked_up(table: np.ndarray, index: Array) -> Array:
    return jnp.asarray(table, float)[index]


def _normal_frame(face: Float[Array, "3 k c"]) -> Float[Array, "3 3 k c"]:
    """Return rotations whose first column is the outward normal of the face that has a place.

    The child keeps the parent's z axis on the front, back and sides, and its y axis elsewhere.
    """
    axis = jnp.abs(face).argmax(0)
    sign = jnp.sign(jnp.take_along_axis(face, axis[None], 0))[0]
    one, none = jnp.ones_like(sign), jnp.zeros_like(sign)
    x, y, z = ((axis == i) * sign for i in range(3))
    level, upright = jnp.where(axis == 2, none, one), jnp.where(axis == 2, one, none)
    rows = [[x, -y, -z], [y, x + upright, none], [z, none, level]]
    return jnp.stack([jnp.stack(row) for row in rows])


def _turned(cos: Float[Array, "3 k c"], sin: Float[Array, "3 k c"]) -> Float[Array, "3 3 k c"]:
    """Return rotations by yaw about z, then pitch about the new y, then roll about the new x."""
    (cz, cy, cx), (sz, sy, sx) = cos, sin
    return jnp.stack(
        [
            jnp.stack([cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx]),
            jnp.stack([sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx]),
            jnp.stack([-sy, cy * sx, cy * cx]),
        ]
    )


class _Bodies(NamedTuple):
    """Bodies in the order of growth, with the bodies last. Centre and attitude are the root's."""

    node: Int[Array, " b"]
    parent: Int[Array, " b"]
    mirror: Float[Array, " b"]
    scale: Float[Array, " b"]
    occurred: Int[Array, "k b"]
    half: Float[Array, "3 b"]
    place: Float[Array, "3 b"]
    rotation: Float[Array, "3 3 b"]
    centre: Float[Array, "3 b"]
    attitude: Float[Array, "3 3 b"]


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
        refused: number of groups refused because of an overlap.
    """

    bodies: _Bodies
    count: Int[Array, ""]
    size: Int[Array, " b"]
    first: Int[Array, ""]
    member: Int[Array, ""]
    link: Int[Array, ""]
    pending: Int[Array, ""]
    clear: Bool[Array, ""]
    refused: Int[Array, ""]


def _grown(rules: _Rules, layout: GraphLayout, bounds: PlanBounds) -> _Growth:
    """Return the bodies after every connection of every body has been tried."""
    number, nodes = bounds.bodies, layout.nodes
    zero = jnp.zeros((3, number))
    first = (jnp.arange(number) == 0)[None]
    straight = jnp.where(first[None], jnp.eye(3)[..., None], 0.0)
    bodies = _Bodies(
        node=jnp.zeros(number, int),
        parent=jnp.zeros(number, int),
        mirror=jnp.ones(number),
        scale=jnp.ones(number),
        occurred=(first & (jnp.arange(nodes) == 0)[:, None]).astype(int),
        half=jnp.where(first, rules.half[:, :1], zero),
        place=zero,
        rotation=straight,
        centre=zero,
        attitude=straight,
    )
    none, all_clear = jnp.array(0), jnp.array(True)
    size = jnp.ones(number, int)
    start = _Growth(bodies, none + 1, size, none, none, none, none, all_clear, none)
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
    may = last & _may_grow(parent, growth, rules) & (growth.count + total <= bounds.bodies)
    grows, tried = may & clear, last & (growth.link + 1 == rules.on.shape[1])
    return _Growth(
        bodies,
        count=growth.count + jnp.where(grows, total, 0),
        size=jnp.where(grows & (index == growth.count), total, growth.size),
        first=growth.first + jnp.where(tried, growth.size[growth.first], 0),
        member=jnp.where(last, 0, growth.member + 1),
        link=jnp.where(tried, 0, growth.link + last),
        pending=jnp.where(last, 0, total),
        clear=clear | last,
        refused=growth.refused + (may & ~clear),
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
    target = rules.to[parent.node, link]
    mirror = parent.mirror * jnp.array([1.0, -1.0])
    sides = jnp.stack([jnp.ones_like(mirror), mirror, jnp.ones_like(mirror)])
    scale = parent.scale * rules.scale[parent.node, link]
    half = jnp.clip(rules.half[:, target] * scale, *bounds.half)[:, None]
    place = (parent.half * rules.face[:, parent.node, link])[:, None] * sides
    rotation = rules.rotation[:, :, parent.node, link][..., None] * sides[:, None] * sides[None]
    attitude = parent.attitude[..., None]
    offset = place + rotation[:, 0] * half[:1]
    occurred = parent.occurred + (jnp.arange(len(parent.occurred)) == target)
    return _Bodies(
        node=jnp.stack([target] * 2),
        parent=jnp.stack([own] * 2),
        mirror=mirror,
        scale=jnp.stack([scale] * 2),
        occurred=jnp.stack([occurred] * 2, -1),
        half=jnp.concatenate([half] * 2, -1),
        place=place,
        rotation=rotation,
        centre=parent.centre[:, None] + matvec(attitude, offset),
        attitude=matmul(attitude, rotation),
    )


def _overlap(images: _Bodies, bodies: _Bodies, bounds: PlanBounds) -> Bool[Array, "2 b"]:
    """Return which boxes overlap by more than the allowed depth.

    Boxes that are smaller by half the depth on all sides meet unless one of 15 axes separates them
    (Gottschalk, Lin and Manocha 1996, "OBBTree").
    """
    a, b = ((x - bounds.overlap / 2) for x in (images.half[..., None], bodies.half[:, None]))
    cosines = t_matmul(images.attitude[..., None], bodies.attitude[:, :, None])
    apart = bodies.centre[:, None] - images.centre[..., None]
    t = matvec_t(images.attitude[..., None], apart)
    size = jnp.abs(cosines) + _PARALLEL
    (a1, a2), (b1, b2), (t1, t2) = ((jnp.roll(x, -k, 0) for k in (1, 2)) for x in (a, b, t))
    (c1, c2), (rows1, rows2) = ([jnp.roll(x, -k, 0) for k in (1, 2)] for x in (cosines, size))
    columns1, columns2 = (jnp.roll(size, -k, 1) for k in (1, 2))
    faces = jnp.abs(t) > a + matvec(size, b)
    other_faces = jnp.abs(matvec_t(cosines, t)) > b + matvec_t(size, a)
    reach = a1[:, None] * rows2 + a2[:, None] * rows1 + b1[None] * columns2 + b2[None] * columns1
    edges = jnp.abs(t2[:, None] * c1 - t1[:, None] * c2) > reach
    return ~(faces.any(0) | other_faces.any(0) | edges.any((0, 1)))


def walk_order(parent: Int[Array, " b"]) -> tuple[Int[Array, " b"], Int[Array, " b"]]:
    """Return the order in which bodies are walked, and the slots of bodies in that order.

    The order is preorder. Among the children of a body, the one with the largest subtree is last,
    and the others precede it by falling size. A walk keeps values of bodies with several children
    in slots until their last child. The order needs few slots (Sethi and Ullman 1970, "The
    generation of optimal code for arithmetic expressions"): 3 for up to 30 bodies.

    Args:
        parent: index of each body's parent, which precedes the body. It is -1 for the root, which
            is body 0, and for absent bodies.

    Returns:
        The indices of the bodies in the order of the walk, with absent bodies last. Then, in that
        order, the slot of each body with several children, otherwise -1.
    """
    number = len(parent)
    index = jnp.arange(number)
    child = parent[None] == index[:, None]  # of a body (row)
    below = _descendants(parent)
    size = below.sum(1)
    before = (size[:, None] > size[None]) | (
        (size[:, None] == size[None]) & (index[:, None] < index[None])
    )
    siblings = (parent[:, None] == parent[None]) & (parent >= 0)[None]
    last = (parent >= 0) & ~(siblings & before).any(0)
    before = siblings & ((before & ~last[:, None]) | (last[None] & ~last[:, None]))
    offset = jnp.where(parent >= 0, 1 + (before * size[:, None]).sum(0), 0)
    absent = (parent < 0) & (index > 0)
    position = jnp.where(absent, number + index, (below * offset[:, None]).sum(0))
    order = jnp.argsort(position)
    return order, _slots(child, last)[order]


def _descendants(parent: Int[Array, " b"]) -> Bool[Array, "b b"]:
    """Return whether a body (column) is another one (row) or hangs on it."""
    index = jnp.arange(len(parent))

    def add(body: Array, below: Array) -> Array:
        above = below[:, parent[body]] & (parent[body] >= 0)
        return jnp.where((index == body)[None], above[:, None] | (index == body)[:, None], below)

    return jax.lax.fori_loop(0, len(parent), add, jnp.zeros((len(parent),) * 2, bool))


def _slots(child: Bool[Array, "b b"], last: Bool[Array, " b"]) -> Int[Array, " b"]:
    """Return the slot of each body with several children, otherwise -1."""
    number = len(last)

    def add(i: Array, state: tuple[Array, Array]) -> tuple[Array, Array]:
        needed, slots = state
        own, body = child[number - 1 - i], jnp.arange(number) == number - 1 - i
        slot = jnp.where(own & ~last, needed, 0).max()
        after = jnp.where(own & last, needed, 0).max()
        several = own.sum() > 1
        count = jnp.where(several, jnp.maximum(after, slot + 1), after)
        return jnp.where(body, count, needed), jnp.where(body & several, slot, slots)

    none = jnp.zeros(number, int)
    return jax.lax.fori_loop(0, number, add, (none, none - 1))[1]
