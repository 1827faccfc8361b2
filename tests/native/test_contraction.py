"""Contraction of sums keeps values, adds no instruction, and fuses most products into sums."""

import collections
import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evo_cpg.native.frontend.builder import Builder
from evo_cpg.native.ir.graph import Graph, Node
from evo_cpg.native.ir.show import show
from evo_cpg.native.ir.verify import verify
from evo_cpg.native.passes.contract import contract_multiply_adds

FLOAT = np.dtype(np.float64)

OPERATIONS = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "neg": np.negative,
    "fma": lambda a, b, c: a * b + c,
    "fms": lambda a, b, c: a * b - c,
    "fnma": lambda a, b, c: c - a * b,
    "opaque": lambda a: a,
}


def given_nodes(builder: Builder, count: int) -> list[Node]:
    return list(builder.argument((count,), FLOAT))


def contracted(builder: Builder, *roots: Node, reorder: bool = True) -> Graph:
    """Return the graph after the pass, which does not change its argument."""
    builder.end_part((), roots, reorder)
    before = builder.graph([np.array([root], object) for root in roots])
    text = show(before)
    after = verify(contract_multiply_adds(verify(before)))
    assert show(before) == text
    return after


def expression(builder: Builder, draw) -> list[Node]:
    """Return random sums and products, some behind opaque nodes."""
    nodes = given_nodes(builder, 6)
    for _ in range(draw(st.integers(1, 40))):
        a, b = (nodes[draw(st.integers(0, len(nodes) - 1))] for _ in range(2))
        make = draw(st.sampled_from([builder.add, builder.subtract, builder.multiply]))
        nodes.append(make(a, b))
    return nodes


def value(node: Node, known: dict) -> float:
    if node.value is not None:
        return float(node.value)
    if node not in known:
        if node.op == "input":
            known[node] = 1.0 + 0.37 * node.detail[1]
        else:
            with np.errstate(all="ignore"):
                known[node] = OPERATIONS[node.op](*(value(each, known) for each in node.operands))
    return known[node]


def everything_behind(nodes) -> list[Node]:
    found, waiting = {}, list(nodes)
    while waiting:
        one = waiting.pop()
        if one not in found:
            found[one] = None
            waiting.extend(one.operands)
    return list(found)


def counts(nodes) -> collections.Counter:
    return collections.Counter(node.op for node in everything_behind(nodes))


def instructions(nodes) -> int:
    return sum(n for op, n in counts(nodes).items() if op not in ("input", "constant", "opaque"))


def magnitude(node: Node) -> float:
    """Return the sum of the absolute values of all terms, the scale of rounding errors."""
    known: dict = {}

    def size(one: Node) -> float:
        if one.value is not None:
            return abs(float(one.value))
        if one not in known:
            if one.op == "input":
                known[one] = 1.0 + 0.37 * one.detail[1]
            else:
                x = [size(each) for each in one.operands]
                product = x[0] * x[1] if one.op not in ("add", "sub") and len(x) > 1 else None
                rest = x if product is None else [product, *x[2:]]
                known[one] = sum(rest)
        return known[one]

    return size(node)


@given(st.data(), st.booleans())
def test_values_stay_and_instructions_do_not_grow(data, reorder):
    """Arguments of an inner program keep their values too."""
    builder = Builder()
    nodes = expression(builder, data.draw)
    seen = data.draw(st.lists(st.sampled_from(nodes), max_size=3))
    found = (
        builder.make("neg", [builder.opaque(node) for node in seen][:1], FLOAT)
        if seen
        else nodes[0]
    )
    inside = builder.opaque(found, part=builder.end_part(seen, [found]))
    expected = [nodes[-1], *seen]
    before, count = [value(node, {}) for node in expected], instructions(expected)
    scales = [magnitude(node) for node in expected]
    after = contracted(builder, nodes[-1], inside, reorder=reorder)
    expected = [after.result_nodes[0], *after.parts[0].arguments]
    for node, old, scale in zip(expected, before, scales, strict=True):
        assert abs(value(node, {}) - old) <= 1e-12 * scale or not np.isfinite(scale)
    assert instructions(expected) <= count
    every = everything_behind(expected)
    users = collections.Counter(
        [*expected, *(operand for node in every for operand in node.operands)]
    )
    left = [
        operand
        for node in every
        for operand in node.operands
        if node.op in ("add", "sub") and operand.op == "mul" and users[operand] == 1
    ]
    assert not left


