"""The window into the back end: interpreter, faults that it finds, table, texts, wrong input."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from against_jax import plain, sample

from benchmarks import inspect_code as window
from benchmarks.code_interpreter import interpret
from benchmarks.code_parts import calls_of, parts_of
from benchmarks.graphs import show, verify
from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import load_config
from evo_cpg.io.shipped import find_config
from evo_cpg.native import compile, engine, machine_constants, passes
from evo_cpg.native.backend.allocate import Allocator
from evo_cpg.native.backend.select import Selector
from evo_cpg.native.backend.storage import Registers
from evo_cpg.native.frontend.builder import Builder
from evo_cpg.native.frontend.primitives import fused_p
from evo_cpg.native.frontend.simplify import RULES, RewriteRule
from evo_cpg.native.fuse import fuse, solve_symmetric
from evo_cpg.native.ir import Node

COUNT = 16
SMALL = ("iwadate2010_swimmer", "creature.bodies.1.repeat=1")


def traced(function, *args):
    """Return the program of a fused function."""
    jaxpr = jax.make_jaxpr(functools.partial(fuse, function, batch_ndim=1, name="trial"))(*args)
    (equation,) = [each for each in jaxpr.eqns if each.primitive is fused_p]
    return equation.params["program"]


def simulation_of(name, *overrides):
    path = find_config(name)
    return build_experiment(load_config(path, list(overrides)), path).simulation


# The interpreter.


def loops(x):
    """A list, a search, a branch and a look-up at an individual's own index."""

    def turn(carry, row):
        return 0.9 * carry + row * x[0], (carry[0], carry[1] * carry[2])

    end, (path, _) = jax.lax.scan(turn, x, jnp.arange(4.0), reverse=True)
    root = jax.lax.while_loop(lambda r: jnp.abs(r) > 0.5, lambda r: 0.4 * r, 9 * end[0])
    own = path[jnp.clip(jnp.abs(9 * root), 0, 3).astype(jnp.int32)]

    def far(y):
        for k in range(30):
            y = y + 0.1 * jnp.sin(y * (k + 1.0))
        return y

    return jax.lax.cond(root > 0.1, far, lambda y: -y, end), root, own


def sums(x):
    def turn(total, k):
        return total.at[k % 3].add(x[0] * k, mode="promise_in_bounds"), None

    return jax.lax.scan(turn, jnp.zeros(3, x.dtype) + x[1], jnp.arange(7))[0]


def whole_numbers(x):
    """Quotients by zero, shifts by all bits, conversions out of range, bits."""
    i = (x * 3).astype(jnp.int32)
    by = jnp.array([0, 31, 32], jnp.int32)
    shifted = i << by, i >> by, jax.lax.shift_right_logical(i, by)
    bits = jax.lax.bitcast_convert_type(x.astype(jnp.float32), jnp.int32)
    far = (x * 1e12).astype(jnp.int32), (-x).astype(jnp.uint8), bits
    return *shifted, *far, jax.lax.div(i, i[::-1]), jax.lax.rem(i, i[::-1]), i ^ ~i[::-1]


def equations(x):
    H = jnp.stack([x, x[::-1], 0.5 * x])
    return solve_symmetric(H @ H.T + 9 * jnp.eye(3), x)


@pytest.mark.parametrize("function", [loops, sums, whole_numbers, equations])
def test_interpreter_agrees_with_jax_after_every_pass(function, x64, monkeypatch):
    monkeypatch.setattr(machine_constants, "LONGEST_ELIMINATION", 0)
    x = sample((3, COUNT), dtype=float)
    expected = [each.reshape(-1, COUNT) for each in plain(function, x)]
    for _, graph in compile.stages(traced(function, x)):
        found = interpret(graph, [np.asarray(x)])
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12, strict=True)


# Faults.


def nested(x):
    """A loop over a part with a part, and a part with a search."""

    def waves(x):
        y = jnp.sin(x) * x[::-1] + x * x[1] - 0.3 * x[2] / (2 + x * x)
        return jax.lax.scan(lambda c, k: (0.5 * c + k * y, None), y, jnp.arange(3.0))[0]

    def halved(x):
        return jax.lax.while_loop(lambda r: jnp.abs(r) > 0.3, lambda r: 0.4 * r - 0.01, x[0])

    def step(x, k):
        y = fuse(waves, x, batch_ndim=0, name="waves")
        return y - 0.1 * x * x + k, fuse(halved, y, batch_ndim=0, name="search")

    def turn(x, k):
        return fuse(functools.partial(step, k=k), x, batch_ndim=0, name="step")

    return jax.lax.scan(turn, x, jnp.arange(2.0))


