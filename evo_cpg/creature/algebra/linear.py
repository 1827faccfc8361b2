"""Small linear algebra with the components first and all other axes behind them.

A vector is ``(3, ...)`` and a matrix ``(3, 3, ...)``. The trailing axes (bodies, then individuals)
broadcast. XLA:CPU vectorises the innermost axis, so the products are broadcast and summed over the
leading axes. A 3x3 product with 96 individuals takes 0.17 us a kernel. ``jnp.einsum`` would move
the population away from the last axis.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.numerics import MixedArray, is_traced, xp

inlined = functools.partial(jax.jit, inline=True)
"""Decorator of a function of arrays alone: JAX traces it once for arguments of each shape and type.

A traced program still holds the function's operations, as if they were written there. So do its
derivatives. Outside traced programs the function is compiled as one program. Tracing a step of the
quadruped takes four fifths of the time without this decorator.
"""

# Powers of two between which products of three numbers stay within float32.
_SMALL, _LARGE = 2.0**-32, 2.0**32


def expand_dims_like(
    constant: np.ndarray | Array | MixedArray, like: Array, rank: int | None = None
) -> Array:
    """Append unit axes to a constant so that it broadcasts against an array.

    Args:
        constant: array whose axes become the first axes of the result.
        like: array with the dtype and, by default, the rank of the result.
        rank: number of axes of the result.
    """
    constant = jnp.asarray(constant, like.dtype)
    missing = (like.ndim if rank is None else rank) - constant.ndim
    return constant.reshape(constant.shape + (1,) * missing)


def as_matrix_of(constant: np.ndarray | Array | MixedArray, vector: Array) -> Array:
    """Append unit axes to constant matrices ``(i, j, ...)``, so that they multiply vectors."""
    return expand_dims_like(constant, vector, vector.ndim + 1)


def of_each(value: Array, like: Array) -> Array:
    """Return a value of each individual with unit axes in front, for broadcasts with ``like``."""
    return jnp.expand_dims(value, tuple(range(like.ndim - value.ndim)))


def where_each(mask: Array, new: Any, old: Any) -> Any:
    """Return ``jnp.where`` by individual for pytrees with the individuals on their last axes."""
    return jax.tree.map(lambda x, y: jnp.where(of_each(mask, x), x, y), new, old)


def where_needed(needed: Any, compute: Callable[[], Any], otherwise: Any) -> Any:
    """Return `where_each` of a computation that is skipped if no individual needs it."""
    found = jax.lax.cond(jnp.any(needed), compute, lambda: otherwise)
    # A program for one individual needs no selection, because the branch has selected.
    return where_each(needed, found, otherwise) if needed.ndim else found


def array_of(values: Any, dtype: Any = float) -> np.ndarray | Array:
    """Return numbers as an array. Known numbers give a NumPy array, constant in programs.

    Args:
        values: numbers, nested or not. The array is traced if any number is traced.
        dtype: dtype of a NumPy array. A traced array has the dtype of its numbers.
    """
    if not is_traced(values):
        return np.asarray(values, dtype)
    if not isinstance(values, (tuple, list)):
        return values
    parts = [jnp.asarray(array_of(value, dtype)) for value in values]
    return jnp.stack(jnp.broadcast_arrays(*parts))


@inlined
def dot(a: Float[Array, "n *#rest"], b: Float[Array, "n *#rest"]) -> Float[Array, "*#rest"]:
    """Return the scalar product over the leading axis."""
    return (a * b).sum(0)


@inlined
def matvec(m: Float[Array, "i j *#rest"], v: Float[Array, "j *#rest"]) -> Float[Array, "i *#rest"]:
    """Return matrix times vector, ``m v``."""
    return (m * v[None]).sum(1)


@inlined
def matvec_t(
    m: Float[Array, "i j *#rest"], v: Float[Array, "i *#rest"]
) -> Float[Array, "j *#rest"]:
    """Return transposed matrix times vector, ``m^T v``."""
    return (m * v[:, None]).sum(0)


@inlined
def matmul(
    a: Float[Array, "i j *#rest"], b: Float[Array, "j k *#rest"]
) -> Float[Array, "i k *#rest"]:
    """Return the matrix product ``a b``."""
    return (a[:, :, None] * b[None]).sum(1)


@inlined
def matmul_t(
    a: Float[Array, "i j *#rest"], b: Float[Array, "k j *#rest"]
) -> Float[Array, "i k *#rest"]:
    """Return the matrix product ``a b^T``."""
    return (a[:, None] * b[None]).sum(2)


@inlined
def t_matmul(
    a: Float[Array, "j i *#rest"], b: Float[Array, "j k *#rest"]
) -> Float[Array, "i k *#rest"]:
    """Return the matrix product ``a^T b``."""
    return (a[:, :, None] * b[:, None]).sum(0)


@inlined
def cross(a: Float[Array, "3 *#rest"], b: Float[Array, "3 *#rest"]) -> Float[Array, "3 *#rest"]:
    """Return the vector product ``a x b``."""
    a0, a1, a2 = jnp.unstack(a)
    b0, b1, b2 = jnp.unstack(b)
    return jnp.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])


@inlined
def skew(v: Float[Array, "3 *#rest"]) -> Float[Array, "3 3 *#rest"]:
    """Return the cross-product matrix: ``skew(v) @ w == cross(v, w)``."""
    x, y, z = jnp.unstack(v)
    zero = jnp.zeros_like(x)
    return jnp.stack([zero, -z, y, z, zero, -x, -y, x, zero]).reshape(3, *v.shape)


def toward_one(size: Any) -> Any:
    """Return powers of two, mostly 1, whose squares bring positive numbers nearer to 1.

    After multiplication by the square, a product of three numbers stays within float32. Rounding
    does not change: a product with a power of two is exact.
    """
    return xp.where(size < _SMALL, _LARGE, xp.where(size > _LARGE, _SMALL, 1.0))


@inlined
def inverse_symmetric(m: Float[Array, "k k *#rest"]) -> Float[Array, "k k *#rest"]:
    """Return the inverse of a symmetric positive definite matrix of size 1 to 3, in closed form.

    Raises:
        ValueError: if the matrix has any other size.
    """
    size = m.shape[0]
    if size == 1:
        return 1.0 / m
    if size > 3:
        raise ValueError(f"closed-form inverse needs a matrix of size 1 to 3, got {size}")
    # A body of a millimetre has moments of inertia of 1e-15 kg m^2. Their cube underflows float32.
    scale = toward_one(jnp.stack([m[i, i] for i in range(size)]))
    scale = scale[:, None] * scale[None]
    m = scale * m
    if size == 2:
        determinant = m[0, 0] * m[1, 1] - m[0, 1] * m[0, 1]
        adjugate = jnp.stack([jnp.stack([m[1, 1], -m[0, 1]]), jnp.stack([-m[0, 1], m[0, 0]])])
        return scale * (adjugate * (1.0 / determinant)[None, None])
    m00, m01, m02, _, m11, m12, _, _, m22 = jnp.unstack(m.reshape(9, *m.shape[2:]))
    c00 = m11 * m22 - m12 * m12
    c01 = m02 * m12 - m01 * m22
    c02 = m01 * m12 - m02 * m11
    c11 = m00 * m22 - m02 * m02
    c12 = m01 * m02 - m00 * m12
    c22 = m00 * m11 - m01 * m01
    determinant = m00 * c00 + m01 * c01 + m02 * c02
    adjugate = jnp.stack([c00, c01, c02, c01, c11, c12, c02, c12, c22])
    return scale * (adjugate * (1.0 / determinant)[None]).reshape(m.shape)
