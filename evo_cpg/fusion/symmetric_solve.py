"""Symmetric positive definite equations: written out where that is short, else solved in a loop.

Written out, elements that are zero cost nothing (`evo_cpg.spatial.ldl`). But an animal whose limbs
may all meet has no zeros, and elimination then takes v^3/6 operations for v unknowns. Beyond some
thousands native code calls a function that loops. It eliminates in the same order, and leaves out
what is zero for all individuals of a vector, such as the coupling of limbs that do not touch.
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr
from jaxtyping import Array, Float

from evo_cpg.fusion import jax_internals as internals
from evo_cpg.fusion import machine_constants
from evo_cpg.fusion.graph import Graph
from evo_cpg.spatial.ldl import factorize, solve_factorized


def solve_symmetric(H: Float[Array, "v v *n"], b: Float[Array, "v *n"]) -> Float[Array, "v *n"]:
    """``H^-1 b``, whose derivative is the answer to further such equations."""

    def product(x: Array) -> Array:
        return (H * x[None]).sum(1)

    def answer(_: object, b: Array) -> Array:
        return eliminate_p.bind(H, b)[0]

    return jax.lax.custom_linear_solve(product, b, answer, symmetric=True)


def _evaluate(H: Array, b: Array) -> list[Array]:
    return [solve_factorized(factorize(H), b)]


def _batch(values: tuple[Array, Array], axes: tuple[int | None, int | None]) -> tuple:
    """Put the mapped axis last, where individuals are."""
    size = next(x.shape[k] for x, k in zip(values, axes, strict=True) if k is not None)
    H, b = (
        jnp.broadcast_to(x[..., None], (*x.shape, size)) if k is None else jnp.moveaxis(x, k, -1)
        for x, k in zip(values, axes, strict=True)
    )
    return eliminate_p.bind(H, b), [b.ndim - 1]


def _differentiate(primals: tuple, tangents: tuple) -> tuple:
    given = [internals.instantiate_zeros(tangent) for tangent in tangents]
    return jax.jvp(_evaluate, list(primals), given)


eliminate_p = internals.primitive(
    "eliminate",
    lambda H, b: [jax.ShapeDtypeStruct(b.shape, b.dtype)],
    _evaluate,
    _differentiate,
    _batch,
)


def elimination_of(avals: Sequence[Any]) -> ClosedJaxpr:
    """The elimination as a program that is written out, for arguments of some shapes."""
    return jax.make_jaxpr(_evaluate)(*avals)


def elimination_cost(filled: np.ndarray) -> int:
    """Count the products of an elimination from the last unknown to the first.

    Args:
        filled: ``(v, v)``, where the matrix is not zero.
    """
    filled, total = filled.copy(), 0
    for k in reversed(range(len(filled))):
        (used,) = np.nonzero(filled[k, :k])
        total += len(used) * (len(used) + 1) // 2
        filled[np.ix_(used, used)] = True
    return total


def eliminate(graph: Graph, operands: list[np.ndarray]) -> np.ndarray | None:
    """Make the answers by a loop; return None where writing them out is better.

    Args:
        graph: where nodes are made.
        operands: H and b of one individual.
    """
    H, b = operands
    if H.ndim != 2:
        return None
    filled = np.vectorize(lambda node: node.value is None or node.value != 0, otypes=[bool])(H)
    if elimination_cost(filled) <= machine_constants.LONGEST_ELIMINATION:
        return None
    return graph.solve(H[np.tril_indices(len(H))], b)


def routine(name: str, t: str, row: int, size: int, fma: bool) -> str:
    """LLVM IR of a function that solves equations whose numbers lie in memory.

    The lower triangle of H lies row by row, then b, which becomes the answer.

    Args:
        name: of the function.
        t: LLVM's type of a number.
        row: bytes from one number to the next.
        size: bytes of one individual's number.
        fma: whether the processor multiplies and adds in one instruction.
    """
    lanes, _, item = t[1:-1].partition(" x ") if t.startswith("<") else ("", "", t)
    suffix = ("v" + lanes if lanes else "") + {"float": "f32", "double": "f64"}[item]
    zero, one = (f"splat ({item} {x})" if lanes else x for x in ("0.0", "1.0"))
    flag = f"<{lanes} x i1>" if lanes else "i1"

    def load(out: str, pointer: str) -> str:
        return f"{out} = load {t}, ptr {pointer}, align {size}"

    def less(out: str, a: str, x: str, y: str) -> str:
        """Subtract a product."""
        if fma:
            return (
                f"{out}.n = fneg {t} {x}\n"
                f"{out} = call {t} @llvm.fma.{suffix}({t} {out}.n, {t} {y}, {t} {a})"
            )
        return f"{out}.m = fmul {t} {x}, {y}\n{out} = fsub {t} {a}, {out}.m"

    def at(out: str, base: str, index: str) -> str:
        return (
            f"{out}.s = mul i64 {index}, {row}\n{out} = getelementptr i8, ptr {base}, i64 {out}.s"
        )

    any_of = f"%some = call i1 @llvm.vector.reduce.or.v{lanes}i1({flag} %nonzero)"
    if not lanes:
        any_of = "%some = or i1 %nonzero, false"
    return f"""
