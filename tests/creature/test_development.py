"""Development of graphs into bodies: Sims's examples, mirror images, overlaps and the walk."""

import dataclasses
import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import jit_as_for_users, quick_jit
from evo_cpg.creature.development import Plan, PlanBounds, developed
from evo_cpg.creature.graph import GraphLayout, PlanGraph
from evo_cpg.creature.walk import walk_order
from evo_cpg.evolution.graphs import mutated, random_graph
from plans import plan_graph

LAYOUT = GraphLayout(control=2)
BOUNDS = PlanBounds(volume=10.0)
# Nothing overlaps by more than this, so that all grows.
FREE = dataclasses.replace(BOUNDS, overlap=2.0)
MIRROR = np.diag([1.0, -1, 1])
COUNT = 256


def develop(bounds: PlanBounds):
    return _develop(bounds, jax.config.jax_enable_x64)


@functools.cache
def _develop(bounds: PlanBounds, _precise: bool):
    return quick_jit(jax.vmap(lambda graph: developed(graph, LAYOUT, bounds)))


def as_numpy(plan) -> Plan:
    return jax.tree.map(np.asarray, plan)


def one_of(plans, index: int):
    return jax.tree.map(lambda x: x[index], plans)


def random_graphs(seed: int) -> PlanGraph:
    """Return random plans, of which half are mutated."""
    keys = jax.random.split(jax.random.key(seed), COUNT)
    return _draw(jax.config.jax_enable_x64)(keys)


@functools.cache
def _draw(_precise: bool):
    def draw(key):
        graph = random_graph(key, LAYOUT)
        return mutated(key, graph, LAYOUT, jnp.where(jax.random.bernoulli(key), 5.0, 0.0))

    return quick_jit(jax.vmap(draw))


graph_of = functools.partial(plan_graph, LAYOUT)


def grown(graph: PlanGraph) -> Plan:
    plan = as_numpy(develop(BOUNDS)(jax.tree.map(lambda x: x[None], graph)))
    return one_of(plan, 0)


def poses(plan: Plan) -> tuple[np.ndarray, np.ndarray]:
    """Return centres (body, 3) and attitudes (body, 3, 3) in the root's frame."""
    centres, attitudes = np.zeros_like(plan.place), np.array(plan.rotation)
    for i in range(1, plan.present.sum()):
        parent = plan.parent[i]
        ahead = plan.place[i] + plan.rotation[i, :, 0] * plan.half[i, 0]
        attitudes[i] = attitudes[parent] @ plan.rotation[i]
        centres[i] = centres[parent] + attitudes[parent] @ ahead
    return centres, attitudes


@pytest.mark.slow
def test_recursion_grows_a_straight_snake():
    plan = grown(graph_of([{"recursion": 4}], [(0, {"to": 0})]))
    length = 2 * plan.half[0, 0]
    centres, _ = poses(plan)
    np.testing.assert_allclose(centres[:4, 0], length * np.arange(4), rtol=1e-6)
    np.testing.assert_array_equal(plan.present, np.arange(20) < 4)
    np.testing.assert_array_equal(plan.parent[:5], [-1, 0, 1, 2, -1])
    np.testing.assert_array_equal(plan.copy[:4], range(4))


def test_a_terminal_part_ends_the_chain():
    links = [(0, {"to": 1, "terminal": 1}), (0, {"to": 0})]
    plan = grown(graph_of([{"recursion": 3}, {}], links))
    np.testing.assert_array_equal(plan.label[:5], [1, 1, 1, 2, 0])
    np.testing.assert_array_equal(plan.parent[:4], [-1, 0, 1, 2])


