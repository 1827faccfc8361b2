"""Operations that move numbers, at constant or computed places."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from against_jax import assert_agrees, sample
from jax import lax

from evo_cpg.native.fuse import fuse

# Every kind of operation at constant places.
MOVES = {
    "slice": lambda x: x[1:, :2],
    "steps": lambda x: x[::2, ::-1],
    "pick": lambda x: x[np.array([2, 0])],
    "pick pairs": lambda x: x[np.array([2, 0, 2]), np.array([1, 1, 0])],
    "pick beyond the end": lambda x: x.at[np.array([1, 7, -1])].get(mode="fill", fill_value=5.0),
    "pick the nearest": lambda x: x.at[np.array([1, 7])].get(mode="clip"),
    "transpose": lambda x: jnp.swapaxes(x, 0, 1),
    "stack": lambda x: jnp.stack([x[0], x[1]], 1),
    "concatenate": lambda x: jnp.concatenate([x, 2 * x], 1),
    "repeat": lambda x: jnp.broadcast_to(x[:1], x.shape) + x,
    "roll": lambda x: jnp.roll(x, 1, 0) - jnp.flip(x, 1),
    "reshape": lambda x: x.reshape(9)[4:],
    "pad": lambda x: jnp.pad(x, ((1, 0), (0, 2))),
    "pad between": lambda x: lax.pad(x, x[0, 0], ((1, -1, 2), (-1, 2, 0))),
    "split": lambda x: jnp.split(x, 3)[1],
    "set": lambda x: x.at[1].set(3 * x[0]),
    "set some": lambda x: x.at[np.array([2, 0]), 1].set(7.0),
    "set beyond the end": lambda x: x.at[np.array([2, 9])].set(7.0, mode="drop"),
    "add at": lambda x: x.at[np.array([0, 0, 2])].add(x),
    "sum": lambda x: x.sum(0),
    "largest": lambda x: x.max(1),
    "smallest": lambda x: x.min((0, 1)),
    "product": lambda x: x.prod(1),
    "running sum": lambda x: jnp.cumsum(x, 1),
    "running sum from behind": lambda x: lax.cumsum(x, 0, reverse=True),
    "running product": lambda x: jnp.cumprod(x, 0),
    "running sum of a vector": lambda x: jnp.cumsum(x[0]),
    "running extremes": lambda x: lax.cummax(x, 0) - lax.cummin(x, 1, reverse=True),
    "place of the largest": lambda x: (jnp.argmax(x, 0), jnp.argmin(x, 1), jnp.argmax(x)),
    "any": lambda x: (x > 0.5).any(0),
    "all": lambda x: jnp.where((x > -1.5).all(1), x[0], 0.0),
    "product with a matrix": lambda x: np.arange(6, dtype="f").reshape(2, 3) @ x,
    "products of matrices": lambda x: jnp.einsum("ij,jk,kl->il", x, x, x),
    "many products": lambda x: jnp.einsum("bi,bij->bj", x, jnp.stack([x, 2 * x, x.T])),
    "grid": lambda x: np.array([[1, 1, 0], [1, -1, 0], [-1, 1, 0.5]], "f") @ x,
}


@pytest.mark.parametrize("name", MOVES)
def test_moves_and_sums_agree_with_jax(name):
    assert_agrees(MOVES[name], sample((3, 3, 5)))


# Places that differ between individuals, inside and outside the array.
PLACES = jnp.array(
    [[0, 1, 2, 3, -1, -4, 7, 2**31 - 1], [1, 0, -3, 2, 5, 1, -(2**31), 0]], jnp.int32
)

# Operations at these places of an array ``(4, 3)``.
COMPUTED = {
    "slice": lambda x, i: lax.dynamic_slice(x, (i[0], i[1]), (2, 2)),
    "slice of all rows": lambda x, i: lax.dynamic_slice_in_dim(x, i[0], 2, 1),
    "whole": lambda x, i: lax.dynamic_slice(x, (i[0], i[1]), (4, 3)),
    "update": lambda x, i: lax.dynamic_update_slice(x, 10 * x[:2, :2], (i[0], i[1])),
    "update a row": lambda x, i: lax.dynamic_update_index_in_dim(x, x[3], i[1], 0),
    "row": lambda x, i: x[i[0]],
    "row of none": lambda x, i: jnp.append(x[:, :0][i[0]], x[i[1]]),
    "element": lambda x, i: x[i[0], i[1]],
    "column, clipped": lambda x, i: x.at[:, i[1]].get(mode="clip"),
    "column, filled": lambda x, i: x.at[:, i[1]].get(mode="fill"),
    "column, filled with 3": lambda x, i: x.at[:, i[1]].get(mode="fill", fill_value=3.0),
    "several rows": lambda x, i: x.at[i].get(mode="fill"),
    "several elements": lambda x, i: x.at[i, i[::-1]].get(mode="clip"),
    "from constants": lambda x, i: jnp.arange(5.0).at[i].get(mode="fill") + x[0, 0],
    "of whole numbers": lambda x, i: (x > 0).astype(int).at[i].get(mode="fill"),
    "of unsigned ones": lambda x, i: (x > 0).astype(jnp.uint32).at[i].get(mode="fill"),
    "of truths": lambda x, i: (x > 0).at[i[0]].get(mode="fill"),
    "unsigned places": lambda x, i: x.at[i.astype(jnp.uint32)].get(mode="fill"),
    "one of a row": lambda x, i: x[1].at[i[0]].get(mode="fill") + x[:, 0].at[i[1]].get(mode="clip"),
    "one of one": lambda x, i: x[0, :1].at[i[0]].get(mode="fill"),
    "where it is largest": lambda x, i: x[jnp.argmax(x[:, 0])] + x[i[0]],
    "axes in the middle": lambda x, i: x.reshape(2, 2, 3).at[:, i % 2].get(mode="clip"),
}


@pytest.mark.parametrize("name", COMPUTED)
def test_moves_at_computed_places_agree_with_jax(name):
    assert_agrees(COMPUTED[name], sample((4, 3, 8)), PLACES)


def test_places_of_64_bits_agree_with_jax(x64):
    """Choose places far outside the array whose last 32 bits would be inside."""
    places = jnp.array([[0, 1, 2**32, 2**32 + 1, -(2**32), 2**62]])
    for length in (1, 3):
        x = sample((length, 6))
        assert_agrees(lambda x, i: x.at[i].get(mode="fill"), x, places)
        assert_agrees(lambda x, i: x.at[i].get(mode="clip"), x, places)


def test_the_first_nan_is_the_largest_and_the_smallest():
    x = np.array(sample((5, 6)))
    x[2, 1] = x[0, 2] = x[4, 3] = x[2:4, 4] = np.nan
    x[1:4, 5] = np.inf
    assert_agrees(lambda x: (jnp.argmax(x), jnp.argmin(x), x.max(), x.min()), jnp.asarray(x))


def test_shared_and_individual_tables_agree_with_jax():
    table = sample((7,), 4)
    places = jnp.arange(20).reshape(2, 10) % 7

    def look(run):
        return jax.jit(lambda table, own, places: run(table, own, places))(
            table, sample((7, 10)), places
        )

    got = look(lambda table, own, i: fuse(lambda own, i: table[i] * own[i], own, i, batch_ndim=1))
    expected = look(
        lambda table, own, i: jax.vmap(lambda own, i: table[i] * own[i], -1, -1)(own, i)
    )
    np.testing.assert_array_equal(got, expected)
