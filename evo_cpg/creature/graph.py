"""Body plan as a genome: a directed graph of parts (Sims 1994, "Evolving virtual creatures").

A *node* of the graph describes a part, and a *connection* a place where a part grows. Several
connections may point to one node, so that a node may appear as several bodies. A cycle makes a
chain of bodies. `evo_cpg.creature.development` turns a graph into bodies, and
`evo_cpg.evolution.graphs` draws, mutates and crosses graphs.

A graph is also a vector of numbers, as every genome. Each number is stored exactly in one byte, and
a label in three:

====================  =============================  =======================
genes                 values                         multiples of
====================  =============================  =======================
flags, choices        whole numbers                  1
label                 whole numbers below 2^24       1
fractions             0 <= gene < 1                  1/256
signed fractions      -1 < gene < 1                  1/128
====================  =============================  =======================
"""

import dataclasses
from math import prod
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, UInt8

FRACTIONS = ("size", "limits", "strength")
SIGNED = ("control", "place", "turn", "scale")
LINKS = ("on", "to", "place", "turn", "scale", "reflect", "terminal")
"""Names of the genes of connections. The other genes belong to nodes."""

MOST_RECURSION = 4

LABELS = 2**24
"""Labels are smaller, so that float32 holds them exactly."""

JOINT_AXES = np.array([[0, 0, 1], [0, 1, 0], [0, 1, 1], [1, 1, 1]], bool)
"""Axes (x, y, z) of each kind of joint: hinge about z, hinge about y, universal, ball."""

# Components of the genes that have several.
_COMPONENTS = {"size": (3,), "limits": (3,), "place": (3,), "turn": (3,)}


class PlanGraph(NamedTuple):
    """Genes of a body plan, for ``k`` nodes with ``c`` connections each. All are floats.

    Attributes:
        used: whether the node is a part. Node 0 is the root part and always used.
        label: number that identifies the node from the mutation that created it on.
        size: logarithm of each half extent (x, y, z), as a fraction of the allowed range.
        kind: joint to the parent, an index of `JOINT_AXES`.
        limits: largest joint angle about x, y and z, from the least to the largest allowed angle.
        strength: strength of the joint's motor, as a fraction of the strongest.
        recursion: how often the node may occur on a path from the root, from 1 to 4.
        eye: whether the part has an eye.
        control: free genes of the controller for each axis of the joint.
        on: whether the connection exists.
        to: node of the part that grows at the connection.
        place: direction from the parent's centre to the joint on its surface, in its frame.
        turn: yaw, pitch and roll from the surface normal, as fractions of the largest turns.
        scale: factor on the sizes of the part and of what grows on it. It is 2^scale if scale is
            negative, otherwise 1.5^scale, so that 0 keeps the size.
        reflect: whether a mirrored copy grows, too.
        terminal: whether the connection grows only where the recursion of its node is exhausted.
    """

    used: Float[Array, "k *n"]
    label: Float[Array, "k *n"]
    size: Float[Array, "k 3 *n"]
    kind: Float[Array, "k *n"]
    limits: Float[Array, "k 3 *n"]
    strength: Float[Array, "k *n"]
    recursion: Float[Array, "k *n"]
    eye: Float[Array, "k *n"]
    control: Float[Array, "k 3 a *n"]
    on: Float[Array, "k c *n"]
    to: Float[Array, "k c *n"]
    place: Float[Array, "k c 3 *n"]
    turn: Float[Array, "k c 3 *n"]
    scale: Float[Array, "k c *n"]
    reflect: Float[Array, "k c *n"]
    terminal: Float[Array, "k c *n"]


