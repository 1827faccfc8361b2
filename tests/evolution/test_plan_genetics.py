"""The genetic algorithm on body plans: elites, parents, and fractions of each kind of child."""

import functools

import jax
import numpy as np
import pytest

from creatures import quick_jit
from evo_cpg.analysis.diversity import topology_of
from evo_cpg.creature.graph import GraphLayout, PlanGraph
from evo_cpg.evolution.plan_genetics import PlanGenetics
from evo_cpg.evolution.strategy import Evaluation
from plans import WATER, plans_of, random_genes

LAYOUT = GraphLayout()
# Whether each gene is a control gene.
CONTROL = np.concatenate(
    [np.full(np.prod(shape), name == "control") for name, shape in LAYOUT.shapes.items()]
)
SIZE, ELITES = 1000, 50
# Five standard deviations of a fraction of so many children.
MARGIN = 5 * 0.5 / np.sqrt(SIZE)


@functools.cache
def chains() -> np.ndarray:
    """Return genes of chains of different parts, whose labels tell the individual."""
    nodes, shapes = LAYOUT.nodes, LAYOUT.shapes
    genes = {name: np.zeros((*shape, SIZE), np.float32) for name, shape in shapes.items()}
    genes["used"][:] = genes["recursion"][:] = 1.0
    genes["size"][:] = 0.5
    genes["label"][:] = 1 + np.arange(nodes * SIZE).reshape(SIZE, nodes).T
    genes["on"][:-1, 0] = 1.0
    genes["to"][:-1, 0] = np.arange(1, nodes)[:, None]
    return np.asarray(LAYOUT.pack(PlanGraph(**genes)))


@functools.cache
def compiled():
    """Compile a generation. The kinds of children are numbers of the program."""

    def next_of(key, genes, fitness, kinds):
        search = PlanGenetics(SIZE, LAYOUT, ELITES, 0.2, *kinds)
        return search.tell(key, (), genes, Evaluation(fitness, {}, {}))

    return quick_jit(next_of)


def after(genes, fitness, **settings) -> np.ndarray:
    """Return the next generation of a search with settings of its own."""
    search = PlanGenetics(SIZE, LAYOUT, ELITES, 0.2, 0.0, 0.0, 3.0, **settings)
    run = quick_jit(
        lambda *given: search.tell(*given[:1], (), given[1], Evaluation(given[2], {}, {}))
    )
    return np.asarray(run(jax.random.key(0), genes, fitness))


def bred(crossed=0.0, grafted=0.0, alterations=0.0, genes=None, seed=0):
    """Return genes, fitness, and the next generation."""
    genes = chains() if genes is None else genes
    fitness = np.random.default_rng(seed).permutation(SIZE).astype(np.float32)
    kinds = crossed, grafted, alterations
    children = compiled()(jax.random.key(seed), genes, fitness, kinds)
    return genes, fitness, np.array(children)


