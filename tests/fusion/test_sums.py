"""Chains of sums: the same value, as many additions, and more of them with a product at hand."""

import collections

import jax
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from evo_cpg.fusion.graph import Graph, Node
from evo_cpg.fusion.schedule import cut
from evo_cpg.fusion.sums import chain_sums

FLOAT = np.dtype(np.float64)


def expression(graph: Graph, draw) -> Node:
    """A random tree of sums and products."""
    nodes = [graph.input(i, FLOAT) for i in range(6)]
    for _ in range(draw(st.integers(1, 40))):
        a, b = (nodes[draw(st.integers(0, len(nodes) - 1))] for _ in range(2))
        make = draw(st.sampled_from([graph.add, graph.subtract, graph.multiply]))
        nodes.append(make(a, b))
    return nodes[-1]


def value(node: Node, known: dict) -> float:
    if node.value is not None:
        return float(node.value)
    if node not in known:
        operate = {"add": np.add, "sub": np.subtract, "mul": np.multiply, "neg": np.negative}
        known[node] = operate[node.name](*(value(operand, known) for operand in node.operands))
    return known[node]


def behind(node: Node) -> list[Node]:
    found, waiting = {}, [node]
    while waiting:
        one = waiting.pop()
        if one not in found:
            found[one] = None
            waiting.extend(one.operands)
    return list(found)


def counts(node: Node) -> collections.Counter:
    kinds = collections.Counter(one.name for one in behind(node))
    return collections.Counter(sums=kinds["add"] + kinds["sub"], products=kinds["mul"])


def inputs(root: Node) -> dict:
    sources = [one for one in behind(root) if not one.is_operation and one.value is None]
    return {one: 1.0 + 0.37 * i for i, one in enumerate(sorted(sources, key=lambda n: n.number))}


@given(st.data())
def test_values_and_counts_stay(data):
    root = expression(Graph(), data.draw)
    given_values = inputs(root)
    before, count = value(root, dict(given_values)), counts(root)
    chain_sums([root])
    after = value(root, dict(given_values))
    scale = max(abs(before), 1.0)
    assert abs(after - before) <= 1e-9 * scale or not np.isfinite(before)
    assert counts(root) == count


@given(st.data())
def test_operands_still_come_before_their_users(data):
    root = expression(Graph(), data.draw)
    chain_sums([root])
    assert all(operand.number < node.number for node in behind(root) for operand in node.operands)
    done: set[Node] = set()
    for piece, _ in cut([root]) if root.is_operation else []:
        for node in piece:
            assert all(o in done for o in node.operands if o.is_operation)
            done.add(node)


def test_products_are_added_one_by_one():
    """``(a b + c d) + (e f + x)`` has three additions, each with a product that only it uses."""
    graph = Graph()
    a, b, c, d, e, f, x = (graph.input(i, FLOAT) for i in range(7))
    ab, cd, ef = (graph.multiply(*pair) for pair in ((a, b), (c, d), (e, f)))
    root = graph.add(graph.add(ab, cd), graph.add(ef, x))
    chain_sums([root])
    sums = [node for node in behind(root) if node.name == "add"]
    assert len(sums) == 3
    assert all(any(o.primitive is jax.lax.mul_p for o in node.operands) for node in sums)


def test_a_sum_that_others_use_is_left_whole():
    graph = Graph()
    a, b, c, d = (graph.input(i, FLOAT) for i in range(4))
    shared = graph.add(graph.multiply(a, b), graph.multiply(c, d))
    roots = [graph.add(shared, a), graph.multiply(shared, b)]
    chain_sums(roots)
    assert all(shared in root.operands for root in roots)
