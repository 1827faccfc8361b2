"""Random, mutated, crossed and grafted body plans (Sims 1994, "Evolving virtual creatures").

The functions take one plan, and `jax.vmap` applies them to a population. Every result is tidy: its
genes are multiples of their steps, its connections point to used nodes, and its root has one.
"""

from typing import Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from evo_cpg.creature.graph import (
    FRACTIONS,
    LABELS,
    MOST_RECURSION,
    SIGNED,
    GraphLayout,
    PlanGraph,
    by_owner,
    distances,
    tidy,
)

# Fractions of the alterations that add a connection and that remove one. More are added, because a
# removal takes all nodes behind it along. So mutation alone hardly changes the mean number of
# bodies. Other alterations change a gene.
_ADDED, _REMOVED = 0.12, 0.06
# Standard deviation of a change, as a fraction of the gene's range.
_CHANGE = 0.1
# Probability that a pointer which moves, or a new connection, leads to the new node.
_TO_NEW = 0.5
# Exponent of a uniform number, below 1 so that random plans of many nodes are more frequent.
_FEW = 0.5
# Probabilities of random connections beyond the first to each node, and of flags.
_MORE, _FLAGS = 0.4, {"reflect": 0.6, "terminal": 0.1, "eye": 0.2}
# Largest random sizes across a part, and random turns, as fractions of their ranges.
_THIN, _TURN = 0.4, 0.5


def random_graph(key: Array, layout: GraphLayout) -> PlanGraph:
    """Return a random plan of 1 to ``layout.nodes`` nodes.

    A random tree of connections reaches all nodes, and further connections are random. Only the
    latter may be terminal, so that every node grows. A plan of one node is a chain, because its
    root grows on itself.
    """
    gene_key, count_key, tree_key, more_key, to_key = jax.random.split(key, 5)
    graph = _drawn(gene_key, layout)
    number = 1 + jnp.floor(layout.nodes * jax.random.uniform(count_key) ** _FEW).astype(int)
    on, to = _random_tree(tree_key, number, layout)
    used = jnp.arange(layout.nodes) < number
    more = jax.random.bernoulli(more_key, _MORE, on.shape) & used[:, None]
    to = jnp.where(on, to, jax.random.randint(to_key, on.shape, 0, number))
    longer = jnp.maximum(graph.recursion, jnp.where(number == 1, 2, 1))
    ends = jnp.where(on, 0, graph.terminal)
    plan = {"used": used, "on": on | more, "to": to, "terminal": ends, "recursion": longer}
    return tidy(graph._replace(**{name: value.astype(float) for name, value in plan.items()}))


def _random_tree(
    key: Array, number: Int[Array, ""], layout: GraphLayout
) -> tuple[Bool[Array, "k c"], Int[Array, "k c"]]:
    """Return connections to each node from a random earlier one, and from a lone root to itself."""
    shape = layout.nodes, layout.connections
    node, link = jnp.arange(shape[0]), jnp.arange(shape[1])
    on, to = jnp.zeros(shape, bool), jnp.zeros(shape, int)
    for new, new_key in enumerate(jax.random.split(key, shape[0])[1:], start=1):
        taken = on.sum(1)
        parent = _random_choice(new_key, (node < new) & (taken < shape[1]))
        here = (node == parent)[:, None] & (link == taken[parent])[None] & (new < number)
        on, to = on | here, jnp.where(here, new, to)
    return on.at[0, 0].set(True), to


def _random_choice(key: Array, allowed: Bool[Array, "*rest k"]) -> Int[Array, "*rest"]:
    """Return a random index along the last axis among the allowed ones, or 0 if there is none."""
    scores = jax.random.uniform(key, allowed.shape)
    return jnp.where(allowed, scores, -1).argmax(-1)


def descended(key: Array, ancestor: PlanGraph, layout: GraphLayout, rate: float) -> PlanGraph:
    """Return a plan of an ancestor's body with random oscillators and few alterations.

    The mean number of alterations is random, from 0 to ``rate``.
    """
    gene_key, rate_key, alter_key = jax.random.split(key, 3)
    own_rate = rate * jax.random.uniform(rate_key)
    return mutated(alter_key, with_random_brain(gene_key, ancestor, layout), layout, own_rate)


def with_random_brain(key: Array, graph: PlanGraph, layout: GraphLayout) -> PlanGraph:
    """Return the plan of the same body with random control genes."""
    used = graph.used[:, None, None] > 0
    return graph._replace(control=jnp.where(used, _drawn(key, layout).control, 0.0))