def of(name, part):
    return name.split("/")[0] == part


def plant_in_simplify(patch, part):
    def wrong(builder, x, y):
        return builder.make("add", (x, y), x.dtype) if of(builder.part, part) else None

    patch.setitem(RULES, "sub", (RewriteRule("x - y -> x + y", wrong), *RULES["sub"]))


def plant_in_contract(patch, part):
    @functools.wraps(passes.contract_multiply_adds)
    def faulty(graph):
        """Subtract where a multiply-add should add."""
        graph = passes.contract_multiply_adds(graph)
        wrong = {
            node: passes.Replacement("fms", node.operands, node.number)
            for node in graph.nodes
            if node.op == "fma" and of(node.part, part)
        }
        return passes.rewrite(graph, wrong)

    patch.setattr(compile, "PASSES", (faulty, *compile.PASSES[1:]))


def plant_in_dead_code(patch, part):
    @functools.wraps(passes.eliminate_dead_code)
    def faulty(graph):
        """Remove a product that is needed."""
        graph = passes.eliminate_dead_code(graph)
        needed = [node for node in graph.nodes if node.op == "mul" and of(node.part, part)]
        kept = [node for node in graph.nodes if node not in needed[-1:]]
        return dataclasses.replace(graph, nodes=kept)

    patch.setattr(compile, "PASSES", (compile.PASSES[0], faulty, *compile.PASSES[2:]))


def plant_in_schedule(patch, part):
    @functools.wraps(passes.schedule)
    def faulty(graph):
        """Compute the operations of the part in the reverse order."""
        graph, runs = passes.schedule(graph), {}
        for block, each in graph.runs.items():
            runs[block] = []
            for run in each:
                own = [node for node in run.nodes if of(node.part, part)]
                reverse = {node: own[~k] for k, node in enumerate(own)}
                nodes = [reverse.get(node, node) for node in run.nodes]
                runs[block].append(run._replace(nodes=nodes))
        return dataclasses.replace(graph, runs=runs)

    patch.setattr(compile, "PASSES", (*compile.PASSES[:3], faulty))


def plant_in_allocate(patch, part):
    compute = Allocator._operation

    def faulty(self, node):
        """Take an operand's register for the register of a sum or a quotient."""
        compute(self, node)
        if node.op in ("add", "div") and not node.uniform and of(node.part, part):
            self.registers.names[node, True] = self._ref(node.operands[-1])

    patch.setattr(Allocator, "_operation", faulty)


def plant_in_select(patch, part):
    select = Selector.operation

    def faulty(self, node):
        wrong = node.op == "mul" and of(node.part, part)
        return select(self, dataclasses.replace(node, op="sub") if wrong else node)

    patch.setattr(Selector, "operation", faulty)


FAULTS = {
    plant_in_simplify: "lower",
    plant_in_contract: "contract_multiply_adds",
    plant_in_dead_code: "eliminate_dead_code",
    plant_in_schedule: "schedule",
    plant_in_allocate: "machine code",
    plant_in_select: "machine code",
}


def first_fault(record):
    wrong = [(name, stage) for name, _, stage in window.verdicts(record) if stage]
    return (wrong[0][0], wrong[0][1].split(" (")[0]) if wrong else None


def test_parts_agree_with_jax(x64):
    x = sample((3, COUNT), dtype=float)
    record = calls_of(traced(nested, x), [x])
    names = [(part.name, part.depth, part.calls) for part, _ in record]
    assert names == [("trial", 0, 1), ("step", 1, 2), ("waves", 2, 2), ("search", 2, 2)]
    assert first_fault(record) is None
    *lines, last = window.report(window.verdicts(record))
    assert len(lines) == 4 and last == "Every checked part agrees with plain JAX."


@pytest.mark.parametrize("plant", FAULTS)
def test_fault_is_found_in_its_part_and_pass(plant, x64, monkeypatch):
    x = sample((3, COUNT), dtype=float)
    record = calls_of(traced(nested, x), [x])
    # The interpreter must find the fault, not the verifier.
    monkeypatch.setattr(compile, "stages", compile.stages.__wrapped__)
    plant(monkeypatch, "waves")
    assert first_fault(record) == ("waves", FAULTS[plant])
    *_, last = window.report(window.verdicts(record))
    assert last.startswith(f"The first fault is in waves, after {FAULTS[plant]}")


