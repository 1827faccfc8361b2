"""Compile a JAX program for one individual to machine code for all individuals.

| pass | from | to | file |
|---|---|---|---|
| lower | JAX program | graph of scalars | `frontend.lower` |
| contract multiply-adds | graph | graph | `passes.contract` |
| eliminate dead code | graph | graph | `passes.dead_code` |
| check size | graph | the same graph | here |
| schedule | graph | graph | `passes.schedule` |
| allocate | graph | code with registers and places | `backend.allocate` |
| print | code | LLVM IR | `backend.llvm`, `backend.handler` |
| compile | LLVM IR | machine code in memory | `backend.machine` |

Lowering simplifies each operation as it is made (`frontend.simplify`). Simplification is not a
separate pass, because lowering depends on it: the place of a slice must be a known number.

Passes from graph to graph and rewrite rules are optional (`PASSES`, `RULES`). Without them the
program takes more operations and computes the same. Only sums round differently without
multiply-adds.

| environment variable | after each pass |
|---|---|
| ``EVO_CPG_SHOW_PASSES`` | the graph is printed to standard error (`ir.show`) |
| ``EVO_CPG_VERIFY_PASSES`` | the graph is checked (`ir.verify`), as in the tests of native code |
"""

import contextlib
import gc
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

from evo_cpg.native import machine_constants
from evo_cpg.native.backend.allocate import allocate
from evo_cpg.native.backend.code import Variant
from evo_cpg.native.backend.handler import handler
from evo_cpg.native.backend.llvm import print_llvm
from evo_cpg.native.frontend.builder import Builder
from evo_cpg.native.frontend.lower import lower
from evo_cpg.native.frontend.primitives import Program
from evo_cpg.native.frontend.simplify import RULES, Rule
from evo_cpg.native.ir.graph import Graph
from evo_cpg.native.ir.show import show
from evo_cpg.native.ir.verify import InvalidGraph, verify
from evo_cpg.native.passes.contract import contract_multiply_adds
from evo_cpg.native.passes.dead_code import eliminate_dead_code
from evo_cpg.native.passes.schedule import schedule
from evo_cpg.native.unsupported import Unsupported

Pass = Callable[[Graph], Graph]
Rules = Mapping[str, Sequence[Rule]]


def check_size(graph: Graph) -> Graph:
    """Return the graph if it is small enough.

    Raises:
        Unsupported: there are more operations than `MOST_OPERATIONS`.
    """
    if len(graph.nodes) > machine_constants.MOST_OPERATIONS:
        most = machine_constants.MOST_OPERATIONS
        raise Unsupported(f"the program has more than {most} operations")
    return graph


PASSES: tuple[Pass, ...] = (contract_multiply_adds, eliminate_dead_code, check_size, schedule)
"""Passes from graph to graph, in order."""


class Module(NamedTuple):
    """A module of LLVM IR with a function ``@handler`` that XLA calls.

    Attributes:
        text: LLVM IR.
        scratch: bytes of working memory.
        operations: number of nodes of the graph that the module computes.
    """

    text: str
    scratch: int
    operations: int


def optimize(program: Program, passes: Sequence[Pass] | None = None, rules: Rules = RULES) -> Graph:
    """Return the graph of a program after the passes from graph to graph.

    Args:
        program: program for one individual.
        passes: functions from graph to graph, or None for `PASSES`.
        rules: rewrite rules by operation.

    Raises:
        Unsupported: there is no rule for a part of the program, or the program is too large.
    """
    graph = lower(program, Builder(rules))
    _inspect("lower", graph)
    for each in PASSES if passes is None else passes:
        graph = each(graph)
        _inspect(each.__name__, graph)
    return graph


def to_llvm(
    program: Program,
    variant: Variant,
    passes: Sequence[Pass] | None = None,
    rules: Rules = RULES,
) -> Module:
    """Return LLVM IR of a program's code and of its entry function.

    Args:
        program: program for one individual.
        variant: the machine and the kind of code.
        passes: functions from graph to graph, or None for `PASSES`.
        rules: rewrite rules by operation.

    Raises:
        Unsupported: there is no rule for a part of the program, or the program is too large.
    """
    with _without_collector():
        graph = optimize(program, passes, rules)
        code = allocate(graph, variant)
        text, scratch = print_llvm(code)
    entry = handler("handler", len(code.arguments), len(code.results))
    size = 8 * variant.target.bytes
    vector = f'"prefer-vector-width"="{size}" "min-legal-vector-width"="{size}"'
    text = f"{text}\n{entry}\nattributes #0 = {{ nounwind {vector} }}\n"
    return Module(text, scratch, graph.operations)


@contextlib.contextmanager
def _without_collector() -> Iterator[None]:
    """Pause Python's garbage collector: the passes make a million objects without reference cycles.

    The collector would take half of the time of the passes.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _inspect(name: str, graph: Graph) -> None:
    """Print and verify the graph that a pass has made, if the environment variables are set."""
    if os.environ.get("EVO_CPG_SHOW_PASSES"):
        print(f"--- {name}", show(graph), sep="\n", file=sys.stderr)
    if os.environ.get("EVO_CPG_VERIFY_PASSES"):
        try:
            verify(graph)
        except InvalidGraph as error:
            raise InvalidGraph(f"{name}: {error}") from None