def _drawn(key: Array, layout: GraphLayout) -> PlanGraph:
    """Return random genes of all nodes and connections.

    The parts are slender and little turned. Pairs are on the left and right side, and other parts
    of a limb on its far half, because most would otherwise overlap another part and not grow.
    """
    uniform, factor = _uniform(key, layout), _uniform(jax.random.fold_in(key, 1), layout)
    uniform["size"] *= jnp.array([1, _THIN, _THIN])[None]
    factor |= {"control": layout.spread, "place": 1.0, "turn": _TURN * factor["turn"]}
    genes = {name: jnp.zeros(shape) for name, shape in layout.shapes.items()}
    for name in FRACTIONS:
        genes[name] = jnp.floor(256 * uniform[name]) / 256
    for name in SIGNED:
        genes[name] = jnp.round((jnp.floor(255 * uniform[name]) - 127) * factor[name]) / 128
    if layout.centre:
        genes["control"] += jnp.round(128 * jnp.array(layout.centre)) / 128
    for name, probability in _FLAGS.items():
        genes[name] = (uniform[name] < probability).astype(float)
    x, y, z = jnp.unstack(genes["place"], axis=-1)
    side = jnp.where(y < 0, -127 / 128, 127 / 128)
    limb = (jnp.arange(layout.nodes) > 0)[:, None]
    places = jnp.where(limb, jnp.abs(x), x), jnp.where(genes["reflect"] > 0, side, y), z
    genes["place"] = jnp.stack(places, -1)
    genes["recursion"] = 1 + jnp.floor(MOST_RECURSION * uniform["recursion"] ** 2)
    kinds = jnp.array(layout.kinds, float)
    genes["kind"] = kinds[jnp.floor(len(kinds) * uniform["kind"]).astype(int)]
    genes["label"] = 1 + jnp.floor((LABELS - 1) * uniform["label"])
    return PlanGraph(**genes)


def _uniform(key: Array, layout: GraphLayout) -> dict[str, Array]:
    """Return a uniform random number for each gene, in one draw because draws compile slowly."""
    return layout.unpack(jax.random.uniform(key, (layout.count,)))._asdict()


Altered = Literal["all", "body", "brain"]
"""Genes that mutations change."""


def mutated(
    key: Array, graph: PlanGraph, layout: GraphLayout, rate: Array | float, altered: Altered = "all"
) -> PlanGraph:
    """Return a plan with random alterations, as Sims mutates directed graphs.

    An alteration changes a gene of a node or connection, moves the pointer of a connection, adds a
    connection or removes one. Real genes change by normal random numbers, and choices get another
    value. A pointer that moves, or a new connection, may lead to a new random node. Nodes that no
    path from the root reaches are then removed.

    Differs from Sims 1994: half of these pointers lead to the new node, because few new nodes would
    stay otherwise. The root keeps its last connection.

    Args:
        key: random key.
        graph: tidy plan.
        layout: sizes of the plan.
        rate: mean number of alterations, for plans of all sizes.
        altered: genes that change. Those of the brain are the ``control`` genes.
    """
    gene_key, new_key, to_key, on_key = jax.random.split(key, 4)
    used, on = graph.used > 0, graph.on > 0
    new = (jnp.arange(len(used)) == jnp.argmin(used)) & ~used
    added, removed = _switched(on_key, used, on, 0.0 if altered == "brain" else rate)
    fresh = _drawn(new_key, layout)
    targets = _redirected(to_key, graph.to, used, new).astype(float)
    fresh = fresh._replace(used=jnp.ones_like(fresh.used), on=jnp.ones_like(fresh.on), to=targets)
    graph = _altered(gene_key, graph, by_owner(graph, used, on), targets, layout, rate, altered)
    graph = jax.tree.map(jnp.where, by_owner(graph, new, added), fresh, graph)
    return tidy(graph._replace(on=jnp.where(removed, 0.0, graph.on)))


def _switched(
    key: Array, used: Bool[Array, " k"], on: Bool[Array, "k c"], rate: Array | float
) -> tuple[Bool[Array, "k c"], Bool[Array, "k c"]]:
    """Return which connections a mutation adds, and which it removes."""
    add_key, remove_key = jax.random.split(key)
    off = used[:, None] & ~on
    added = jax.random.uniform(add_key, on.shape) * off.sum() < rate * _ADDED
    removed = jax.random.uniform(remove_key, on.shape) * on.sum() < rate * _REMOVED
    added, removed = added & off, removed & on
    left = (on & ~removed)[0].any()
    return added, removed.at[0].set(removed[0] & left)


def _redirected(
    key: Array, to: Float[Array, "k c"], used: Bool[Array, " k"], new: Bool[Array, " k"]
) -> Int[Array, "k c"]:
    """Return another target for each pointer: a used node or the new node."""
    choice_key, new_key = jax.random.split(key)
    others = used[None, None] & (to[..., None] != jnp.arange(len(used))[None, None])
    to_new = (jax.random.uniform(new_key, to.shape) < _TO_NEW) | ~others.any(-1)
    return jnp.where(to_new & new.any(), jnp.argmax(new), _random_choice(choice_key, others))


