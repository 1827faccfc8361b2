"""Find out why a native program is slow or wrong: ``python -m benchmarks.inspect_code CONFIG``.

| option | output |
|---|---|
| none | a table of the trial's parts: operations, memory and time |
| ``--write FOLDER`` | graph of every part after each pass, its LLVM IR and its assembly |
| ``--check`` | the part and the pass after which results differ from plain JAX |
| ``--part NAME`` | write or check only one part |
"""

import argparse
import collections
import ctypes
import dataclasses
import itertools
import sys
import time
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.code_interpreter import interpret
from benchmarks.code_parts import Arrays, Call, TrialPart, calls_of, parts_of
from benchmarks.graphs import show, verifying
from evo_cpg.errors import UsageError, UserError, nearest
from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import load_config
from evo_cpg.io.shipped import find_config
from evo_cpg.native import compile, engine, machine_constants
from evo_cpg.native.backend.code import Target, Variant
from evo_cpg.native.backend.compiler_process import Request
from evo_cpg.native.backend.machine import address_of_ticks, load, object_code
from evo_cpg.native.frontend.primitives import Program, fused_p
from evo_cpg.native.ir import Unsupported
from evo_cpg.native.native import call_handler
from evo_cpg.simulation.noise import Noise
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.simulation import Simulation

# Control steps of a checked trial. An error grows by contact with every further step.
_CHECKED_STEPS = 4
# Individuals of a checked trial, at least two vectors.
_CHECKED = 16

TOLERANCE = 1e-9
"""Largest difference of correct results (see `difference`).

In float64 every operation rounds by 1e-16, and contact multiplies differences by thousands. A wrong
operation changes some number by far more.
"""


def trial_of(simulation: Simulation, count: int, dtype: Any) -> tuple[Program, Arrays]:
    """Return the program of a trial, which must be native, and its arguments for random genomes."""
    genes = simulation.genome.random(jax.random.key(0), (count,), dtype)
    keys = jax.random.key_data(jax.random.split(jax.random.key(1), count)).T
    given = genes, keys, jnp.arange(count, dtype=jnp.int32) % len(simulation.situations)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", engine.EngineWarning)
        jaxpr = jax.make_jaxpr(lambda *x: rollout(simulation, *x))(*given).jaxpr
    fused = [each for each in jaxpr.eqns if each.primitive is fused_p]
    if len(fused) != 1 or len(jaxpr.eqns) != 1:
        reasons = [str(each.message) for each in caught] or ["engine is jax"]
        raise UsageError(f"the trial is not one native program: {reasons[0]}")
    values = dict(zip(jaxpr.invars, map(np.asarray, given), strict=True))
    return fused[0].params["program"], [values[atom] for atom in fused[0].invars]


def _chosen(parts: list[TrialPart], name: str | None) -> list[TrialPart]:
    """Return the parts with a name, which must exist, or all parts for None."""
    if name is not None and all(part.name != name for part in parts):
        hint = nearest(name, [part.name for part in parts])
        raise UsageError(f"no part {name!r} (a row within a part is none): {hint}")
    return [part for part in parts if name in (None, part.name)]


# Time and memory.


class PartCost(NamedTuple):
    """A row of the table: the code of a part within the trial, without the code of inner parts.

    Attributes:
        name: name of the part, or of a `jax.named_scope` in it.
        depth: number of rows around it.
        calls: number of calls in a trial.
        spills: number of stores and loads of values that left their registers.
        scratch: memory for values that several stretches of code use, bytes per vector.
        fractions: fraction of the trial's time, for one vector and for a group of vectors.
    """

    name: str
    depth: int
    calls: int
    operations: int
    spills: int
    scratch: int
    fractions: tuple[float, ...]


def measured(simulation: Simulation, target: Target) -> tuple[list[PartCost], dict[int, float]]:
    """Return the rows of the table, and the time of the trial on one core.

    The time is in s per individual, by the number of individuals: a vector, and as many vectors as
    may run together. The code reads the processor's clock before and after each stretch without
    branches. The time of a stretch is divided among its parts by their numbers of instructions.
    """
    width = target.bytes // 4
    counts = width, width * machine_constants.VECTOR_GROUP
    program, inputs = trial_of(simulation, counts[1], np.float32)
    graph = compile.optimize(program)
    module = compile.module_of(graph, Variant(target, width), timed=True)
    every = (run for runs in graph.runs.values() for run in runs)
    origins = (node.part for run in every for node in (*run.nodes, *filter(None, [run.loop])))
    columns: list[dict[str, Any]] = [collections.Counter(origins)]
    columns += [dict(module.code.spills), dict(module.code.places)]
    seconds = {}
    for count in counts:
        elapsed, fractions = _clocked(module, program, [x[..., :count] for x in inputs], target)
        seconds[count] = elapsed / count
        columns.append(fractions)
    names = sorted({name for column in columns for name in column})
    rows = []
    for part in parts_of(program):
        for name in [part.name, *(each for each in names if each.startswith(f"{part.name}/"))]:
            # Code for no part moves the trial's arguments and results. If two parts have one name,
            # the first row has the numbers of both.
            merged = (name, "") if name == program.name else (name,)
            count, spills, scratch, *own = (sum(x.pop(y, 0) for y in merged) for x in columns)
            depth = part.depth + name.count("/")
            rows.append(PartCost(name, depth, part.calls, count, spills, scratch, (*own,)))
    return rows, seconds


