"""Random, mutated, crossed and grafted body plans: valid, connected, and with their labels."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import quick_jit
from evo_cpg.creature.development import PlanBounds, developed
from evo_cpg.creature.graph import FRACTIONS, LINKS, SIGNED, GraphLayout, PlanGraph, tidy
from evo_cpg.evolution.graphs import crossed, grafted, mutated, random_graph

LAYOUT = GraphLayout()
COUNT = 1000
SOURCES = "random", "mutated", "crossed", "grafted"

mutate = quick_jit(jax.vmap(lambda key, one, rate: mutated(key, one, LAYOUT, rate), (0, 0, None)))
draw = quick_jit(jax.vmap(lambda key: random_graph(key, LAYOUT)))
as_vectors = quick_jit(jax.vmap(LAYOUT.pack, out_axes=-1))
as_plans, as_bytes, from_bytes = map(quick_jit, (LAYOUT.unpack, LAYOUT.as_bytes, LAYOUT.from_bytes))
develop = quick_jit(jax.vmap(lambda graph: developed(graph, LAYOUT, PlanBounds())))
tidied = quick_jit(jax.vmap(tidy))


def keys(seed: int) -> jax.Array:
    return jax.random.split(jax.random.key(seed), COUNT)


def bodies(plans: PlanGraph) -> np.ndarray:
    return np.asarray(develop(plans).present.sum(1))


@pytest.fixture(scope="module")
def plans() -> dict[str, PlanGraph]:
    """Return plans of each source. Those of the same index are children of the same parents."""
    random, other = draw(keys(0)), draw(keys(1))
    cross, graft = (quick_jit(jax.vmap(each)) for each in (crossed, grafted))
    found = {
        "random": random,
        "other": other,
        "mutated": mutate(keys(2), random, 4.0),
        "crossed": cross(keys(3), random, other),
        "grafted": graft(keys(4), random, other),
    }
    return {name: jax.tree.map(np.asarray, plan) for name, plan in found.items()}


def reached(plan: PlanGraph, start: np.ndarray) -> np.ndarray:
    """Return which nodes (plan, node) a path from a node reaches."""
    arrows = np.zeros((len(plan.used), LAYOUT.nodes, LAYOUT.nodes), bool)
    i, node, link = np.nonzero(plan.on)
    arrows[i, node, plan.to[i, node, link].astype(int)] = True
    found = np.arange(LAYOUT.nodes)[None] == start[:, None]
    for _ in range(LAYOUT.nodes):
        found |= (found[:, :, None] & arrows).any(1)
    return found


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.slow
def test_the_root_reaches_every_node(plans, source):
    plan = plans[source]
    assert (plan.on[:, 0].sum(-1) >= 1).all()
    used = plan.used > 0
    assert used[:, 0].all()
    targets = np.take_along_axis(used, plan.to.reshape(COUNT, -1).astype(int), 1)
    assert targets.reshape(plan.on.shape)[plan.on > 0].all()
    np.testing.assert_array_equal(reached(plan, np.zeros(COUNT, int)), used)


@pytest.mark.parametrize("source", SOURCES)
def test_unused_genes_are_zero_in_tidy_plans(plans, source):
    plan = plans[source]
    for name, value in plan._asdict().items():
        mask = plan.on if name in LINKS else plan.used
        assert not value[mask == 0].any()
    for value, again in zip(plan, tidied(plan), strict=True):
        np.testing.assert_array_equal(value, again)


@pytest.mark.parametrize("source", SOURCES)
def test_vectors_and_bytes_hold_the_plan(plans, source):
    plan = plans[source]
    vectors = as_vectors(plan)
    assert vectors.shape == (LAYOUT.count, COUNT)
    for value, again in zip(plan, as_plans(vectors), strict=True):
        np.testing.assert_array_equal(value, np.moveaxis(np.asarray(again), -1, 0))
    stored = as_bytes(vectors)
    assert stored.dtype == np.uint8 and len(stored) == LAYOUT.count + 2 * LAYOUT.nodes
    np.testing.assert_array_equal(from_bytes(stored), vectors)
    np.testing.assert_array_equal(as_bytes(vectors[:, 0]), stored[:, 0])


@pytest.mark.parametrize("source", SOURCES)
def test_genes_stay_in_their_ranges(plans, source):
    plan = plans[source]._asdict()
    used = plan["used"] > 0
    for name in FRACTIONS:
        assert plan[name].min() >= 0 and plan[name].max() < 1
    for name in SIGNED:
        assert np.abs(plan[name]).max() < 1
    assert set(np.unique(plan["kind"][used])) == set(LAYOUT.kinds)
    assert set(np.unique(plan["recursion"][used])) == {1, 2, 3, 4}
    assert plan["label"][used].min() >= 1 and plan["label"].max() < 2**24


def test_mutation_keeps_labels_and_adds_nodes(plans):
    one, child = plans["random"], plans["mutated"]
    kept = (one.used > 0) & (child.used > 0)
    np.testing.assert_array_equal(one.label[kept], child.label[kept])
    added = ((one.used == 0) & (child.used > 0)).sum(1)
    assert added.max() == 1 and 0.05 < added.mean() < 0.5
    assert ((one.used > 0) & (child.used == 0)).any()


@pytest.mark.parametrize("rate", [1.0, 4.0])
@pytest.mark.parametrize("large", [False, True])
def test_mutation_rate_is_the_mean_of_alterations(plans, rate, large):
    one = plans["random"]
    links, most = LAYOUT.nodes * LAYOUT.connections, LAYOUT.nodes
    nodes = one.used.sum(1)
    chosen = (nodes == most if large else nodes <= 3) & (one.on.sum((1, 2)) < links)
    child = jax.tree.map(np.asarray, mutate(keys(5), jax.tree.map(jnp.asarray, one), rate))
    both = ((one.used > 0) & (child.used > 0)).astype(bool)
    stay = both[..., None] & (one.on > 0) & (child.on > 0)
    counts = (both[..., None] & (one.on != child.on)).sum((1, 2))
    for name, value in child._asdict().items():
        mask = stay if name in LINKS else both
        changed = (value != getattr(one, name)).reshape(*mask.shape, -1).sum(-1)
        counts = counts + np.where(mask, changed, 0).sum(tuple(range(1, mask.ndim)))
    mean = counts[chosen].mean()
    # Genes of removed nodes are not counted, and the root keeps its last connection.
    assert 0.75 * rate < mean < 1.1 * rate


def test_crossed_plans_switch_parents_at_most_twice(plans):
    one, other, child = plans["random"], plans["other"], plans["crossed"]
    used = child.used > 0
    from_one, from_other = (used & (child.label == parent.label) for parent in (one, other))
    np.testing.assert_array_equal(from_one ^ from_other, used)
    assert from_one[:, 0].all()
    for name in set(PlanGraph._fields) - set(LINKS):
        for parent, mask in ((one, from_one), (other, from_other)):
            value = getattr(parent, name)[mask]
            np.testing.assert_array_equal(getattr(child, name)[mask], value)
    sequences = [from_other[i, used[i]].astype(int) for i in range(COUNT)]
    switches = np.array([np.abs(np.diff(each)).sum() for each in sequences])
    assert set(switches) == {0, 1, 2}
    # Pointers stay unless they would lead to nothing.
    to = np.where(from_other[..., None], other.to, one.to).astype(int)
    valid = np.take_along_axis(used, to.reshape(COUNT, -1), 1).reshape(to.shape)
    np.testing.assert_array_equal(child.to[valid & (child.on > 0)], to[valid & (child.on > 0)])


def test_grafts_bring_all_that_a_node_reaches(plans):
    one, other, child = plans["random"], plans["other"], plans["grafted"]
    used = child.used > 0
    grafts = used & (child.label[:, :, None] == other.label[:, None]).any(-1)
    full = (one.used.sum(1) == LAYOUT.nodes) & ~grafts.any(1)
    for value, parent in zip(child, one, strict=True):
        np.testing.assert_array_equal(value[full], parent[full])
    assert full.mean() < 0.5
    whole = 0
    for i in np.flatnonzero(~full):
        places = np.flatnonzero(grafts[i])
        origin = [np.flatnonzero(other.label[i] == child.label[i, place])[0] for place in places]
        for name in set(PlanGraph._fields) - set(LINKS):
            value = getattr(other, name)[i, origin]
            np.testing.assert_array_equal(getattr(child, name)[i, places], value)
        # One connection of the first parent leads to the graft.
        into = np.isin(child.to[i], places) & (child.on[i] > 0) & ~grafts[i][:, None]
        assert into.sum() == 1
        top = origin[list(places).index(int(child.to[i][into][0]))]
        parent = jax.tree.map(lambda x, i=i: x[i : i + 1], other)
        needed = set(np.flatnonzero(reached(parent, np.array([top]))[0]))
        assert needed >= set(origin)
        assert needed == set(origin) or used[i].all()
        whole += needed == set(origin)
    assert whole > 0.3 * (~full).sum()


@pytest.mark.slow
def test_random_plans_have_all_sizes():
    sizes = bodies(draw(keys(6)))
    counts = np.bincount(sizes, minlength=21)
    assert counts[2:].all() and counts[:2].sum() < 0.01 * COUNT
    assert 7 <= np.median(sizes) <= 11 and counts[20] < 0.25 * COUNT


@pytest.mark.slow
def test_mutation_alone_hardly_changes_mean_size():
    first = last = draw(keys(6))
    for generation in range(10):
        last = mutate(keys(100 + generation), last, 6.0)
    assert 0.75 < bodies(last).mean() / bodies(first).mean() < 1.25