def _altered(
    key: Array,
    graph: PlanGraph,
    in_use: PlanGraph,
    targets: Float[Array, "k c"],
    layout: GraphLayout,
    rate: Array | float,
    altered: Altered,
) -> PlanGraph:
    """Return a graph in which some genes in use have other values."""
    hit_key, choice_key, normal_key = jax.random.split(key, 3)
    chance, choice = _uniform(hit_key, layout), _uniform(choice_key, layout)
    normal = layout.unpack(jax.random.normal(normal_key, (layout.count,)))._asdict()
    genes, masks = graph._asdict(), in_use._asdict()
    brain, fixed = {"control"}, {"used", "label", "on"}
    kept = {"all": fixed, "body": fixed | brain, "brain": genes.keys() - brain}[altered]
    names = [name for name in genes if name not in kept]
    choices = {"kind": layout.kinds, "recursion": tuple(range(1, MOST_RECURSION + 1))}
    sites = sum(masks[name].sum() for name in names)
    probability = rate * (1 - _ADDED - _REMOVED) / sites
    for name in names:
        value = targets if name == "to" else _moved(name, genes[name], normal[name])
        if name in choices:
            value = _another(genes[name], choice[name], choices[name])
        hit = masks[name] & (chance[name] < probability)
        genes[name] = jnp.where(hit, value, genes[name])
    return PlanGraph(**genes)


def _another(value: Array, choice: Array, allowed: tuple[int, ...]) -> Array:
    """Return another allowed value than the old one, by a uniform random number."""
    values = jnp.array(allowed, float)
    skip = 1 + jnp.floor(choice * (len(allowed) - 1))
    index = jnp.argmax(value[..., None] == values[None], axis=-1)
    return values[(index + skip.astype(int)) % len(allowed)]


def _moved(name: str, value: Array, normal: Array) -> Array:
    """Return a flag's opposite, or a real gene after a normal change of at least one step.

    The gene's range reflects a change that would leave it.
    """
    if name not in SIGNED + FRACTIONS:
        return 1 - value
    low, step = (-127 / 128, 1 / 128) if name in SIGNED else (0.0, 1 / 256)
    change = jnp.sign(normal) * jnp.maximum(jnp.ceil(jnp.abs(normal) * 256 * _CHANGE), 1)
    other, high = low + jnp.abs(value + change * step - low), 1 - step
    return jnp.clip(high - jnp.abs(high - other), low, high)


def crossed(key: Array, one: PlanGraph, other: PlanGraph) -> PlanGraph:
    """Return a plan whose nodes are from one parent, then from the other, as Sims crosses graphs.

    Half of the children switch back at a second crossover point. A pointer leads to the node at the
    same place as before, or to a random node if that place is empty. The root is from ``one``.
    """
    start_key, end_key, twice_key, to_key = jax.random.split(key, 4)
    node = jnp.arange(len(one.used))
    last = jnp.where((one.used > 0) | (other.used > 0), node, 0).max()
    start = jax.random.randint(start_key, (), 1, jnp.maximum(last, 1) + 1)
    back = jax.random.randint(end_key, (), start + 1, jnp.maximum(last + 1, start + 1) + 1)
    end = jnp.where(jax.random.bernoulli(twice_key), back, len(node))
    mask = (node >= start) & (node < end)
    masks = by_owner(one, mask, jnp.broadcast_to(mask[:, None], one.on.shape))
    child = jax.tree.map(jnp.where, masks, other, one)
    used = child.used > 0
    drawn = _random_choice(to_key, jnp.broadcast_to(used[None, None], (*one.to.shape, len(node))))
    to = jnp.where(used[child.to.astype(int)], child.to, drawn.astype(float))
    return tidy(child._replace(to=to))


def grafted(key: Array, one: PlanGraph, other: PlanGraph) -> PlanGraph:
    """Return one parent with a part of the other, as Sims grafts graphs.

    A random connection of ``one`` leads to a random node of ``other``. This node and all that it
    reaches are copied to the free places, the nearest first, as many as fit. Places are free if no
    path that avoids the connection reaches them. Without a free place, ``one`` stays as it is.
    """
    link_key, node_key = jax.random.split(key)
    chosen = _random_choice(link_key, (one.on > 0).ravel())
    here = (jnp.arange(one.on.size) == chosen).reshape(one.on.shape)
    start = _random_choice(node_key, other.used > 0)
    nodes = len(one.used)
    free = distances(one._replace(on=jnp.where(here, 0.0, one.on)), 0) == nodes
    steps = distances(other, start)
    nearest, places = jnp.argsort(steps), jnp.argsort(~free)
    # The r-th nearest node of `other` moves to the r-th free place.
    source = nearest[jnp.maximum(jnp.cumsum(free) - 1, 0)]
    rank = jnp.argsort(nearest)
    to = other.to.astype(int)
    moved = other._replace(
        to=places[rank][to].astype(float), on=jnp.where(rank[to] < free.sum(), other.on, 0.0)
    )
    moved = jax.tree.map(lambda x: x[source], moved)
    taken = free & (steps[source] < nodes)
    masks = by_owner(one, taken, jnp.broadcast_to(taken[:, None], one.on.shape))
    child = jax.tree.map(jnp.where, masks, moved, one)
    child = child._replace(to=jnp.where(here & free.any(), places[0].astype(float), child.to))
    return tidy(child)