def parents_of(children: np.ndarray) -> list[set[int]]:
    """Return the individuals from which the parts of each child come, the root's first."""
    labels = np.asarray(LAYOUT.unpack(children).label).astype(int).T
    return [{(label - 1) // LAYOUT.nodes for label in own if label} for own in labels]


def changed(children: np.ndarray, genes: np.ndarray) -> float:
    """Return the fraction of children, without the elites, that differ from all genomes."""
    known = {own.tobytes() for own in genes.T}
    return np.mean([own.tobytes() not in known for own in children.T[ELITES:]])


def test_elites_stay_unchanged_best_first():
    genes, fitness, children = bred(0.3, 0.3, 3.0)
    best = np.argsort(-fitness)[:ELITES]
    np.testing.assert_array_equal(children[:, :ELITES], genes[:, best])
    assert changed(children, genes) > 0.8


def test_children_come_from_the_best_fifth():
    """Better ranks have more children: the better half of the parents has three quarters."""
    genes, fitness, children = bred()
    assert changed(children, genes) == 0
    rank = np.argsort(np.argsort(-fitness))
    own = np.array([rank[parent] for (parent,) in parents_of(children[:, ELITES:])])
    assert own.max() < 0.2 * SIZE and len(set(own.tolist())) > 0.1 * SIZE
    assert np.mean(own < 0.1 * SIZE) == pytest.approx(0.75, abs=MARGIN)


@pytest.mark.parametrize(
    ("crossed", "grafted"), [(0.3, 0.0), (0.0, 0.4), (0.2, 0.5), (0.0, 1.0), (1.0, 0.0)]
)
def test_fractions_of_children_have_two_parents(crossed, grafted):
    """Parts of two chains make a child of two parents, unless both are the same individual."""
    _, _, children = bred(crossed, grafted)
    two = [len(parents) == 2 for parents in parents_of(children)[ELITES:]]
    # Two draws from 200 ranks with a linear probability are equal with a probability of 2/3 %.
    expected = (crossed + grafted) * (1 - 4 / 3 / (0.2 * SIZE))
    assert np.mean(two) == pytest.approx(expected, abs=MARGIN)


def test_a_cross_keeps_places_and_a_graft_moves_them():
    """Each part of a crossed chain is at the place that it has in its parent."""
    for crossed, grafted in ((1.0, 0.0), (0.0, 1.0)):
        _, _, children = bred(crossed, grafted)
        labels = np.asarray(LAYOUT.unpack(children[:, ELITES:]).label).astype(int)
        place = np.broadcast_to(np.arange(LAYOUT.nodes)[:, None], labels.shape)
        same = ((labels - 1) % LAYOUT.nodes == place)[labels > 0].mean()
        assert same == 1 if crossed else 0.3 < same < 0.9


def test_joined_plans_change_a_quarter_as_often_as_copies():
    """Alterations are nearly a Poisson process, so exp(-rate) of the children have none.

    A cross of equal plans changes nothing by itself.
    """
    genes = np.repeat(chains()[:, :1], SIZE, axis=1)
    for crossed, rate in ((0.0, 2.0), (1.0, 0.5)):
        _, _, children = bred(crossed, 0.0, 2.0, genes)
        same = 1 - changed(children, genes)
        assert same == pytest.approx(np.exp(-rate), abs=MARGIN)


def test_a_start_around_plans_keeps_the_first():
    search = PlanGenetics(SIZE, LAYOUT, ELITES, 0.2, 0.0, 0.0, 3.0)
    genes = chains()
    found = np.asarray(quick_jit(search.around)(jax.random.key(0), genes))
    np.testing.assert_array_equal(found[:, 0], genes[:, 0])
    assert found.dtype == genes.dtype
    assert (found != genes).any(0)[1:].mean() == pytest.approx(1 - np.exp(-3.0), abs=MARGIN)


def bodies_of(genes: np.ndarray) -> np.ndarray:
    """Return the genes that are not control genes."""
    return genes[~CONTROL]


@pytest.mark.slow
def test_protected_elites_are_the_best_of_their_topologies():
    """Trees that are compared joint by joint are the oracle. Then come the others, best first."""
    plans = plans_of(WATER, 4, 0.1)
    size = 300
    genes = random_genes(plans, size).astype(np.float32)
    draw = np.random.default_rng(0)
    fitness = draw.integers(0, 120, size).astype(np.float32)
    fitness[:5] = -np.inf
    search = PlanGenetics(
        size, plans.layout, ELITES, 0.2, 0.0, 0.0, 0.0, bounds=plans.bounds, protect=True
    )
    run = quick_jit(lambda *given: search.births(*given[:2], Evaluation(given[2], {}, {})).first)
    found = np.asarray(run(jax.random.key(0), genes, fitness))[:ELITES]
    best: dict = {}
    for i in np.argsort(-fitness, kind="stable"):
        if np.isfinite(fitness[i]):
            best.setdefault(topology_of(plans.plan(genes[:, i])), i)
    first = list(best.values())
    others = [i for i in np.argsort(-fitness, kind="stable") if i not in first]
    np.testing.assert_array_equal(found, [*first, *others][:ELITES])
    assert 10 < len(first) < size - 20


@pytest.mark.parametrize(("evolve", "fixed"), [("brain", False), ("body", True)])
def test_only_the_named_part_evolves(evolve, fixed):
    genes = chains()
    children = after(genes, -np.arange(SIZE, dtype=np.float32), evolve=evolve)
    known = {own.tobytes() for own in bodies_of(genes).T}
    same = np.array([own.tobytes() in known for own in bodies_of(children).T])
    brains = children[CONTROL]
    assert same.all() != fixed
    assert (not brains[:, np.isin(children[1], genes[1])].any()) == fixed
