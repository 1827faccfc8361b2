"""Compile a JAX program for one individual to machine code for all individuals.

`docs/models/native.md` lists the passes, and says how to omit one. Lowering simplifies each
operation as it is made (`frontend.simplify`), because the place of a slice must be a known number.

`python -m benchmarks.inspect_code` measures the parts of a trial, writes and verifies the graph
after each pass, and finds the pass with a fault.
"""

import gc
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from evo_cpg.native.backend.allocate import Allocator
from evo_cpg.native.backend.code import Code, Variant
from evo_cpg.native.backend.llvm import Printer, print_handler
from evo_cpg.native.frontend.builder import Builder
from evo_cpg.native.frontend.lower import lower
from evo_cpg.native.frontend.primitives import Program
from evo_cpg.native.frontend.simplify import RULES, RewriteRule
from evo_cpg.native.ir import Graph
from evo_cpg.native.passes import PASSES, Pass

Rules = Mapping[str, Sequence[RewriteRule]]


class Module(NamedTuple):
    """A module of LLVM IR with a function ``@handler`` that XLA calls.

    Attributes:
        text: LLVM IR.
        scratch: bytes of working memory.
        operations: number of nodes of the graph that the module computes.
        code: the program with registers and places.
        ticks: parts of each number of the global ``@ticks``, if the code is timed.
    """

    text: str
    scratch: int
    operations: int
    code: Code
    ticks: Sequence[Mapping[str, int]]


def stages(
    program: Program, passes: Sequence[Pass] | None = None, rules: Rules = RULES
) -> Iterator[tuple[str, Graph]]:
    """Iterate over lowering and the passes from graph to graph: the name of each and its graph."""
    graph = lower(program, Builder(rules))
    yield "lower", graph
    for each in PASSES if passes is None else passes:
        graph = each(graph)
        yield each.__name__, graph


def optimize(program: Program, passes: Sequence[Pass] | None = None, rules: Rules = RULES) -> Graph:
    """Return the graph of a program after the passes from graph to graph (None for `PASSES`).

    Raises:
        Unsupported: if there is no rule for a part of the program, or the program is too large.
    """
    *_, (_, graph) = stages(program, passes, rules)
    return graph


def to_llvm(
    program: Program, variant: Variant, passes: Sequence[Pass] | None = None, rules: Rules = RULES
) -> Module:
    """Return LLVM IR of a program's code and of its entry function.

    Raises:
        Unsupported: if there is no rule for a part of the program, or the program is too large.
    """
    # Pause Python's garbage collector, which would take half of the time: the passes make a million
    # objects without reference cycles.
    collects = gc.isenabled()
    gc.disable()
    try:
        return module_of(optimize(program, passes, rules), variant)
    finally:
        if collects:
            gc.enable()


def module_of(graph: Graph, variant: Variant, timed: bool = False) -> Module:
    """Return LLVM IR of a graph's code, which measures itself if ``timed``, and of its entry."""
    code = Allocator(graph, variant).allocated()
    printer = Printer(code, timed)
    text, scratch = printer.text()
    flushes = variant.target.name != "neon"
    entry = print_handler(len(code.arguments), len(code.results), flushes)
    size = 8 * variant.target.bytes
    vector = f'"prefer-vector-width"="{size}" "min-legal-vector-width"="{size}"'
    text = f"{text}\n{entry}\nattributes #0 = {{ nounwind {vector} }}\n"
    return Module(text, scratch, graph.operations, code, printer.ticks)