def test_reflected_legs_make_a_quadruped():
    side = {"to": 1, "reflect": 1}
    links = [(0, side | {"place": (x, 0.9, 0.0)}) for x in (0.75, -0.75)]
    links = [*links, (1, {"to": 2})]
    nodes = [{"size": (0.875, 0.25, 0.25)}, {"size": (0.5, 0, 0), "kind": 2}, {"size": (0.5, 0, 0)}]
    plan = grown(graph_of(nodes, links))
    assert plan.present.sum() == 9
    centres, _ = poses(plan)
    feet = centres[:9][plan.label[:9] == 3]
    front, side = 0.75 / 0.9 * plan.half[0, 0], plan.half[0, 1] + 3 * plan.half[1, 0]
    np.testing.assert_allclose(np.abs(feet), [[front, side, 0]] * 4, rtol=2e-3, atol=1e-6)
    assert len({tuple(np.sign(foot[:2])) for foot in feet}) == 4
    np.testing.assert_array_equal(plan.mirror[:9], np.sign(centres[:9, 1] + 1e-6))
    np.testing.assert_array_equal(plan.axes[1], [False, True, True])


def test_scale_shrinks_all_that_follows():
    chain = graph_of([{"recursion": 4, "size": 0.75}], [(0, {"to": 0, "scale": -0.5})])
    half = grown(chain).half[:4]
    low, high = BOUNDS.half
    expected = low * (high / low) ** 0.75 * 0.5 ** (0.5 * np.arange(4))
    np.testing.assert_allclose(half, np.maximum(expected, low)[:, None] * np.ones(3), rtol=3e-3)


def reference(graph: PlanGraph, bodies: int) -> list[tuple[int, int, int]]:
    """Return parent, node and mirror of all bodies, if none is refused for an overlap."""
    grown, paths, queue = [(-1, 0, 1)], [(0,)], [[0]]
    for group in queue:
        for link in range(LAYOUT.connections):
            node = grown[group[0]][1]
            target, path = int(graph.to[node, link]), paths[group[0]]
            exhausted = path.count(node) >= graph.recursion[node]
            follows = path.count(target) < graph.recursion[target]
            if not graph.on[node, link] or not follows or graph.terminal[node, link] > exhausted:
                continue
            images = (1, -1) if graph.reflect[node, link] else (1,)
            new = [(own, target, grown[own][2] * image) for own in group for image in images]
            if len(grown) + len(new) <= bodies:
                queue.append([*range(len(grown), len(grown) + len(new))])
                grown, paths = grown + new, paths + [(*path, target)] * len(new)
    return grown


@pytest.mark.slow
def test_growth_follows_the_rules_of_connections():
    graphs = random_graphs(0)
    plans, graphs = as_numpy(develop(FREE)(graphs)), jax.tree.map(np.asarray, graphs)
    for i in range(COUNT):
        graph, plan = one_of(graphs, i), one_of(plans, i)
        expected = reference(graph, BOUNDS.bodies)
        names = [graph.label[node] for _, node, _ in expected]
        parents = [names[parent] if parent >= 0 else -1 for parent, _, _ in expected]
        number = plan.present.sum()
        above = np.where(plan.parent >= 0, plan.label[plan.parent], -1)[:number]
        found = zip(above, plan.label[:number], plan.mirror[:number], strict=True)
        mirrors = [mirror for _, _, mirror in expected]
        assert sorted(found) == sorted(zip(parents, names, mirrors, strict=True))
        same = plan.label[:, None] == plan.label[None]
        np.testing.assert_array_equal(plan.copy[:number], np.tril(same, -1).sum(1)[:number])


@pytest.mark.usefixtures("x64")
@pytest.mark.slow
def test_pairs_on_the_root_are_mirror_images():
    plans = as_numpy(develop(BOUNDS)(random_graphs(1)))
    pairs = 0
    for i in range(COUNT):
        plan = one_of(plans, i)
        centres, attitudes = poses(plan)
        edges = [*np.flatnonzero(plan.parent == 0), plan.present.sum()]
        limbs = [slice(*each) for each in itertools.pairwise(edges)]
        for one in limbs:
            if plan.mirror[one.start] > 0:
                continue
            same = [np.allclose(plan.place[x.start], MIRROR @ plan.place[one.start]) for x in limbs]
            same = [other for other, found in zip(limbs, same, strict=True) if found]
            other = next(x for x in same if plan.mirror[x.start] > 0)
            pairs += 1
            np.testing.assert_allclose(centres[one], centres[other] @ MIRROR, atol=1e-12)
            turned = MIRROR @ attitudes[other] @ MIRROR
            np.testing.assert_allclose(attitudes[one], turned, atol=1e-12)
            np.testing.assert_array_equal(plan.half[one], plan.half[other])
            np.testing.assert_array_equal(plan.mirror[one], -plan.mirror[other])
            np.testing.assert_array_equal(plan.label[one], plan.label[other])
    assert pairs > COUNT / 2