def test_each_product_is_fused_into_a_sum():
    """``(a b + c d) + (e f + x)`` becomes three instructions, each with a product."""
    builder = Builder()
    a, b, c, d, e, f, x = given_nodes(builder, 7)
    ab, cd, ef = (builder.multiply(*pair) for pair in ((a, b), (c, d), (e, f)))
    root = builder.add(builder.add(ab, cd), builder.add(ef, x))
    assert counts(contracted(builder, root).result_nodes) == {"input": 7, "fma": 3}


@pytest.mark.parametrize(
    ("signs", "made"), [("++", "fma"), ("+-", "fnma"), ("-+", "fnma"), ("--", "fma")]
)
def test_signs_are_kept(signs, made):
    builder = Builder()
    x, y, a, b = given_nodes(builder, 4)
    ab = builder.multiply(a, b)
    first = builder.add(y, ab) if signs[1] == "+" else builder.subtract(y, ab)
    root = builder.add(x, first) if signs[0] == "+" else builder.subtract(x, first)
    before = value(root, {})
    (root,) = contracted(builder, root).result_nodes
    assert value(root, {}) == pytest.approx(before, rel=1e-14)
    assert counts([root])["mul"] == 0
    assert made in counts([root])


def test_without_reordering_the_written_order_is_kept():
    """Keep the order of ``((a + b c) + d) - e f`` and of a difference with the product first."""
    builder = Builder()
    a, b, c, d, e, f = given_nodes(builder, 6)
    inner = builder.add(builder.add(a, builder.multiply(b, c)), d)
    root = builder.subtract(inner, builder.multiply(e, f))
    other = builder.subtract(builder.multiply(a, d), e)
    root, other = contracted(builder, root, other, reorder=False).result_nodes
    inner = root.operands[2]
    assert root.op == "fnma" and root.operands == (e, f, inner)
    assert inner.op == "add" and d in inner.operands
    (fused,) = (node for node in inner.operands if node is not d)
    assert fused.op == "fma" and fused.operands == (b, c, a)
    assert other.op == "fms" and other.operands == (a, d, e)


def test_a_sum_or_product_with_other_users_stays_whole():
    builder = Builder()
    a, b, c, d = given_nodes(builder, 4)
    shared = builder.add(builder.multiply(a, b), builder.multiply(c, d))
    product = builder.multiply(a, c)
    roots = [builder.add(shared, a), builder.multiply(shared, b), builder.add(product, d), product]
    roots = contracted(builder, *roots).result_nodes
    (shared,) = {node for node in roots[0].operands if node.op != "input"}
    product = roots[3]
    assert all(shared in root.operands for root in roots[:2])
    assert roots[2].op == "add" and product in roots[2].operands


def test_arguments_of_an_inner_program_are_not_reordered():
    """If a program reads ``s = a b + c d``, ``s + e`` must not become ``(e + a b) + c d``."""
    builder = Builder()
    a, b, c, d, e = given_nodes(builder, 5)
    s = builder.add(builder.multiply(a, b), builder.multiply(c, d))
    found = builder.make("neg", [builder.opaque(s)], FLOAT)
    elsewhere = builder.opaque(found, part=builder.end_part([s], [found]))
    root = builder.add(s, e)
    before = value(s, {})
    after = contracted(builder, root, elsewhere)
    root, (s,) = after.result_nodes[0], after.parts[0].arguments
    assert value(s, {}) == pytest.approx(before, rel=1e-15)
    assert s in root.operands and s.op == "fma"


def test_three_of_four_products_are_fused_in_any_order():
    """Three of four products are fused into sums, in any order of the products."""
    for order in itertools.permutations(range(4)):
        builder = Builder()
        x = given_nodes(builder, 8)
        terms = [builder.multiply(x[2 * i], x[2 * i + 1]) for i in order]
        root = builder.add(builder.add(terms[0], terms[1]), builder.add(terms[2], terms[3]))
        assert counts(contracted(builder, root).result_nodes) == {"input": 8, "mul": 1, "fma": 3}
