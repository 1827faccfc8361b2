"""Solve symmetric positive definite equations: short ones written out, others in a loop.

In written-out code, zero elements cost nothing (`evo_cpg.native.ldl`). An animal whose limbs may
all touch has no zeros. Elimination then takes v^3/6 operations for v unknowns. If there are more
products than `LONGEST_ELIMINATION`, native code calls a function that loops. The function
eliminates in the same order. It skips elements that are zero for all individuals of a vector, such
as the coupling of limbs that do not touch.
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr
from jaxtyping import Array, Float

from evo_cpg.native import jax_internals as internals
from evo_cpg.native import machine_constants
from evo_cpg.native.frontend.builder import Builder
from evo_cpg.native.ldl import factorize, solve_factorized


def solve_symmetric(H: Float[Array, "v v *n"], b: Float[Array, "v *n"]) -> Float[Array, "v *n"]:
    """Return ``H^-1 b``. Its derivative solves equations with the same matrix."""

    def product(x: Array) -> Array:
        return (H * x[None]).sum(1)

    def answer(_: object, b: Array) -> Array:
        return eliminate_p.bind(H, b)[0]

    return jax.lax.custom_linear_solve(product, b, answer, symmetric=True)


def _evaluate(H: Array, b: Array) -> list[Array]:
    return [solve_factorized(factorize(H), b)]


def _batch(values: tuple[Array, Array], axes: tuple[int | None, int | None]) -> tuple:
    """Move the mapped axis to the end, where the individuals are."""
    size = next(x.shape[k] for x, k in zip(values, axes, strict=True) if k is not None)
    H, b = (
        jnp.broadcast_to(x[..., None], (*x.shape, size)) if k is None else jnp.moveaxis(x, k, -1)
        for x, k in zip(values, axes, strict=True)
    )
    return eliminate_p.bind(H, b), [b.ndim - 1]


def _differentiate(primals: tuple, tangents: tuple) -> tuple:
    given = [internals.instantiate_zeros(tangent) for tangent in tangents]
    return jax.jvp(_evaluate, list(primals), given)


eliminate_p = internals.primitive("eliminate")
internals.implement(
    eliminate_p,
    lambda H, b: [jax.ShapeDtypeStruct(b.shape, b.dtype)],
    _evaluate,
    _differentiate,
    _batch,
)


def elimination_of(avals: Sequence[Any]) -> ClosedJaxpr:
    """Return the written-out elimination as a program, for arguments of the given shapes."""
    return jax.make_jaxpr(_evaluate)(*avals)


def elimination_cost(filled: np.ndarray) -> int:
    """Count the products of an elimination from the last unknown to the first.

    Args:
        filled: ``(v, v)``, true at nonzero elements of the matrix.
    """
    filled, total = filled.copy(), 0
    for k in reversed(range(len(filled))):
        (used,) = np.nonzero(filled[k, :k])
        total += len(used) * (len(used) + 1) // 2
        filled[np.ix_(used, used)] = True
    return total


def eliminate(builder: Builder, operands: list[np.ndarray]) -> np.ndarray | None:
    """Return the solution by a loop, or None if written-out code is better.

    Args:
        builder: maker of the nodes.
        operands: H and b of one individual.
    """
    H, b = operands
    if H.ndim != 2:
        return None
    filled = np.vectorize(lambda node: node.value is None or node.value != 0, otypes=[bool])(H)
    if elimination_cost(filled) <= machine_constants.LONGEST_ELIMINATION:
        return None
    return builder.solve(H[np.tril_indices(len(H))], b)