@pytest.fixture(scope="module")
def plans() -> Plan:
    return as_numpy(develop(BOUNDS)(random_graphs(2)))


@pytest.mark.slow
def test_joints_are_on_surfaces_and_normals(plans):
    child = np.nonzero(plans.parent >= 0)
    half = plans.half[child[0], plans.parent[child]]
    face = plans.place[child] / half
    np.testing.assert_allclose(np.abs(face).max(1), 1, rtol=1e-6)
    rotation = plans.rotation[child]
    np.testing.assert_allclose(rotation @ rotation.mT, np.eye(3)[None] + 0 * rotation, atol=2e-6)
    np.testing.assert_allclose(np.linalg.det(rotation), 1, atol=2e-6)
    # Yaw and pitch are at most 60 degrees, so the part points outward on one of the faces.
    outward = np.where(np.abs(face) > 1 - 1e-6, np.sign(face) * rotation[:, :, 0], -1).max(1)
    assert outward.min() > 0.25 - 1e-6


def test_limits_belong_to_axes_that_turn(plans):
    assert not plans.axes[:, 0].any()
    np.testing.assert_array_equal(plans.limit[~plans.axes], 0)
    assert plans.limit.max() <= BOUNDS.angles[0] and plans.limit[plans.axes].mean() > 0.4


@pytest.mark.slow
def test_all_lengths_shrink_to_the_volume():
    graphs = random_graphs(2)
    large = as_numpy(develop(BOUNDS)(graphs))
    small = as_numpy(develop(dataclasses.replace(BOUNDS, volume=0.01))(graphs))
    before, after = ((8 * plan.half.prod(-1)).sum(1) for plan in (large, small))
    assert after.max() <= 0.01 * (1 + 1e-4)
    too_large = before > 0.01
    assert after[too_large].min() > 0.99 * 0.01 and too_large.any() and not too_large.all()
    np.testing.assert_array_equal(small.half[~too_large], large.half[~too_large])
    factor = np.cbrt(after / before)[:, None, None]
    np.testing.assert_allclose(small.half, large.half * factor, rtol=1e-4)
    np.testing.assert_allclose(small.place, large.place * factor, rtol=1e-4, atol=1e-9)


def separated_or_meeting(one: list, other: list) -> tuple[np.ndarray, np.ndarray]:
    """Return which boxes a plane separates, and which have a common point.

    Boxes are lists of centres, attitudes and half extents. Projections onto two convex bodies in
    turn converge to nearest points (Cheney and Goldstein 1959, "Proximity maps for convex sets").
    Their difference is normal to a plane that separates the boxes.
    """

    def nearest(point, box):
        centre, attitude, half = box
        inside = np.einsum("nji,nj->ni", attitude, point - centre)
        return centre + np.einsum("nij,nj->ni", attitude, np.clip(inside, -half, half))

    point = other[0]
    for _ in range(400):
        first = nearest(point, one)
        point = nearest(first, other)
    normal = first - point
    reach = sum(
        (np.abs(np.einsum("nji,nj->ni", attitude, normal)) * half).sum(1)
        for _, attitude, half in (one, other)
    )
    separated = ((one[0] - other[0]) * normal).sum(1) > reach
    return separated, np.linalg.norm(normal, axis=1) < 1e-6