def _clocked(
    module: compile.Module, program: Program, inputs: Arrays, target: Target
) -> tuple[float, dict[str, float]]:
    """Return the time of the fastest of three calls, s, and the fraction of each part."""
    name, address = load(module.text, target)
    kind = ctypes.c_int64 * len(module.ticks)
    ticks = np.ctypeslib.as_array(kind.from_address(address_of_ticks(name)))
    count, handler, calls = inputs[0].shape[-1], engine.register(name, address), []
    run = jax.jit(lambda *x: call_handler(handler, x, program.outputs, count, module.scratch))
    given = [jnp.asarray(x.reshape(-1, count)) for x in inputs]
    for _ in range(3):
        ticks[:] = 0
        start = time.perf_counter()
        jax.block_until_ready(run(*given))
        calls.append((time.perf_counter() - start, *ticks))
    elapsed, whole, *own = min(calls)
    found: dict[str, float] = collections.defaultdict(float)
    for lines, each in zip(module.ticks[1:], own, strict=True):
        for part, number in lines.items():
            found[part] += each / whole * number / sum(lines.values())
    return elapsed, found


def table(rows: Sequence[PartCost], seconds: Mapping[int, float]) -> Iterator[str]:
    """Iterate over the lines of the table as text."""
    times = [f"ns, {count}" for count in seconds]
    head = ["calls", "operations", "spills", "KiB", *times, "%", "% in all"]
    cells = [("part", head)]
    for k, (name, depth, *sizes, scratch, fractions) in enumerate(rows):
        inner = itertools.takewhile(lambda each, depth=depth: each.depth > depth, rows[k + 1 :])
        whole = fractions[1] + sum(each.fractions[1] for each in inner)
        own = [1e9 * s * t / sizes[0] for s, t in zip(fractions, seconds.values(), strict=True)]
        numbers = [f"{x:,.0f}" for x in (*sizes, scratch / 1024, *own)]
        percent = [f"{100 * x:.1f}" for x in (fractions[1], whole)]
        cells.append(("  " * depth + name.rpartition("/")[2], [*numbers, *percent]))
    rest = 1 - sum(row.fractions[1] for row in rows)
    cells.append(("between the parts", [*[""] * 6, f"{100 * rest:.1f}"]))
    longest = max(len(name) for name, _ in cells)
    yield from (f"{name:{longest}}" + "".join(f"{x:>11}" for x in row) for name, row in cells)
    whole = " and ".join(f"{1e6 * each:,.0f} us with {n}" for n, each in seconds.items())
    yield (
        f"\nA trial of an individual takes {whole} individuals on one core.\n"
        "Numbers are without inner parts, times per call and individual. Between the parts are\n"
        "calls, loops, and the packing of individuals in searches."
    )


# Text of the passes.


