"""Slender chains: bodies joined end to end, such as a trunk with its tail, or a leg.

The laws of water need the outline of a whole chain. Its length sets the flow around each of its
bodies, and the distance from its nose sets the boundary layer.

Two bodies are linked if the joint lies between them: the direction from one centre to the joint and
on to the other centre turns by at most 45 degrees, and if neither body is four times as wide as the
other. A thin fin at the end may be wider, such as a caudal fin behind a peduncle: a body with one
joint whose thickness is at most a quarter of its width. A body has at most two links, on opposite
sides. Of several candidates it takes those whose widths are most alike its own. So a trunk
continues in its tail and not in a fin. Equally alike candidates on the same side, such as the two
lobes of a fluke, are a fork, which ends the chain. Every body belongs to exactly one chain, which
may have one body only. A further part of a body is a chain of its own.

The nose is the end that points forward, along +x. In a chain that stands across, such as a leg, it
is the end nearer to the root.

The drag of a body depends on the shape of its whole chain, which `ChainOutline` describes along the
centreline and along two axes across it that all bodies of the chain share in the neutral pose.
"""

import itertools
from collections import Counter
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from evo_cpg.creature.algebra.decisions import Condition, all_hold, chosen
from evo_cpg.creature.algebra.numerics import Number, Numbers, xp
from evo_cpg.creature.creature import Creature, joint_places, neutral_pose, topological_order
from evo_cpg.creature.shapes import Shape

# Cosine of the largest turn at a link, and largest cosine between the two links of a body.
_STRAIGHT, _OPPOSITE = 0.7, -0.5

# Largest ratio of the widths of linked bodies, unless the wider one is a thin fin at the end.
_SIMILAR = 4.0

# Least ratio of width to thickness of a thin fin, as for its lift (`evo_cpg.physics.water.lift`).
_THIN = 4.0

# Ratio of the likeness of two candidates above which they count as equally alike.
_EQUALLY = 0.99

# Least length of a centreline, m. A body without size has no direction.
_LEAST_LENGTH = 1e-12

# Least number of bodies of a chain that bends as a wave. One or two rigid bodies cannot.
LEAST_BODIES = 3

# Volume over that of the bounding box, up to which a shape counts as round (a cylinder), and from
# which it is a box.
_ROUND_FILL, _BOX_FILL = 0.25 * np.pi, 1.0

# Least length, so that a body without size has an outline, m.
_TINY = 1e-9

# Cosine of the largest angle between a chain and +x at which its front end is the nose.
_FORWARD = 0.5


# Two bodies that a joint links, by their indices.
_Link = frozenset[int]


class SlenderChain(NamedTuple):
    """Bodies joined end to end, from the nose to the tail.

    Attributes:
        bodies: indices of the bodies in ``creature.bodies``.
        front: front end of each body's centreline, in the body's geometric frame, m.
        rear: rear end of each body's centreline, in the body's geometric frame, m.
    """

    bodies: tuple[int, ...]
    front: Float[Numbers, "n 3"]
    rear: Float[Numbers, "n 3"]

    @property
    def lengths(self) -> Float[Numbers, " n"]:
        """Length of each body's centreline, m."""
        return xp.linalg.norm(self.front - self.rear, axis=-1)

    @property
    def tangents(self) -> Float[Numbers, "n 3"]:
        """Unit vector along each body's centreline towards the nose, in the body's frame."""
        return (self.front - self.rear) / xp.maximum(self.lengths, _LEAST_LENGTH)[:, None]


class ChainOutline(NamedTuple):
    """Outline of a chain of bodies.

    Attributes:
        chain: the bodies, from the nose to the tail.
        axes: axes of the outline in each body's frame, as columns. The first is the principal axis
            along the centreline.
        halves: half sizes of each body along its axes, m.
        lengths: length of each body along the chain, m.
        sizes: length of the chain and its mean widths along the other axes, m.
        volume: volume of the bodies, m^3.
        sharpness: 1 for boxes, 0 for shapes that fill no more of their bounding box than a
            cylinder.
        blunt: whether each body is a cylinder with flat ends.
        bluntness: fraction of the length in cylinders with their axis along each axis of the
            outline, or None without cylinders.
    """

    chain: SlenderChain
    axes: Float[np.ndarray, "n 3 3"]
    halves: Float[Numbers, "n 3"]
    lengths: Float[Numbers, " n"]
    sizes: Float[Numbers, " 3"]
    volume: Number
    sharpness: Number
    blunt: tuple[bool, ...]
    bluntness: Float[Numbers, " 3"] | None


