"""Order in which the physics walks the bodies of a tree, and places for values that it keeps.

The order is preorder: each body follows its parent, and subtrees are contiguous. A body's children
after the first one need its values when other bodies have been walked in between. So bodies with
several children keep their values in slots until their last child.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int


def walk_order(parent: Int[Array, " b"]) -> tuple[Int[Array, " b"], Int[Array, " b"]]:
    """Return the order in which bodies are walked, and the slots of bodies in that order.

    The order is preorder. Among the children of a body, the one with the largest subtree is last,
    and the others precede it by falling size. A walk keeps values of bodies with several children
    in slots until their last child. The order needs few slots (Sethi and Ullman 1970, "The
    generation of optimal code for arithmetic expressions"): 3 for up to 30 bodies.

    Args:
        parent: index of each body's parent, which precedes the body. It is -1 for the root, which
            is body 0, and for absent bodies.

    Returns:
        The indices of the bodies in the order of the walk, with absent bodies last. Then, in that
        order, the slot of each body with several children, otherwise -1.
    """
    number = len(parent)
    index = jnp.arange(number)
    child = parent[None] == index[:, None]  # of a body (row)
    below = _descendants(parent)
    size = below.sum(1)
    before = (size[:, None] > size[None]) | (
        (size[:, None] == size[None]) & (index[:, None] < index[None])
    )
    siblings = (parent[:, None] == parent[None]) & (parent >= 0)[None]
    last = (parent >= 0) & ~(siblings & before).any(0)
    before = siblings & ((before & ~last[:, None]) | (last[None] & ~last[:, None]))
    offset = jnp.where(parent >= 0, 1 + (before * size[:, None]).sum(0), 0)
    absent = (parent < 0) & (index > 0)
    position = jnp.where(absent, number + index, (below * offset[:, None]).sum(0))
    order = jnp.argsort(position)
    return order, _slots(child, last)[order]


def _descendants(parent: Int[Array, " b"]) -> Bool[Array, "b b"]:
    """Return whether a body (column) is another one (row) or hangs on it."""
    index = jnp.arange(len(parent))

    def add(body: Array, below: Array) -> Array:
        above = below[:, parent[body]] & (parent[body] >= 0)
        return jnp.where((index == body)[None], above[:, None] | (index == body)[:, None], below)

    return jax.lax.fori_loop(0, len(parent), add, jnp.zeros((len(parent),) * 2, bool))


def _slots(child: Bool[Array, "b b"], last: Bool[Array, " b"]) -> Int[Array, " b"]:
    """Return the slot of each body with several children, otherwise -1."""
    number = len(last)

    def add(i: Array, state: tuple[Array, Array]) -> tuple[Array, Array]:
        needed, slots = state
        own, body = child[number - 1 - i], jnp.arange(number) == number - 1 - i
        slot = jnp.where(own & ~last, needed, 0).max()
        after = jnp.where(own & last, needed, 0).max()
        several = own.sum() > 1
        count = jnp.where(several, jnp.maximum(after, slot + 1), after)
        return jnp.where(body, count, needed), jnp.where(body & several, slot, slots)

    none = jnp.zeros(number, int)
    return jax.lax.fori_loop(0, number, add, (none, none - 1))[1]
