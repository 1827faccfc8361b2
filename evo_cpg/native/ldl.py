"""Symmetric positive definite equations, eliminated from the last unknown to the first.

``H = L^T D L`` with L lower triangular and ones on its diagonal (Featherstone 2008, 6.5). In the
mass matrix of a tree whose bodies come after their parents, zero elements stay zero. Fused code
spends nothing on zeros and on results of zeros.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


class Factors(NamedTuple):
    """Factors L and D of matrices.

    Attributes:
        rows: rows of L. Row k holds the k elements before the diagonal, ``(k, *n)``.
        inverse_pivots: the diagonal of D^-1, ``(v, *n)``.
    """

    rows: tuple[Float[Array, "_ *n"], ...]
    inverse_pivots: Float[Array, "v *n"]


@functools.partial(jax.jit, inline=True)
def factorize(H: Float[Array, "v v *n"]) -> Factors:
    """Return L and D of H, from the lower triangle of H."""
    rows, inverse_pivots, left = [], [], H
    for k in reversed(range(len(H))):
        row, inverse = left[k, :k], 1.0 / left[k, k]
        scaled = row * inverse[None]
        left = left[:k, :k] - scaled[:, None] * row[None]
        rows.append(scaled)
        inverse_pivots.append(inverse)
    return Factors(tuple(reversed(rows)), jnp.stack(inverse_pivots[::-1]))


@functools.partial(jax.jit, inline=True)
def solve_factorized(factors: Factors, b: Float[Array, "v *n"]) -> Float[Array, "v *n"]:
    """Return ``H^-1 b``."""
    z, left = [], b
    for k in reversed(range(len(b))):
        z.append(left[k])
        left = left[:k] - factors.rows[k] * left[k][None]
    halfway = jnp.stack(z[::-1]) * factors.inverse_pivots
    x: list[Array] = []
    for k, row in enumerate(factors.rows):
        x.append(halfway[k] - (row * jnp.stack(x)).sum(0) if x else halfway[k])
    return jnp.stack(x)