def slender_chains(creature: Creature) -> tuple[SlenderChain, ...]:
    """Return the chains of a creature, which contain each body once."""
    pose = neutral_pose(creature)
    places = {frozenset(pair): place for pair, place in joint_places(creature, pose).items()}

    def choose() -> tuple[tuple[int, ...], ...]:
        # Paths from either end, in the order of their least bodies.
        beside: dict[int, list[int]] = {i: [] for i in range(len(creature.bodies))}
        for link in _links(creature, pose, places):
            for body in link:
                beside[body] += link - {body}
        paths, seen = [], set()
        for start, near in beside.items():
            if start in seen or len(near) > 1:
                continue
            path = [start]
            while following := [body for body in beside[path[-1]] if body not in path]:
                path.append(following[0])
            seen.update(path)
            paths.append(tuple(path))
        centres, found = pose[0], []
        for bodies in sorted(paths, key=min):
            backwards = False
            if len(bodies) > 1:
                direction = _unit(centres[bodies[0]] - centres[bodies[-1]])
                backwards = direction[0] <= 0
                if abs(direction[0]) <= _FORWARD:
                    order = topological_order(creature)
                    backwards = order.index(bodies[0]) >= order.index(bodies[-1])
            found.append(bodies[::-1] if backwards else bodies)
        return tuple(found)

    def still(chains: tuple[tuple[int, ...], ...]) -> Condition:
        made = [frozenset(pair) for bodies in chains for pair in itertools.pairwise(bodies)]
        return all_hold(_turn(pose, link, places[link]) > _STRAIGHT - 0.2 for link in made)

    chains = chosen(choose, still)
    return tuple(_chain(creature, pose, places, tuple(bodies)) for bodies in chains)


def _unit(vector: Numbers) -> Numbers:
    return vector / xp.maximum(xp.linalg.norm(vector), 1e-12)


def _turn(pose: tuple[Numbers, Numbers], link: _Link, place: Numbers) -> Number:
    """Return the cosine of the turn between the two halves of the way from centre to centre."""
    one, two = (pose[0][body] for body in link)
    return _unit(place - one) @ _unit(two - place)


def _links(
    creature: Creature, pose: tuple[np.ndarray, np.ndarray], places: dict[_Link, np.ndarray]
) -> list[_Link]:
    """Return the joints that continue a chain."""
    centres, rotations = pose
    count = Counter(body for link in places for body in link)
    extents: dict[_Link, list[tuple[float, float, bool]]] = {}
    straight = []
    for link, place in places.items():
        extents[link] = []
        for body in link:
            # Width and thickness across the direction to the joint, and whether the body is an end.
            half, axes = (np.asarray(x, float) for x in creature.bodies[body].shape.stretch)
            direction = rotations[body].T @ _unit(place - centres[body])
            across = axes - np.outer(direction, direction @ axes)
            _, thickness, width = np.sort(2 * np.linalg.norm(across, axis=0) * half).tolist()
            extents[link].append((width, thickness, count[body] == 1))
        (narrow, _, _), (wide, thickness, end) = sorted(extents[link])
        fits = wide < _SIMILAR * narrow or (end and narrow > 0 and wide >= _THIN * thickness)
        if fits and _turn(pose, link, place) > _STRAIGHT:
            straight.append(link)
    widths = {link: [width for width, _, _ in each] for link, each in extents.items()}

    kept: list[set[_Link]] = []
    for body, centre in enumerate(centres):
        toward = {link: _unit(places[link] - centre) for link in straight if body in link}
        alike = {link: min(widths[link]) / max(widths[link]) for link in toward}
        pairs = list(itertools.combinations(toward, 2))
        opposite = [pair for pair in pairs if np.dot(*(toward[x] for x in pair)) < _OPPOSITE]
        forked = {
            link
            for pair in pairs
            if pair not in opposite
            and min(alike[x] for x in pair) > _EQUALLY * max(alike[x] for x in pair)
            for link in pair
        }
        choices = [*((link,) for link in toward), *opposite]
        single = [links for links in choices if not forked.intersection(links)]
        # Squares, so that one like body counts more than two half as wide.
        best = max(single, key=lambda links: sum(alike[x] ** 2 for x in links), default=())
        kept.append(set(best))
    return [link for link in straight if all(link in kept[body] for body in link)]


