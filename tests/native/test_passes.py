"""Each pass of the native back end on small programs, and programs without a pass."""

import collections
import dataclasses
import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from against_jax import plain, sample
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.graphs import InvalidGraph, show, verify
from evo_cpg.native import compile, machine_constants, native, passes
from evo_cpg.native.backend.allocate import Allocator
from evo_cpg.native.backend.code import Target, Variant
from evo_cpg.native.compile import PASSES, optimize
from evo_cpg.native.frontend.builder import Builder
from evo_cpg.native.frontend.primitives import fused_p
from evo_cpg.native.frontend.simplify import RULES
from evo_cpg.native.fuse import fuse
from evo_cpg.native.ir import Node, Unsupported
from evo_cpg.native.passes import eliminate_dead_code, schedule

F32 = np.dtype(np.float32)
TARGET = Target("avx2", 32, 16, fma=True, compresses=False, processor="", features="")
WIDE = Variant(TARGET, width=8)


def program(x):
    """Compute sums of products, a counted loop, a loop with a condition and a long branch."""
    mixed = x[0] * x[1] + x[2] * x[0] - 0.0 * x[1]

    def turn(carry, row):
        return 0.9 * carry + row * mixed, (carry[0], carry[1] * carry[2])

    end, (path, _) = jax.lax.scan(turn, x, jnp.arange(4.0))
    root = jax.lax.while_loop(lambda r: jnp.abs(r) > 0.5, lambda r: 0.4 * r, end[0] + path[2])

    def far(y):
        for k in range(9):
            y = y + 0.1 * jnp.sin(y * (k + 1.0))
        return y

    return jax.lax.cond(root > 0.1, far, lambda y: y, end), root


def traced(function=program, rows=3):
    """Return the program of a fused function."""
    x = jax.ShapeDtypeStruct((rows, 40), F32)
    jaxpr = jax.make_jaxpr(functools.partial(fuse, function, batch_ndim=1))(x)
    (equation,) = [each for each in jaxpr.eqns if each.primitive is fused_p]
    return equation.params["program"]


class Scalar:
    """A node with operators, so that a test writes its program as a formula."""

    def __init__(self, builder, node):
        self.builder, self.node = builder, node

    def apply(self, op, *others):
        nodes = [each.node for each in (self, *map(self.like, others))]
        return Scalar(self.builder, self.builder.apply(op, *nodes))

    def like(self, value):
        dtype = bool if isinstance(value, bool) else self.node.dtype
        constant = isinstance(value, Scalar) or self.builder.constant(value, dtype)
        return value if isinstance(value, Scalar) else Scalar(self.builder, constant)

    def opaque(self, part=None):
        return Scalar(self.builder, self.builder.alias("opaque", self.node, part=part))

    __add__ = functools.partialmethod(apply, "add")
    __sub__ = functools.partialmethod(apply, "sub")
    __mul__ = functools.partialmethod(apply, "mul")
    __truediv__ = functools.partialmethod(apply, "div")
    __lt__ = functools.partialmethod(apply, "lt")
    __and__ = functools.partialmethod(apply, "and")
    __or__ = functools.partialmethod(apply, "or")
    __neg__ = functools.partialmethod(apply, "neg")
    __invert__ = functools.partialmethod(apply, "not")
    select = functools.partialmethod(apply, "select")


def scalars(count, dtype=F32, rules=RULES):
    """Return the rows of an argument."""
    builder = Builder(rules)
    return [Scalar(builder, node) for node in builder.argument((count,), dtype)]


def graph_of(*results, reorder=True):
    builder, nodes = results[0].builder, [each.node for each in results]
    builder.begin_part()
    builder.end_part((), nodes, reorder)
    return builder.graph([np.array([node], object) for node in nodes])


def ops(graph):
    return [node.op for node in graph.nodes if node.op not in ("input", "constant")]


# Programs without one pass.