def boxes_of(plans: Plan, depth: float) -> tuple:
    """Return centres, attitudes, and half extents smaller by half a depth."""
    found = [poses(one_of(plans, i)) for i in range(len(plans.half))]
    centres, attitudes = (np.stack(each) for each in zip(*found, strict=True))
    return centres, attitudes, plans.half - depth / 2


@pytest.mark.slow
def test_no_boxes_overlap_except_parents(plans):
    # The depth has a margin of 1 mm, because growth rounds places.
    boxes = boxes_of(plans, BOUNDS.overlap + 0.001)
    index = np.arange(BOUNDS.bodies)
    pairs = plans.present[:, :, None] & plans.present[:, None] & (index[:, None] > index[None])
    pairs &= plans.parent[:, :, None] != index
    i, one, other = np.nonzero(pairs)
    apart, _ = separated_or_meeting([x[i, one] for x in boxes], [x[i, other] for x in boxes])
    assert len(apart) > 5 * COUNT and apart.all()


@pytest.mark.slow
def test_parts_are_refused_only_for_overlaps():
    rng = np.random.default_rng(0)
    shape = COUNT, LAYOUT.nodes, LAYOUT.connections
    graph = jax.tree.map(lambda x: np.zeros((COUNT, *x.shape)), graph_of([{}] * 3, [])._asdict())
    graph["used"][:, :3] = graph["on"][:, 0, :2] = graph["recursion"][:] = 1
    graph["to"][:, 0, :2] = 1, 2
    graph["size"][:, 0] = 0.75
    graph["size"][:, 1:] = rng.uniform(0, 1, (COUNT, 5, 3))
    graph["place"], graph["turn"] = (rng.uniform(-1, 1, (*shape, 3)) for _ in range(2))
    graph = jax.tree.map(lambda x: jnp.asarray(x, float), PlanGraph(**graph))
    free = as_numpy(develop(FREE)(graph))
    count = np.asarray(develop(BOUNDS)(graph).present.sum(1))
    assert (free.present.sum(1) == 3).all()

    def siblings(depth):
        boxes = boxes_of(free, depth)
        return separated_or_meeting([x[:, 1] for x in boxes], [x[:, 2] for x in boxes])

    # Growth rounds places by less than half a millimetre.
    _, refused = siblings(BOUNDS.overlap + 0.001)
    accepted, _ = siblings(BOUNDS.overlap - 0.001)
    assert (count[refused] == 2).all() and (count[accepted] == 3).all()
    assert refused.sum() > 10 and accepted.sum() > 100 and (refused | accepted).mean() > 0.98


def random_trees(number: int, bodies: int) -> np.ndarray:
    """Return parents (tree, body) of trees of all sizes, from stars to chains."""
    rng = np.random.default_rng(1)
    index, nearness = np.arange(bodies), rng.choice([0.2, 1, 3, 10], (number, 1))
    parent = np.floor(rng.uniform(0, 1, (number, bodies)) ** (1 / nearness) * index).astype(int)
    sizes = rng.integers(1, bodies + 1, (number, 1))
    return np.where((index > 0) & (index < sizes), parent, -1)


def check_walk(parent: np.ndarray, slot: np.ndarray) -> None:
    """Check trees (tree, body) in the order of their walk."""
    tree, index = np.arange(len(parent))[:, None], np.arange(parent.shape[1])
    present = (index == 0) | (parent >= 0)
    assert (np.diff(present.astype(int)) <= 0).all() and (parent < index).all()
    size, last, ancestors = np.ones_like(parent), np.full_like(parent, -1), np.eye(len(index)) > 0
    for i in index[:0:-1]:
        rows = np.flatnonzero(parent[:, i] >= 0)
        size[rows, parent[rows, i]] += size[rows, i]
        last[rows, parent[rows, i]] = np.maximum(last[rows, parent[rows, i]], i)
    ancestors = np.repeat(ancestors[None], len(parent), 0)
    for i in index[1:]:
        rows = np.flatnonzero(parent[:, i] >= 0)
        ancestors[rows, :, i] |= ancestors[rows, :, parent[rows, i]]
    # Subtrees are contiguous, so the order is preorder.
    inside = (index[:, None] <= index) & (index < (index + size)[..., None])
    np.testing.assert_array_equal((inside & present[:, None])[present], ancestors[present])
    # Sizes fall among siblings, but the largest subtree is last.
    siblings = (parent[:, :, None] == parent[:, None]) & (parent >= 0)[..., None]
    earlier, is_last = siblings & (index[:, None] < index), last[tree, parent] == index
    sizes, following = size[..., None], size[:, None]
    assert (np.where(is_last[:, None], sizes <= following, sizes >= following) | ~earlier).all()
    # A body holds its slot from its place in the walk until its last child.
    np.testing.assert_array_equal(slot >= 0, last > index + 1)
    held = (index[:, None] < index) & (index < last[..., None]) & (slot >= 0)[..., None]
    assert not (held & (slot[..., None] == slot[:, None])).any()
    assert slot.max() == 2