def write(part: TrialPart, target: Target, folder: Path) -> Iterator[Path]:
    """Write the graph of a part after each pass, its LLVM IR and its assembly. Return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    graphs = [*verifying(compile.stages)(part.program)]
    texts = {f"{k}-{stage}.txt": show(graph) for k, (stage, graph) in enumerate(graphs)}
    code = compile.module_of(graphs[-1][1], Variant(target, target.bytes // 4)).text
    effort = machine_constants.LLVM_EFFORT
    request = Request(code, target.processor, target.features, effort, assembly=True)
    texts |= {"code.ll": code, "code.s": object_code(request).decode()}
    for name, text in texts.items():
        path = folder / f"{part.name.replace(' ', '-')}-{name}"
        path.write_text(f"{text}\n", encoding="utf-8")
        yield path


# Faults.


# Name of a part, largest `difference` from plain JAX, and the pass that causes it or "".
Verdict = tuple[str, float, str]


def checked(simulation: Simulation, name: str | None = None) -> Iterator[Verdict]:
    """Iterate over the agreement of a trial's parts with plain JAX, inner parts first.

    Arrays are float64, so JAX must allow it. The trial is short and has no noise, because random
    numbers are float32 in any case.
    """
    simulation = dataclasses.replace(simulation, steps=_CHECKED_STEPS, noise=Noise())
    program, inputs = trial_of(simulation, _CHECKED, np.float64)
    names = [part.name for part in _chosen(parts_of(program), name)]
    yield from verdicts(each for each in calls_of(program, inputs) if each[0].name in names)


def verdicts(calls: Iterable[tuple[TrialPart, Call]]) -> Iterator[Verdict]:
    """Iterate over the agreement of parts with calls by plain JAX, inner parts first."""
    for part, call in sorted(calls, key=lambda each: -each[0].depth):
        yield part.name, *_verdict(part.program, call)


def _verdict(program: Program, call: Call) -> tuple[float, str]:
    """Compare a program after every pass, and its machine code, with a call by plain JAX."""
    given, expected = ([x.reshape(-1, x.shape[-1]) for x in each if x.size] for each in call)
    worst, stage, graph, stages = 0.0, "", None, compile.stages(program)
    try:
        for stage in ("lower", *(each.__name__ for each in compile.PASSES)):
            before, (_, graph) = graph, next(stages)
            if graph is not before:
                worst = max(worst, difference(interpret(graph, given), expected))
            if worst > TOLERANCE:
                return worst, stage
        stage = "machine code"
        worst = max(worst, difference(_by_machine_code(program, call[0]), call[1]))
    except Exception as error:
        return np.inf, f"{stage} ({type(error).__name__}: {error})"
    return worst, stage if worst > TOLERANCE else ""


def _by_machine_code(program: Program, inputs: Arrays) -> Arrays:
    # A new program, because the code of a known one is kept.
    params = {"program": dataclasses.replace(program), "batch": inputs[0].shape[-1:]}
    with warnings.catch_warnings():
        warnings.simplefilter("error", engine.EngineWarning)
        return [*map(np.asarray, jax.jit(lambda *x: fused_p.bind(*x, **params))(*inputs))]


@np.errstate(invalid="ignore")
def difference(found: Arrays, expected: Arrays) -> float:
    """Return the largest difference of a number, relative to the largest number of its array.

    It is absolute in an array of numbers below 1, because some are only roundings, such as the
    residual of solved equations. It is infinite if a number is finite in only one of the arrays.
    """
    worst = 0.0
    for one, other in zip(found, expected, strict=True):
        one, other = one.astype(float), other.astype(float)
        same = (one == other) | (np.isnan(one) & np.isnan(other))
        apart = np.where(same, 0.0, np.abs(one - other)).max(initial=0.0)
        scaled = float(apart / np.abs(other[np.isfinite(other)]).max(initial=1.0))
        worst = max(worst, np.inf if np.isnan(scaled) else scaled)
    return worst


def report(verdicts: Iterator[Verdict]) -> Iterator[str]:
    """Iterate over a line for each part, and a last line that names the first wrong part."""
    last = "Every checked part agrees with plain JAX."
    for name, apart, stage in verdicts:
        yield f"{name}: {f'differs after {stage}, by' if stage else 'agrees to'} {apart:.0e}"
        if stage and last.startswith("Every"):
            last = f"The first fault is in {name}, after {stage}."
    yield last


# The command.


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command, and return its exit code: 1 if a part is wrong, 2 for a wrong argument."""
    parser = argparse.ArgumentParser("python -m benchmarks.inspect_code")
    parser.add_argument("config", metavar="CONFIG")
    parser.add_argument("overrides", nargs="*", metavar="KEY=VALUE")
    parser.add_argument("--part", metavar="NAME", help="write or check only this part")
    texts = "write the graph after each pass, the LLVM IR and the assembly of every part"
    parser.add_argument("--write", type=Path, metavar="FOLDER", help=texts)
    faults = "find the part and the pass after which results differ from plain JAX"
    parser.add_argument("--check", action="store_true", help=faults)
    options = parser.parse_args(arguments)
    jax.config.update("jax_platforms", "cpu")
    last = ""
    try:
        for last in _lines(options):
            print(last, flush=True)
    except (UserError, Unsupported, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return int(last.startswith("The first fault"))


def _lines(options: argparse.Namespace) -> Iterator[str]:
    if options.part and not options.check and options.write is None:
        raise UsageError("--part needs --check or --write")
    path = find_config(options.config)
    simulation = build_experiment(load_config(path, options.overrides), path).simulation
    with engine.using(simulation.engine):
        target = engine.target()
        if options.check:
            with jax.enable_x64(True):
                yield from report(checked(simulation, options.part))
        elif options.write is not None:
            program, _ = trial_of(simulation, 1, np.float32)
            for part in _chosen(parts_of(program), options.part):
                yield from map(str, write(part, target, options.write))
        else:
            yield from table(*measured(simulation, target))


if __name__ == "__main__":
    raise SystemExit(main())