def _chain(
    creature: Creature,
    pose: tuple[Numbers, Numbers],
    at: dict[_Link, Numbers],
    bodies: tuple[int, ...],
) -> SlenderChain:
    centres, rotations = pose
    shapes = [creature.bodies[body].shape for body in bodies]
    if len(bodies) == 1:
        half, axes = shapes[0].stretch
        longest = chosen(lambda: int(np.argmax(half)), lambda k: half[k] >= xp.max(half))
        front = axes[:, longest] * xp.max(half)
        return SlenderChain(bodies, front[None], -front[None])
    places = [at[frozenset(pair)] for pair in itertools.pairwise(bodies)]
    front, rear = [], []
    for k, (body, shape) in enumerate(zip(bodies, shapes, strict=True)):
        ends = [
            rotations[body].T @ (places[j] - centres[body]) if 0 <= j < len(places) else None
            for j in (k - 1, k)
        ]
        known = next(end for end in ends if end is not None)
        # The free end lies on the line from the joint through the centre. A body without size has
        # no such line.
        size = xp.linalg.norm(known)
        outward = xp.where(size > _LEAST_LENGTH, -_unit(known), np.array([1.0, 0.0, 0.0]))
        free = outward * (outward @ shape.support(outward))
        front.append(free if ends[0] is None else ends[0])
        rear.append(free if ends[1] is None else ends[1])
    return SlenderChain(bodies, xp.stack(front), xp.stack(rear))


def chain_outline(creature: Creature, chain: SlenderChain) -> ChainOutline:
    """Return the outline of a chain of a creature."""
    shapes = [creature.bodies[body].shape for body in chain.bodies]
    axes = chosen(lambda: _axes(creature, chain, shapes), lambda _: True)
    halves = xp.array(
        [
            [0.5 * axis @ (shape.support(axis) - shape.support(-axis)) for axis in own.T]
            for shape, own in zip(shapes, axes, strict=True)
        ]
    )
    if len(shapes) == 1:
        lengths, sizes = 2 * halves[:, 0], 2 * halves[0]
    else:
        lengths = chain.lengths
        total = xp.maximum(lengths.sum(), _TINY)
        across = 2 * (lengths[:, None] * halves[:, 1:]).sum(0) / total
        sizes = xp.array([total, across[0], across[1]])
    volumes = xp.array([shape.volume for shape in shapes])
    fill = volumes / (8 * xp.maximum(xp.prod(halves, 1), _TINY**3))
    boxy = xp.clip((fill - _ROUND_FILL) / (_BOX_FILL - _ROUND_FILL), 0.0, 1.0)
    sharpness = (lengths * boxy).sum() / xp.maximum(lengths.sum(), _TINY)
    sizes, bluntness = xp.maximum(sizes, _TINY), None
    blunt = tuple(shape.blunt for shape in shapes)
    if any(blunt):
        parts = xp.maximum(halves[:, 0], _TINY)
        along = np.square(axes[:, 0]) * np.array(blunt)[:, None]
        bluntness = parts @ along / parts.sum()
    fullness = volumes.sum(), sharpness, blunt, bluntness
    return ChainOutline(chain, axes, halves, lengths, sizes, *fullness)


def _axes(creature: Creature, chain: SlenderChain, shapes: list[Shape]) -> np.ndarray:
    """Return the principal axes of each body in the order of the outline's axes."""
    _, rotations = neutral_pose(creature)
    ordered = []
    for body, shape, tangent in zip(chain.bodies, shapes, chain.tangents, strict=True):
        _, axes = shape.stretch
        first = int(np.argmax(np.abs(tangent @ axes)))
        second, third = ((first + 1) % 3, (first + 2) % 3)
        if ordered:
            shared = rotations[chain.bodies[0]] @ ordered[0][:, 1]
            along = np.abs(shared @ rotations[body] @ axes)
            if along[third] > along[second]:
                second, third = third, second
        ordered.append(axes[:, [first, second, third]])
    return np.stack(ordered)