@pytest.mark.slow
def test_open_bodies_never_use_one_slot(plans):
    trees = random_trees(100_000, 20)
    order, slot = map(np.asarray, jit_as_for_users(jax.vmap(walk_order))(trees))
    parent = np.take_along_axis(trees, order, 1)
    walked = np.take_along_axis(np.argsort(order), np.maximum(parent, 0), 1)
    check_walk(np.where(parent >= 0, walked, -1), slot)
    check_walk(plans.parent, plans.slot)


@pytest.mark.slow
def test_plans_are_equal_alone_and_in_batches():
    graphs = random_graphs(3)
    bounds = dataclasses.replace(BOUNDS, volume=0.02)
    function = jax.vmap(lambda graph: developed(graph, LAYOUT, bounds))
    batch = as_numpy(jit_as_for_users(function)(graphs))
    single = jit_as_for_users(lambda graph: developed(graph, LAYOUT, bounds))
    for i in range(48):
        alone = single(one_of(graphs, i))
        for value, other in zip(one_of(batch, i), alone, strict=True):
            assert value.tobytes() == np.asarray(other).tobytes()


@pytest.mark.slow
def test_float64_grows_the_same_bodies():
    graphs = random_graphs(2)
    plan = as_numpy(develop(BOUNDS)(graphs))
    with jax.enable_x64(True):
        precise = as_numpy(develop(BOUNDS)(jax.tree.map(lambda x: x.astype("float64"), graphs)))
    assert precise.half.dtype == np.float64
    for name in ("parent", "mirror", "label", "slot"):
        np.testing.assert_array_equal(getattr(plan, name), getattr(precise, name))
    for name in ("half", "place", "rotation"):
        np.testing.assert_allclose(getattr(plan, name), getattr(precise, name), atol=1e-6)


def test_every_vector_in_range_gives_finite_bodies():
    rng = np.random.default_rng(2)
    shape = (LAYOUT.count, COUNT)
    low, high = (LAYOUT.unpack(np.full(shape, x))._asdict() for x in (0.0, 1.0))
    low |= {name: low[name] - 1 for name in ("control", "place", "turn", "scale")}
    high |= {"to": high["to"] * 5, "kind": high["kind"] * 3, "recursion": high["recursion"] * 4}
    low, high = (np.asarray(LAYOUT.pack(PlanGraph(**each))) for each in (low, high))
    genes = rng.uniform(low, high)
    genes = np.where(
        rng.uniform(0, 1, shape) < 0.5, genes, rng.choice([0.0, 1.0], shape) * (high - low) + low
    )
    genes[:, 0], genes[:, 1], genes[:, 2] = low[:, 0], high[:, 0], 0
    graphs = jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0), LAYOUT.unpack(genes))
    plan = as_numpy(develop(BOUNDS)(graphs))
    for value in plan:
        assert np.isfinite(value).all()
    assert plan.present[:, 0].all() and (plan.half[plan.present] >= BOUNDS.half[0] * 0.999).all()
    assert (plan.parent < np.arange(BOUNDS.bodies)).all()
