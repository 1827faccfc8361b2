"""The parts of a trial, with arguments as they occur in it.

A trial is a program with parts: control steps, and within them sensors, controller and physics
(`evo_cpg.native.fuse`). Plain JAX computes the trial part by part, and what it passes to each part
is noted. A part can then be computed alone with realistic numbers. Zeros would not do, because the
rounds of loops depend on the numbers.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, jaxpr_as_fun

from evo_cpg.native import jax_internals as internals
from evo_cpg.native.frontend.primitives import Program, equations, fused_p

Arrays = list[np.ndarray]

# Arguments and results of a part, with individuals on the last axes.
Call = tuple[Arrays, Arrays]


class TrialPart(NamedTuple):
    """A part of a trial.

    Attributes:
        name: name of its program.
        program: its program.
        depth: number of parts around it.
        calls: number of calls in a trial.
    """

    name: str
    program: Program
    depth: int
    calls: int


def parts_of(program: Program) -> list[TrialPart]:
    """Return a program and its parts in the order of their calls, outer parts first.

    Parts within branches and searches are not among them, because only some individuals run these.
    """

    def within(jaxpr: Jaxpr, depth: int, calls: int) -> Iterator[TrialPart]:
        for equation in filter(_holds_parts, jaxpr.eqns):
            params = equation.params
            if equation.primitive is fused_p:
                inner, count = params["program"], calls * int(np.prod(params["batch"], dtype=int))
                yield TrialPart(inner.name, inner, depth, count)
                yield from within(inner.jaxpr, depth + 1, count)
            else:
                yield from within(params["jaxpr"].jaxpr, depth, calls * params["length"])

    return [TrialPart(program.name, program, 0, 1), *within(program.jaxpr, 1, 1)]


def _holds_parts(equation: Any) -> bool:
    """Return whether an equation is a part or a loop over parts."""
    inner = equations(equation.params["jaxpr"].jaxpr) if equation.primitive.name == "scan" else ()
    return any(each.primitive is fused_p for each in (equation, *inner))


def calls_of(program: Program, inputs: Arrays) -> list[tuple[TrialPart, Call]]:
    """Return a program and its parts, each with its last call, by plain JAX."""
    recorder = _Recorder()
    recorder.part(program, inputs)
    calls = zip(parts_of(program), recorder.calls.values(), strict=True)
    return [(part._replace(program=own), call) for part, (own, call) in calls]


class _Recorder:
    """Computes a program part by part for some individuals, by plain JAX.

    JAX compiles the parts without inner parts. The results of an outer part follow from the results
    of its inner parts. ``calls`` are in the order of `parts_of`.
    """

    def __init__(self):
        self._traced: dict[int, tuple[ClosedJaxpr, Any]] = {}
        self.calls: dict[int, Any] = {}

    def part(self, program: Program, inputs: Sequence[Any], key: int = 0) -> Sequence[Any]:
        """Return the results of a part, which an equation of the number ``key`` calls."""
        # An outer part has its place before its inner parts.
        self.calls.setdefault(key)
        if key not in self._traced:
            closed = jax.make_jaxpr(program)(*inputs)
            self._traced[key] = closed, internals.quick_jit(jaxpr_as_fun(closed))
        closed, compiled = self._traced[key]
        is_outer = any(map(_holds_parts, closed.jaxpr.eqns))
        results = self._equations(closed, inputs) if is_outer else compiled(*inputs)
        call = [*map(np.asarray, inputs)], [*map(np.asarray, results)]
        self.calls[key] = program, call
        return results

    def _equations(self, closed: ClosedJaxpr, inputs: Sequence[Any]) -> list[Any]:
        """Return the results of a JAX program."""
        jaxpr = closed.jaxpr
        known = dict(zip(jaxpr.constvars, closed.consts, strict=True))
        known |= zip(jaxpr.invars, inputs, strict=True)

        def read(atom: Any) -> Any:
            return np.asarray(atom.val) if isinstance(atom, Literal) else known[atom]

        for equation in jaxpr.eqns:
            params, operands = equation.params, [read(atom) for atom in equation.invars]
            if equation.primitive is fused_p:
                found = self.part(params["program"], operands, id(equation))
            elif _holds_parts(equation):
                found = self._scan(params, operands)
            else:
                used, run = internals.alone(jaxpr, equation)
                found = run(*[known[atom] for atom in used])
            known |= zip(equation.outvars, found, strict=True)
        return [read(atom) for atom in jaxpr.outvars]

    def _scan(self, params: dict, operands: list[Any]) -> list[Any]:
        """Run a counted loop over parts."""
        constant_count, carry_count = internals.scan_counts(params)
        fixed, carry = operands[:constant_count], operands[constant_count:][:carry_count]
        read, stacked = operands[constant_count + carry_count :], []
        step = -1 if params["reverse"] else 1
        for k in range(params["length"])[::step]:
            given = [*fixed, *carry, *(x[k] for x in read)]
            found = self._equations(params["jaxpr"], given)
            carry = found[:carry_count]
            stacked.append(found[carry_count:])
        return [*carry, *map(np.stack, zip(*stacked[::step], strict=True))]