def assert_right():
    x = sample((3, 40))
    got = jax.jit(functools.partial(fuse, program, batch_ndim=1))(x)
    for one, other in zip(got, plain(program, x), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("left_out", [each.__name__ for each in PASSES])
def test_program_means_the_same_without_a_pass(left_out, monkeypatch):
    kept = [each for each in PASSES if each.__name__ != left_out]
    assert len(kept) < len(PASSES)
    monkeypatch.setattr(compile, "PASSES", kept)
    assert_right()


def test_program_means_the_same_without_rules(monkeypatch):
    monkeypatch.setattr(native, "to_llvm", functools.partial(native.to_llvm, rules={}))
    assert_right()


@pytest.mark.parametrize("one", PASSES)
def test_a_pass_does_not_change_its_argument(one):
    before = optimize(traced(), PASSES[: PASSES.index(one)])
    text, nodes = show(before), list(before.nodes)
    after = one(before)
    assert show(before) == text and before.nodes == nodes
    assert (show(after) != text) == (one is not passes.check_size)


# Simplify.


CASES = {
    "x + 0 -> x": lambda x, y: (x + 0, x),
    "x + (-y) -> x - y": lambda x, y: (-y + x, x - y),
    "x - 0 -> x": lambda x, y: (x - 0, x),
    "0 - x -> -x": lambda x, y: (x.like(0) - x, -x),
    "x - (-y) -> x + y": lambda x, y: (x - (-y), x + y),
    "0 x -> 0": lambda x, y: (x.like(0) * x, x.like(0)),
    "1 x -> x": lambda x, y: (x * 1, x),
    "(-c) x -> -(c x)": lambda x, y: (x * -3, -(x * 3)),
    "x / 2^k -> x 2^-k": lambda x, y: (x / 8, x * 0.125),
    "-(-x) -> x": lambda x, y: ((-x).apply("neg"), x),
    "not not x -> x": lambda x, y: (~~(x < y), x < y),
    "x and true -> x; x and false -> false; x and x -> x": lambda x, y: (
        ((x < y) & True) & (x < y),
        x < y,
    ),
    "x or false -> x; x or true -> true; x or x -> x": lambda x, y: ((x < y) | True, x.like(True)),
    "select c, x, y -> x or y": lambda x, y: (x.like(False).select(x, y), y),
    "select a, x, x -> x": lambda x, y: ((x < y).select(x, x), x),
    "select a, true, false -> a; select a, false, true -> not a": lambda x, y: (
        (x < y).select(False, True),
        ~(x < y),
    ),
}


@pytest.mark.parametrize("rule", [rule.name for rules in RULES.values() for rule in rules])
def test_rewrite_rule(rule):
    without = {op: [each for each in rules if each.name != rule] for op, rules in RULES.items()}
    for rules in (RULES, without):
        got, expected = CASES[rule](*scalars(2, rules=rules))
        assert (got.node is expected.node) == (rules is RULES)


def test_constants_fold_and_equal_operations_merge():
    x, y = scalars(2)
    assert (x.like(2) + 1).node.value == 3
    assert (x + y).node is (y + x).node


# Contract multiply-adds.


OPERATIONS = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "neg": np.negative,
    "fma": lambda a, b, c: a * b + c,
    "fms": lambda a, b, c: a * b - c,
    "fnma": lambda a, b, c: c - a * b,
    "opaque": lambda a: a,
    "constant": lambda a: a,
}
# These compute the sum of the absolute values of all terms, the scale of rounding errors.
MAGNITUDES = OPERATIONS | {
    "sub": np.add,
    "neg": lambda a: a,
    "fms": OPERATIONS["fma"],
    "fnma": OPERATIONS["fma"],
    "constant": abs,
}


def value(node, operations=OPERATIONS, known=None):
    """Return the number of a node. Input k is 1 + 0.37 k."""
    known = {} if known is None else known
    if node.value is not None:
        return operations["constant"](float(node.value))
    if node not in known:
        given = [value(each, operations, known) for each in node.operands]
        with np.errstate(all="ignore"):
            known[node] = (
                1.0 + 0.37 * node.detail[1] if node.op == "input" else operations[node.op](*given)
            )
    return known[node]


def contracted(*roots, reorder=True):
    """Return the graph after the pass, which does not change its argument."""
    before = graph_of(*roots, reorder=reorder)
    text = show(before)
    after = verify(passes.contract_multiply_adds(verify(before)))
    assert show(before) == text
    return after


def everything_behind(nodes):
    found, waiting = {}, list(nodes)
    while waiting:
        one = waiting.pop()
        if one not in found:
            found[one] = None
            waiting.extend(one.operands)
    return list(found)


def counts(nodes):
    return collections.Counter(node.op for node in everything_behind(nodes))


def instructions(nodes):
    return sum(n for op, n in counts(nodes).items() if op not in ("input", "constant", "opaque"))


@given(st.data(), st.booleans())
def test_values_stay_and_instructions_do_not_grow(data, reorder):
    """Arguments of an inner program keep their values too."""
    made = scalars(6, float)
    for _ in range(data.draw(st.integers(1, 40))):
        a, b = (made[data.draw(st.integers(0, len(made) - 1))] for _ in range(2))
        made.append(a.apply(data.draw(st.sampled_from(["add", "sub", "mul"])), b))
    seen = data.draw(st.lists(st.sampled_from(made), max_size=3))
    found, builder = made[0], made[0].builder
    if seen:
        found = Scalar(builder, builder.make("neg", [each.opaque().node for each in seen][:1], "d"))
    builder.begin_part()
    part = builder.end_part([each.node for each in seen], [found.node])
    expected = [each.node for each in (made[-1], *seen)]
    before, count = [value(node) for node in expected], instructions(expected)
    scales = [value(node, MAGNITUDES) for node in expected]
    after = contracted(made[-1], found.opaque(part), reorder=reorder)
    expected = [after.result_nodes[0], *after.parts[0].arguments]
    for node, old, scale in zip(expected, before, scales, strict=True):
        assert abs(value(node) - old) <= 1e-12 * scale or not np.isfinite(scale)
    assert instructions(expected) <= count
    every = everything_behind(expected)
    pairs = [(node, operand) for node in every for operand in node.operands]
    users = collections.Counter([*expected, *(operand for _, operand in pairs)])
    for node, operand in pairs:
        assert node.op not in ("add", "sub") or operand.op != "mul" or users[operand] > 1