@pytest.mark.slow
def test_faults_of_a_swimmer_are_found(x64):
    simulation = dataclasses.replace(simulation_of(*SMALL), steps=2)
    record = calls_of(*window.trial_of(simulation, COUNT, np.float64))
    assert first_fault(record) is None
    for plant, stage in FAULTS.items():
        for part in ("oscillators", "a physics step"):
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(compile, "stages", compile.stages.__wrapped__)
                plant(patch, part)
                assert first_fault(record) == (part, stage)


# The passes.


def test_passes_in_a_wrong_order_are_refused():
    program = traced(lambda x: x[0] * x[1] + x[2], sample((3, COUNT)))
    contract, remove, _, schedule = passes.PASSES
    for order in ([remove, contract], [schedule, contract], [schedule, remove]):
        with pytest.raises(passes.WrongOrder):
            compile.optimize(program, order)


def test_a_pass_inserts_nodes():
    """Divide twice by one number with one division: x / y + z / y = x r + z r, r = 1 / y."""
    builder = Builder()
    builder.begin_part()
    x, y, z = builder.argument((3,), np.float32)
    one = builder.constant(1.0, np.float32)
    first, second = (builder.apply("div", each, y) for each in (x, z))
    total = builder.apply("add", first, second)
    builder.end_part((), [total])
    graph = builder.graph([np.array([total], object)])
    inverse = Node("div", (one, y), first.dtype, first.block, False, first.number - 0.5)
    multiplied = {
        node: passes.Replacement("mul", (node.operands[0], inverse), node.number)
        for node in (first, second)
    }
    found = verify(passes.rewrite(graph, multiplied, [inverse]))
    assert [node.op for node in found.nodes if node.op not in ("input", "constant")] == [
        "div", "mul", "mul", "add",
    ]  # fmt: skip
    given = [np.array([[3.0], [4.0], [5.0]], np.float32)]
    assert interpret(found, given)[0] == interpret(graph, given)[0] == 2


def test_registers_refuse_a_run_before_the_last_is_done():
    x, y = Builder().argument((2,), np.float32)
    registers = Registers(8)
    registers.expect([], [x, y])
    registers.pass_on()
    with pytest.raises(AssertionError, match="1 of 2 expected uses"):
        registers.expect([], [x])


# The command.


@pytest.mark.slow
def test_table_counts_every_operation_once():
    found, seconds = window.measured(simulation_of(*SMALL, "simulation.seconds=1"), engine.target())
    rows = {row.name: row for row in found}
    assert list(rows)[:2] == ["a trial", "BrainCpg.decode"] and "oscillators" in rows
    assert rows["a physics step/solve"].calls == rows["a physics step"].calls == 120
    program, _ = window.trial_of(simulation_of(*SMALL), 1, np.float32)
    assert sum(row.operations for row in found) == compile.optimize(program).operations
    for fractions in zip(*(row.fractions for row in found), strict=True):
        assert min(fractions) >= 0 and 0 < sum(fractions) < 1
    head, *lines = list(window.table(found, seconds))
    assert {"spills", "KiB", "%"} < set(head.split()) and len(lines) > len(found)


def test_texts_of_a_part_are_written(tmp_path):
    part = parts_of(traced(nested, sample((3, COUNT))))[2]
    files = list(window.write(part, engine.target(), tmp_path / "new"))
    texts = {path.name.removeprefix("waves-"): path.read_text() for path in files}
    assert "; waves" in texts["0-lower.txt"] and " fma " in texts["4-schedule.txt"]
    assert "define internal void @program" in texts["code.ll"] and "\tret" in texts["code.s"]


def test_nodes_are_printed_with_their_scope():
    def stages(x):
        with jax.named_scope("first"):
            y = x[0] + x[1]
        return y * x[2]

    lines = show(compile.optimize(traced(stages, sample((3, COUNT))), ())).splitlines()
    assert [line.split("; ")[1] for line in lines if "; " in line] == ["trial/first", "trial"]


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["iwadate2010_swimer"], "iwadate2010_swimmer"),
        (["iwadate2010_swimmer", "simulation.secnds=1"], "did you mean 'seconds'"),
        (["iwadate2010_swimmer", "engine=jax"], "engine is jax"),
        ([*SMALL, "--part=oscillators"], "--part needs --check or --write"),
        ([*SMALL, "--part=oscilators", "--write=texts"], "did you mean 'oscillators'"),
    ],
)
def test_wrong_input_is_one_line_and_exit_code_2(arguments, word, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert window.main(arguments) == 2
    found = capsys.readouterr()
    assert word in found.err and found.err.count("\n") == 1 and not found.out
    assert not list(tmp_path.iterdir())
