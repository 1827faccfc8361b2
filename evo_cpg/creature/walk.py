"""Trees that differ between individuals of one program: the parents of bodies as numbers.

The bodies are in an order in which each body follows its parent, subtrees are contiguous, and the
largest subtree of a body comes last. The parent of a body is then the body before it, or an *open*
body, which still gets a child later. A recursion keeps the values of open bodies in a few slots, as
a compiler keeps values in registers (Sethi and Ullman 1970, "The generation of optimal code for
arithmetic expressions").

A body with two or more children uses the slot above those that its earlier subtrees use. So slot s
needs two subtrees of at least ``2^(s+1) - 1`` bodies each, and 20 bodies need 3 slots.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from evo_cpg.creature.algebra.numerics import Numbers


class TreeWalk(eqx.Module):
    """Parents of the bodies of one individual. Most numbers are 1 or 0, for yes or no.

    Attributes:
        follows: whether the body before is the parent.
        opens: whether a body is put into each slot.
        reads: whether the parent is the body in each slot.
        above: whether a body (second axis) is an ancestor of another body, or that body itself.
        turns: sign of each joint axis, or 0 for an axis that the individual does not have.
    """

    follows: Float[Array | Numbers, " b"]
    opens: Float[Array | Numbers, "s b"]
    reads: Float[Array | Numbers, "s b"]
    above: Float[Array | Numbers, "b b"]
    turns: Float[Array | Numbers, " d"]


def slot_count(bodies: int) -> int:
    """Return the number of slots that any tree of some bodies needs at most."""
    return sum(1 for s in range(bodies) if 2 * _least(s) < bodies)


def may_open(slot: int, body: int, bodies: int) -> bool:
    """Return whether a body can use a slot: two subtrees must follow it."""
    return body + 2 * _least(slot) < bodies


def may_read(slot: int, body: int, bodies: int) -> bool:
    """Return whether the parent of a body can be in a slot: after one subtree, before the other."""
    return _least(slot) < body <= bodies - _least(slot)


def _least(slot: int) -> int:
    """Return the least size of the two subtrees of a body that uses a slot."""
    return 2 ** (slot + 1) - 1


def walk_of(
    parents: Int[Array, " b"], slots: Int[Array, " b"], turns: Float[Array, " d"]
) -> TreeWalk:
    """Return the walk over the bodies of one individual.

    Args:
        parents: index of each body's parent, -1 for the root and for absent bodies.
        slots: slot that each body uses, -1 for none.
        turns: sign of each joint axis, 0 for an absent one.
    """
    count = len(parents)
    bodies, every = jnp.arange(count), jnp.arange(slot_count(count))[:, None]
    follows = (parents >= 0) & (parents == bodies - 1)
    in_slot = jnp.where((parents >= 0) & ~follows, slots[parents], -1)
    above = _descendants(parents).T
    opens, reads = (x[None] == every for x in (slots, in_slot))
    return jax.tree.map(lambda x: x.astype(float), TreeWalk(follows, opens, reads, above, turns))


def walk_order(parent: Int[Array, " b"]) -> tuple[Int[Array, " b"], Int[Array, " b"]]:
    """Return the order in which bodies are walked, and the slots of bodies in that order.

    Among the children of a body, the one with the largest subtree is last, and the others precede
    it by falling size.

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