def test_three_of_four_products_are_fused_in_any_order():
    for order in itertools.permutations(range(4)):
        x = scalars(8, float)
        a, b, c, d = (x[2 * i] * x[2 * i + 1] for i in order)
        found = counts(contracted((a + b) + (c + d)).result_nodes)
        assert found == {"input": 8, "mul": 1, "fma": 3}


def test_without_reordering_the_written_order_is_kept():
    """The order of a difference with the product first is kept too."""
    a, b, c, d, e, f = inputs = scalars(6, float)
    roots = ((a + b * c) + d) - e * f, a * d - e
    root, other = contracted(*roots, reorder=False).result_nodes
    a, b, c, d, e, f = (each.node for each in inputs)
    inner = root.operands[2]
    assert root.op == "fnma" and root.operands == (e, f, inner)
    assert inner.op == "add" and d in inner.operands
    (fused,) = (node for node in inner.operands if node is not d)
    assert fused.op == "fma" and fused.operands == (b, c, a)
    assert other.op == "fms" and other.operands == (a, d, e)


def test_a_sum_or_product_with_other_users_stays_whole():
    a, b, c, d = scalars(4, float)
    shared, product = a * b + c * d, a * c
    roots = contracted(shared + a, shared * b, product + d, product).result_nodes
    (shared,) = {node for node in roots[0].operands if node.op != "input"}
    assert all(shared in root.operands for root in roots[:2])
    assert roots[2].op == "add" and roots[3] in roots[2].operands


def test_a_part_is_not_needed_for_its_constant():
    """Two parts are dead, although one returns the 0 that the third uses."""

    def nested(x):
        dead = fuse(lambda x: x + x[0] * x[1], x, batch_ndim=0)
        fuse(lambda x, dead: (jnp.zeros_like(x), dead), x, dead, batch_ndim=0)
        return fuse(lambda x: jnp.maximum(x, 0.0), x, batch_ndim=0)

    for _, graph in compile.stages(traced(nested)):
        verify(graph)


# Eliminate dead code, check the size, schedule, rewrite.


def test_unused_operations_are_removed():
    x, y, z = scalars(3)
    total, _ = x + y, y * z
    graph = graph_of(total)
    assert ops(graph) == ["add", "mul"]
    assert ops(eliminate_dead_code(graph)) == ["add"]
    assert len(eliminate_dead_code(graph).nodes) == 3


def test_too_many_operations_raise(monkeypatch):
    monkeypatch.setattr(machine_constants, "MOST_OPERATIONS", 2)
    x, y, z = scalars(3)
    with pytest.raises(Unsupported, match="more than 2 operations"):
        passes.check_size(graph_of(x + y * z))


def test_schedule_computes_operands_shortly_before_their_use():
    x, y, z = scalars(3)
    early = x.apply("sqrt")
    other = (y * z).apply("sqrt")
    graph = graph_of(other * other + early)
    (run,) = schedule(graph).runs[graph.top]
    assert ops(graph) == ["sqrt", "mul", "sqrt", "mul", "add"]
    assert [node.op for node in run.nodes] == ["mul", "sqrt", "mul", "sqrt", "add"]


def test_rewrite_makes_new_users_and_keeps_the_old():
    x, y, _ = scalars(3)
    graph = graph_of(-(x + y))
    x, _, z, total, negative = graph.nodes
    new = passes.rewrite(graph, {total: passes.Replacement("sub", (x, z), total.number)})
    (root,) = new.result_nodes
    assert negative.operands == (total,) and total.op == "add"
    assert root is not negative and root.operands[0].op == "sub"
    assert root.operands[0].operands == (x, z)


# Verify, show.


def assert_invalid(graph, message, **changes):
    with pytest.raises(InvalidGraph, match=message):
        verify(dataclasses.replace(graph, **changes))


