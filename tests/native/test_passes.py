"""Each pass of the native back end on small programs, and programs without a pass."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from against_jax import plain, sample

from evo_cpg.native import compile, machine_constants, native
from evo_cpg.native.backend.allocate import allocate
from evo_cpg.native.backend.code import LoopCode, Stretch, Target, Variant
from evo_cpg.native.backend.llvm import print_llvm
from evo_cpg.native.compile import PASSES, check_size, optimize
from evo_cpg.native.frontend.builder import Builder
from evo_cpg.native.frontend.primitives import fused_p
from evo_cpg.native.frontend.simplify import RULES
from evo_cpg.native.fuse import fuse
from evo_cpg.native.ir.graph import Change, Node, rewrite
from evo_cpg.native.ir.show import show
from evo_cpg.native.ir.verify import InvalidGraph, verify
from evo_cpg.native.passes.dead_code import eliminate_dead_code
from evo_cpg.native.passes.schedule import schedule
from evo_cpg.native.unsupported import Unsupported

F32 = np.dtype(np.float32)
TARGET = Target("avx2", 32, 16, fma=True, processor="", features="")
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


def graph_of(make, rows=3):
    """Return the graph of nodes that are made of the rows of one argument."""
    builder = Builder()
    results = make(builder, *builder.argument((rows,), F32))
    results = results if isinstance(results, tuple) else (results,)
    builder.end_part((), results)
    return builder.graph([np.array([node], object) for node in results])


def ops(graph):
    return [node.op for node in graph.nodes if node.op not in ("input", "constant")]


# Programs without one pass.


@pytest.mark.parametrize("left_out", [each.__name__ for each in PASSES])
def test_program_means_the_same_without_a_pass(left_out, monkeypatch):
    kept = [each for each in compile.PASSES if each.__name__ != left_out]
    assert len(kept) < len(compile.PASSES)
    monkeypatch.setattr(compile, "PASSES", kept)
    assert_right()


def test_program_means_the_same_without_rules(monkeypatch):
    monkeypatch.setattr(native, "to_llvm", functools.partial(native.to_llvm, rules={}))
    assert_right()


def assert_right():
    x = sample((3, 40))
    got = jax.jit(functools.partial(fuse, program, batch_ndim=1))(x)
    for one, other in zip(got, plain(program, x), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("one", PASSES)
def test_a_pass_does_not_change_its_argument(one):
    before = optimize(traced(), PASSES[: PASSES.index(one)])
    text, nodes = show(before), list(before.nodes)
    after = one(before)
    assert show(before) == text and before.nodes == nodes
    assert (show(after) != text) == (one is not check_size)


# Simplify.


CASES = {
    "x + 0 -> x": lambda b, x, y: (b.add(x, zero(b)), x),
    "x + (-y) -> x - y": lambda b, x, y: (b.add(b.negate(y), x), b.subtract(x, y)),
    "x - 0 -> x": lambda b, x, y: (b.subtract(x, zero(b)), x),
    "0 - x -> -x": lambda b, x, y: (b.subtract(zero(b), x), b.negate(x)),
    "x - (-y) -> x + y": lambda b, x, y: (b.subtract(x, b.negate(y)), b.add(x, y)),
    "0 x -> 0": lambda b, x, y: (b.multiply(zero(b), x), zero(b)),
    "1 x -> x": lambda b, x, y: (b.multiply(x, b.constant(1, F32)), x),
    "(-c) x -> -(c x)": lambda b, x, y: (
        b.multiply(x, b.constant(-3, F32)),
        b.negate(b.multiply(x, b.constant(3, F32))),
    ),
    "x / 2^k -> x 2^-k": lambda b, x, y: (
        b.apply("div", x, b.constant(8, F32)),
        b.multiply(x, b.constant(0.125, F32)),
    ),
    "-(-x) -> x": lambda b, x, y: (b.negate(b.negate(x)), x),
    "not not x -> x": lambda b, x, y: (
        b.apply("not", b.apply("not", less(b, x, y))),
        less(b, x, y),
    ),
    "x and true -> x; x and false -> false; x and x -> x": lambda b, x, y: (
        b.apply("and", b.apply("and", less(b, x, y), truth(b, True)), less(b, x, y)),
        less(b, x, y),
    ),
    "x or false -> x; x or true -> true; x or x -> x": lambda b, x, y: (
        b.apply("or", less(b, x, y), truth(b, True)),
        truth(b, True),
    ),
    "select c, x, y -> x or y": lambda b, x, y: (b.select(truth(b, False), x, y), y),
    "select a, x, x -> x": lambda b, x, y: (b.select(less(b, x, y), x, x), x),
    "select a, true, false -> a; select a, false, true -> not a": lambda b, x, y: (
        b.select(less(b, x, y), truth(b, False), truth(b, True)),
        b.apply("not", less(b, x, y)),
    ),
}


def zero(b):
    return b.constant(0, F32)


def truth(b, value):
    return b.constant(value, bool)


def less(b, x, y):
    return b.apply("lt", x, y)


@pytest.mark.parametrize("rule", [rule.name for rules in RULES.values() for rule in rules])
def test_rewrite_rule(rule):
    builder = Builder()
    got, expected = CASES[rule](builder, *builder.argument((2,), F32))
    assert got is expected
    without = {op: [each for each in rules if each.name != rule] for op, rules in RULES.items()}
    builder = Builder(without)
    got, expected = CASES[rule](builder, *builder.argument((2,), F32))
    assert got is not expected


def test_constants_fold_and_equal_operations_merge():
    builder = Builder()
    x, y = builder.argument((2,), F32)
    assert builder.add(builder.constant(2, F32), builder.constant(1, F32)).value == 3
    assert builder.add(x, y) is builder.add(y, x)


# Eliminate dead code, schedule.


def test_unused_operations_are_removed():
    graph = graph_of(lambda b, x, y, z: (b.add(x, y), b.multiply(y, z))[0])
    assert ops(graph) == ["add", "mul"]
    assert ops(eliminate_dead_code(graph)) == ["add"]
    assert len(eliminate_dead_code(graph).nodes) == 3


def test_too_many_operations_raise(monkeypatch):
    monkeypatch.setattr(machine_constants, "MOST_OPERATIONS", 2)
    with pytest.raises(Unsupported, match="more than 2 operations"):
        check_size(graph_of(lambda b, x, y, z: b.add(x, b.multiply(y, z))))


def test_schedule_computes_operands_shortly_before_their_use():
    def make(b, x, y, z):
        early = b.apply("sqrt", x)
        other = b.apply("sqrt", b.multiply(y, z))
        return b.add(b.multiply(other, other), early)

    graph = graph_of(make)
    (run,) = schedule(graph).runs[graph.top]
    assert ops(graph) == ["sqrt", "mul", "sqrt", "mul", "add"]
    assert [node.op for node in run.nodes] == ["mul", "sqrt", "mul", "sqrt", "add"]


# Rewrite, verify, show.


def test_rewrite_makes_new_users_and_keeps_the_old():
    graph = graph_of(lambda b, x, y, z: b.negate(b.add(x, y)))
    x, _, z, total, negative = graph.nodes
    new = rewrite(graph, {total: Change("sub", (x, z), total.number)})
    (root,) = new.result_nodes
    assert negative.operands == (total,) and total.op == "add"
    assert root is not negative and root.operands[0].op == "sub"
    assert root.operands[0].operands == (x, z)


def broken(graph, place, **changes):
    nodes = list(graph.nodes)
    nodes[place] = dataclasses.replace(nodes[place], **changes)
    return dataclasses.replace(graph, nodes=nodes)


def test_verifier_finds_invalid_nodes():
    graph = graph_of(lambda b, x, y, z: b.select(less(b, x, y), x, b.multiply(y, z)))
    verify(graph)
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
        with pytest.raises(InvalidGraph, match=message):
            verify(broken(graph, place, **changes))
    with pytest.raises(InvalidGraph, match="cannot be a result"):
        verify(dataclasses.replace(graph, nodes=graph.nodes[:-1]))
    scheduled = schedule(graph)
    runs = {graph.top: [run._replace(nodes=run.nodes[::-1]) for run in scheduled.runs[graph.top]]}
    with pytest.raises(InvalidGraph, match="which is scheduled later or never"):
        verify(dataclasses.replace(scheduled, runs=runs))
    for kept in (slice(1, None), slice(0, 2)):
        runs = {
            graph.top: [run._replace(nodes=run.nodes[kept]) for run in scheduled.runs[graph.top]]
        }
        with pytest.raises(InvalidGraph, match="which is scheduled later or never"):
            verify(dataclasses.replace(scheduled, runs=runs))
    twice = {graph.top: [run for run in scheduled.runs[graph.top] for _ in range(2)]}
    with pytest.raises(InvalidGraph, match="or twice"):
        verify(dataclasses.replace(scheduled, runs=twice))


def test_verifier_looks_behind_opaque_nodes():
    def make(b, x, y, z):
        return b.negate(b.opaque(b.add(x, y)))

    graph = schedule(graph_of(make))
    verify(graph)
    (run,) = graph.runs[graph.top]
    without = dataclasses.replace(graph, runs={graph.top: [run._replace(nodes=run.nodes[1:])]})
    with pytest.raises(InvalidGraph, match="which is scheduled later or never"):
        verify(without)
    total = next(node for node in graph.nodes if node.op == "add")
    nodes = [node for node in graph.nodes if node is not total]
    with pytest.raises(InvalidGraph, match="before it is made"):
        verify(dataclasses.replace(graph, nodes=nodes))


def test_invalid_graph_names_the_pass(monkeypatch):
    def forget(graph):
        return dataclasses.replace(graph, nodes=graph.nodes[1:])

    with pytest.raises(InvalidGraph, match=r"forget: .* before it is made"):
        optimize(traced(), [forget])
    monkeypatch.delenv("EVO_CPG_VERIFY_PASSES")
    optimize(traced(), [forget])


def test_verifier_finds_invalid_loops():
    graph = optimize(traced(), PASSES[:2])
    verify(graph)
    (loop, *_) = [node for node in graph.nodes if node.op == "loop"]
    place = graph.nodes.index(loop)
    inner_nodes = [node for node in graph.nodes if node.block is loop.detail.body]
    inner = inner_nodes[-1]
    detail = loop.detail
    carried = graph.kept[loop][0]
    other = next(node for node in inner_nodes if node.dtype != loop.operands[carried].dtype)
    following = [*detail.following]
    following[carried] = other
    for changes, message in (
        ({"count": None}, "number of rounds or a condition"),
        ({"test": detail.body}, "in another block"),
        ({"following": tuple(following)}, "different types"),
    ):
        one = dataclasses.replace(loop, detail=detail._replace(**changes))
        nodes = [*graph.nodes[:place], one, *graph.nodes[place + 1 :]]
        loops = {block: one if each is loop else each for block, each in graph.loops.items()}
        wrong = dataclasses.replace(graph, nodes=nodes, loops=loops, kept={one: graph.kept[loop]})
        with pytest.raises(InvalidGraph, match=message):
            verify(wrong)
    outside = Node("neg", (inner,), inner.dtype, graph.top, False, graph.nodes[-1].number + 1)
    with pytest.raises(InvalidGraph, match="computed in another block"):
        verify(dataclasses.replace(graph, nodes=[*graph.nodes, outside]))


def test_program_is_printed_after_each_pass(monkeypatch, capsys):
    optimize(traced(lambda x: x[0] * x[1] + x[2]))
    assert not capsys.readouterr().err
    monkeypatch.setenv("EVO_CPG_SHOW_PASSES", "1")
    optimize(traced(lambda x: x[0] * x[1] + x[2]))
    lowered, *_, scheduled = capsys.readouterr().err.split("--- ")[1:]
    assert lowered.startswith("lower\nargument 0: float32[3]\n") and "mul" in lowered
    assert scheduled.splitlines()[-2:] == [
        "%8: float32 = fma %1, %2, %3",
        "result 0: float32[1] = %8",
    ]


def test_loops_are_printed_with_their_carry():
    text = show(optimize(traced()))
    for part in ("= repeat 4", "= while", "= branch", "carry", "next", "write"):
        assert part in text


# Allocate, print.


def steps_of(items):
    for item in items:
        if isinstance(item, Stretch):
            yield from (step for piece in item.pieces for step in piece.steps)
        elif isinstance(item, LoopCode):
            yield from steps_of(item.test)
            yield from steps_of(item.body)


def test_allocation_names_every_value_once_and_before_its_use():
    code = allocate(optimize(traced()), WIDE)
    known, last = set(), 0
    for step in steps_of(code.items):
        assert step.first > last
        last = step.first + step.template.names - 1
        used = {each for each in step.operands if str(each).startswith("%v")}
        assert used <= known
        known |= {f"%v{k}" for k in range(step.first, last + 1)}
        assert len(step.template.text.splitlines()) == step.template.lines


def test_values_beyond_the_registers_go_to_memory():
    def make(b, *rows):
        roots = [b.apply("sqrt", row) for row in rows]
        return functools.reduce(b.add, [*roots, *(b.apply("abs", each) for each in roots[::-1])])

    graph = schedule(eliminate_dead_code(graph_of(make, rows=40)))
    few, many = (
        allocate(graph, WIDE._replace(target=TARGET._replace(registers=n))) for n in (8, 64)
    )
    assert few.frame > 0 and many.frame == 0


def test_carried_values_have_a_slot():
    def loop(x):
        return jax.lax.scan(lambda c, _: (c * x[0] + c[::-1], None), x, None, length=3)[0]

    code = allocate(optimize(traced(loop)), WIDE)
    (item,) = [each for each in code.items if isinstance(each, LoopCode)]
    assert item.loop.count == 3 and item.packed is None and not code.grouped
    # Three carried values and the input that every round reads, in full cache lines.
    assert code.size == 4 * machine_constants.CACHE_LINE


def test_printing_needs_no_graph():
    code = allocate(optimize(traced(lambda x: 3.0 * x[0])), WIDE)
    text, scratch = print_llvm(code)
    assert "fmul <8 x float>" in text and "define internal void @program(" in text
    assert scratch == 0
    assert print_llvm(code) == (text, scratch)