@dataclasses.dataclass(frozen=True)
class GraphLayout:
    """Sizes of a graph, and its order in a vector: by name of the gene, then by node.

    Attributes:
        nodes: largest number of nodes.
        connections: largest number of connections of a node.
        control: number of control genes for each axis of a joint.
        centre: middle of random control genes of an axis.
        spread: range of random control genes, as a fraction of their whole range.
        kinds: allowed kinds of joints, indices of `JOINT_AXES`.
    """

    nodes: int = 6
    connections: int = 3
    control: int = 5
    centre: tuple[float, ...] = ()
    spread: float = 1.0
    kinds: tuple[int, ...] = (0, 1, 2, 3)

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of each field of a graph, by name."""
        components = {**_COMPONENTS, "control": (3, self.control)}
        owners = {name: (self.nodes, self.connections)[: 1 + (name in LINKS)] for name in _NAMES}
        return {name: owners[name] + components.get(name, ()) for name in _NAMES}

    @property
    def count(self) -> int:
        """Number of genes."""
        return sum(map(prod, self.shapes.values()))

    def pack(self, graph: PlanGraph) -> Float[Array, "g *n"]:
        """Return the genes as a vector."""
        shapes = self.shapes.values()
        parts = [x.reshape(prod(s), *x.shape[len(s) :]) for x, s in zip(graph, shapes, strict=True)]
        return jnp.concatenate(parts)

    def unpack(self, genes: Float[Any, "g *n"]) -> PlanGraph:
        """Return the graph of a vector."""
        shapes = self.shapes.values()
        ends = np.cumsum([prod(shape) for shape in shapes])[:-1]
        parts = zip(jnp.split(jnp.asarray(genes), ends), shapes, strict=True)
        return PlanGraph(*(part.reshape(*shape, *genes.shape[1:]) for part, shape in parts))

    def as_bytes(self, genes: Float[Any, "g *n"]) -> UInt8[Array, "b *n"]:
        """Return the genes as bytes, three for a label and one for any other number."""
        graph = self.unpack(genes)._asdict()
        whole = [jnp.round(_in_steps(name, value)).astype(int) for name, value in graph.items()]
        label = whole[_LABEL]
        whole[_LABEL] = jnp.concatenate([label // 2**16, label // 2**8 % 2**8, label % 2**8])
        return jnp.concatenate([x.reshape(-1, *genes.shape[1:]) for x in whole]).astype(jnp.uint8)

    def nearest(self, genes: Float[Any, "g *n"]) -> Float[Array, "g *n"]:
        """Return the nearest genes in their ranges and steps."""
        found = self.unpack(genes)._asdict()
        for name in (*FRACTIONS, *SIGNED):
            least, steps = int(name in SIGNED), jnp.round(_in_steps(name, found[name]))
            found[name] = _from_steps(name, jnp.clip(steps, least, 255))
        return self.pack(PlanGraph(**found))

    def from_bytes(self, stored: UInt8[Any, "b *n"]) -> Float[Array, "g *n"]:
        """Return the genes of `as_bytes`."""
        k = self.nodes
        high, middle, low = (stored[k * i : k * (i + 1)].astype(int) for i in (1, 2, 3))
        label = high * 2**16 + middle * 2**8 + low
        steps = jnp.concatenate([stored[:k].astype(int), label, stored[4 * k :].astype(int)])
        graph = self.unpack(steps.astype(float))._asdict()
        found = PlanGraph(**{name: _from_steps(name, x) for name, x in graph.items()})
        return self.pack(found)


def infinitesimal(gene: Any) -> Array:
    """Return 0 with the derivative of a gene, for genes that are rounded."""
    return gene - jax.lax.stop_gradient(gene)


_NAMES = PlanGraph._fields
_LABEL = _NAMES.index("label")


def _in_steps(name: str, value: Array) -> Array:
    """Return genes as whole numbers, which are 128 for a signed fraction of 0."""
    if name in SIGNED:
        return value * 128 + 128
    return value * 256 if name in FRACTIONS else value


def _from_steps(name: str, steps: Array) -> Array:
    """Return the inverse of `_in_steps`."""
    if name in SIGNED:
        return (steps - 128) / 128
    return steps / 256 if name in FRACTIONS else steps


def arrows(graph: PlanGraph) -> Bool[Array, "k c k"]:
    """Return which node each connection points to, if it exists and joins used nodes."""
    nodes = jnp.arange(len(graph.used))
    target = graph.to[..., None].astype(int) == nodes[None, None]
    used = graph.used > 0
    return target & (graph.on > 0)[..., None] & used[:, None, None] & used[None, None]


def distances(graph: PlanGraph, start: Any) -> Float[Array, " k"]:
    """Return the number of connections from a node to each node, or ``k`` if there is no path."""
    nodes = len(graph.used)
    follows = arrows(graph).any(1)
    steps = jnp.where(jnp.arange(nodes) == start, 0.0, nodes)
    for _ in range(nodes - 1):
        steps = jnp.minimum(steps, jnp.where(follows, steps[:, None] + 1, nodes).min(0))
    return steps


def by_owner(graph: PlanGraph, nodes: Bool[Array, " k"], links: Bool[Array, "k c"]) -> PlanGraph:
    """Return a mask for each gene: that of the gene's node, or of its connection."""
    owners = [links if name in LINKS else nodes for name in _NAMES]
    pairs = zip(owners, graph, strict=True)
    masks = (mask.reshape(*mask.shape, *(1,) * (x.ndim - mask.ndim)) for mask, x in pairs)
    return PlanGraph(*map(jnp.broadcast_to, masks, map(jnp.shape, graph)))


def tidy(graph: PlanGraph) -> PlanGraph:
    """Remove nodes that no path from the root reaches, and connections to them.

    All genes of what is removed become 0, so that equal plans are equal vectors. The other nodes
    keep their places, so that relatives still correspond node by node.
    """
    used = distances(graph, 0) < len(graph.used)
    graph = graph._replace(used=used.astype(graph.used.dtype))
    masks = by_owner(graph, used, arrows(graph).any(-1))
    return jax.tree.map(lambda mask, x: jnp.where(mask, x, 0), masks, graph)
