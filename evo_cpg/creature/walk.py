"""Trees that differ between individuals of one program: the parents of bodies as numbers.

The bodies are in an order in which each body follows its parent, subtrees are contiguous, and the
largest subtree of a body comes last. The parent of a body is then the body before it, or an *open*
body, which still gets a child later. A recursion keeps the values of open bodies in a few slots, as
a compiler keeps values in registers (Sethi and Ullman 1970).

A body with two or more children uses the slot above those that its earlier subtrees use. So slot s
needs two subtrees of at least ``2^(s+1) - 1`` bodies each, and 20 bodies need 3 slots.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from evo_cpg.creature.algebra.numerics import Numbers


class Walk(eqx.Module):
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
) -> Walk:
    """Return the walk over the bodies of one individual.

    Args:
        parents: index of each body's parent, -1 for the root and for absent bodies.
        slots: slot that each body uses, -1 for none.
        turns: sign of each joint axis, 0 for an absent one.
    """
    count = len(parents)
    bodies, every = jnp.arange(count), jnp.arange(slot_count(count))[:, None]
    parent = (parents[:, None] == bodies[None]).astype(float)
    follows = (parents >= 0) & (parents == bodies - 1)
    in_slot = jnp.where((parents >= 0) & ~follows, slots[parents], -1)
    above = jnp.eye(count) + parent
    for _ in range(count.bit_length()):
        above = jnp.minimum(above @ above, 1.0)
    opens, reads = (x[None] == every for x in (slots, in_slot))
    return jax.tree.map(lambda x: x.astype(float), Walk(follows, opens, reads, above, turns))