define internal void @{name}(ptr %H, ptr %b, i64 %count) noinline #0 {{
entry:
  %last = sub i64 %count, 1
  br label %pivot
pivot:
  %k = phi i64 [ %last, %entry ], [ %k.less, %pivot.done ]
  %k.more = add i64 %k, 1
  %k.twice = mul i64 %k, %k.more
  %k.row = lshr i64 %k.twice, 1
  {at("%row.k", "%H", "%k.row")}
  {at("%diagonal", "%row.k", "%k")}
  {load("%d", "%diagonal")}
  %inverse = fdiv {t} {one}, %d
  store {t} %inverse, ptr %diagonal, align {size}
  {at("%bk", "%b", "%k")}
  {load("%z", "%bk")}
  br label %column
column:
  %i = phi i64 [ %k, %pivot ], [ %i.less, %column.done ]
  %more = icmp ne i64 %i, 0
  br i1 %more, label %look, label %pivot.done
look:
  %i.less = sub i64 %i, 1
  {at("%rk", "%row.k", "%i.less")}
  {load("%r", "%rk")}
  %nonzero = fcmp une {t} %r, {zero}
  {any_of}
  br i1 %some, label %update, label %column.done
update:
  %scaled = fmul {t} %r, %inverse
  %i.twice = mul i64 %i, %i.less
  %i.row = lshr i64 %i.twice, 1
  {at("%row.i", "%H", "%i.row")}
  br label %element
element:
  %j = phi i64 [ 0, %update ], [ %j.next, %element ]
  {at("%pk", "%row.k", "%j")}
  {at("%pi", "%row.i", "%j")}
  {load("%hk", "%pk")}
  {load("%hi", "%pi")}
  {less("%new", "%hi", "%scaled", "%hk")}
  store {t} %new, ptr %pi, align {size}
  %j.next = add i64 %j, 1
  %j.more = icmp ult i64 %j.next, %i
  br i1 %j.more, label %element, label %element.done
element.done:
  store {t} %scaled, ptr %rk, align {size}
  {at("%bi", "%b", "%i.less")}
  {load("%b.old", "%bi")}
  {less("%b.new", "%b.old", "%scaled", "%z")}
  store {t} %b.new, ptr %bi, align {size}
  br label %column.done
column.done:
  br label %column
pivot.done:
  %k.less = sub i64 %k, 1
  %k.again = icmp ne i64 %k, 0
  br i1 %k.again, label %pivot, label %forward
forward:
  %m = phi i64 [ 0, %pivot.done ], [ %m.next, %forward.done ]
  %m.next = add i64 %m, 1
  %m.twice = mul i64 %m, %m.next
  %m.row = lshr i64 %m.twice, 1
  {at("%row.m", "%H", "%m.row")}
  {at("%dm", "%row.m", "%m")}
  {load("%inverse.m", "%dm")}
  {at("%bm", "%b", "%m")}
  {load("%half", "%bm")}
  %begin = fmul {t} %half, %inverse.m
  br label %known
known:
  %q = phi i64 [ 0, %forward ], [ %q.next, %subtract ]
  %sum = phi {t} [ %begin, %forward ], [ %sum.next, %subtract ]
  %q.more = icmp ult i64 %q, %m
  br i1 %q.more, label %subtract, label %forward.done
subtract:
  {at("%pq", "%row.m", "%q")}
  {load("%l", "%pq")}
  {at("%bq", "%b", "%q")}
  {load("%x", "%bq")}
  {less("%sum.next", "%sum", "%l", "%x")}
  %q.next = add i64 %q, 1
  br label %known
forward.done:
  store {t} %sum, ptr %bm, align {size}
  %m.more = icmp ult i64 %m.next, %count
  br i1 %m.more, label %forward, label %done
done:
  ret void
}}"""