def test_verifier_finds_invalid_nodes():
    x, y, z = scalars(3)
    graph = verify(graph_of((x < y).select(x, y * z)))
    _, y, _, test, _, choice = graph.nodes
    wrong = [
        (3, {"op": "nothing"}, "unknown operation"),
        (3, {"dtype": F32}, "has types float32, float32 -> float32, not a a -> b"),
        (4, {"operands": (y,)}, "has types float32 -> float32, not n n -> n"),
        (4, {"operands": (y, test)}, "has types float32, bool"),
        (4, {"operands": (y, choice)}, "before it is made"),
        (4, {"uniform": True}, "is uniform, but its operand"),
        (4, {"detail": 3}, "has the wrong detail 3"),
        (4, {"number": 2}, "greater or equal number"),
        (4, {"value": 1.0}, "has the wrong value"),
        (5, {"dtype": np.dtype(np.float64)}, "not b a a -> a"),
    ]
    for place, changes, message in wrong:
        nodes = list(graph.nodes)
        nodes[place] = dataclasses.replace(nodes[place], **changes)
        assert_invalid(graph, message, nodes=nodes)
    assert_invalid(graph, "cannot be a result", nodes=graph.nodes[:-1])


def test_verifier_finds_invalid_schedules():
    x, y, z = scalars(3)
    graph = schedule(graph_of((x < y).select(x, y * z)))
    (run,) = graph.runs[graph.top]
    for nodes, message in (
        (run.nodes[::-1], "later or never"),
        (run.nodes[1:], "later or never"),
        (run.nodes[:2], "later or never"),
        ([*run.nodes, *run.nodes], "or twice"),
    ):
        assert_invalid(graph, message, runs={graph.top: [run._replace(nodes=nodes)]})


def test_verifier_looks_behind_opaque_nodes():
    x, y = scalars(2)
    graph = verify(schedule(graph_of(-(x + y).opaque())))
    (run,) = graph.runs[graph.top]
    less = {graph.top: [run._replace(nodes=run.nodes[1:])]}
    assert_invalid(graph, "later or never", runs=less)
    nodes = [node for node in graph.nodes if node.op != "add"]
    assert_invalid(graph, "before it is made", nodes=nodes)


def test_verifier_finds_invalid_loops():
    graph = verify(optimize(traced(), PASSES[:2]))
    (loop, *_) = [node for node in graph.nodes if node.op == "loop"]
    inner, detail, carried = [], loop.detail, graph.kept[loop][0]
    inner = [node for node in graph.nodes if node.block is detail.body]
    following = [*detail.following]
    following[carried] = next(x for x in inner if x.dtype != loop.operands[carried].dtype)
    for changes, message in (
        ({"count": None}, "number of rounds or a condition"),
        ({"test": detail.body}, "in another block"),
        ({"following": tuple(following)}, "different types"),
    ):
        one = dataclasses.replace(loop, detail=detail._replace(**changes))
        nodes = [one if node is loop else node for node in graph.nodes]
        loops = {block: one if each is loop else each for block, each in graph.loops.items()}
        kept = {one: graph.kept[loop]}
        assert_invalid(graph, message, nodes=nodes, loops=loops, kept=kept)
    number = graph.nodes[-1].number + 1
    outside = Node("neg", (inner[-1],), inner[-1].dtype, graph.top, False, number)
    assert_invalid(graph, "computed in another block", nodes=[*graph.nodes, outside])


def test_invalid_graph_names_the_pass(monkeypatch):
    def forget(graph):
        return dataclasses.replace(graph, nodes=graph.nodes[1:])

    with pytest.raises(InvalidGraph, match=r"forget: .* before it is made"):
        optimize(traced(), [forget])
    monkeypatch.setattr(compile, "stages", compile.stages.__wrapped__)
    optimize(traced(), [forget])


def test_a_graph_is_printed_line_by_line():
    lines = show(optimize(traced(lambda x: x[0] * x[1] + x[2]))).splitlines()
    assert lines[0] == "argument 0: float32[3]"
    name = "test_a_graph_is_printed_line_by_line.<locals>.<lambda>"
    last = [f"%8: float32 = fma %1, %2, %3  ; {name}", "result 0: float32[1] = %8"]
    assert lines[-2:] == last


def test_loops_are_printed_with_their_carry():
    text = show(optimize(traced()))
    for part in ("= repeat 4", "= while", "= branch", "carry", "next", "write"):
        assert part in text


# Allocate, print.


def test_values_beyond_the_registers_go_to_memory():
    roots = [row.apply("sqrt") for row in scalars(40)]
    total = sum((each.apply("abs") for each in roots[::-1]), start=sum(roots[1:], start=roots[0]))
    graph = schedule(eliminate_dead_code(graph_of(total)))
    few, many = (
        Allocator(graph, WIDE._replace(target=TARGET._replace(registers=n))).allocated()
        for n in (8, 64)
    )
    assert few.frame > 0 and many.frame == 0
