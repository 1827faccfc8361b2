"""Recursions over bodies whose parents may differ between individuals (`TreeWalk`).

`outwards` and `inwards` return the bodies of a recursion from the root to the tips, and back. For a
known tree they are a `PerBody`. For a walk, values of open bodies, or sums over their children, are
in slots, and each access selects among few slots.
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from typing_extensions import override

from evo_cpg.creature.per_body import PerBody, Value
from evo_cpg.creature.tree import Group, Tree
from evo_cpg.creature.walk import TreeWalk, may_open, may_read, slot_count


def outwards(tree: Tree, root: Value, batch_ndim: int) -> PerBody[Value]:
    """Return the root, which other bodies follow, each after its parent."""
    if tree.walk is None:
        return PerBody([root], batch_ndim)
    return _Outwards([root], batch_ndim, tree.walk, [None] * slot_count(tree.body_count))


def inwards(tree: Tree, stacked: Value, batch_ndim: int) -> PerBody[Value]:
    """Return all bodies, which give values to their parents, each before its parent."""
    bodies = PerBody.of(stacked, batch_ndim)
    if tree.walk is None:
        return bodies
    return _Inwards(bodies.values, batch_ndim, tree.walk, [None] * slot_count(tree.body_count))


class _Walked(PerBody[Value]):
    """Bodies with a value, or none yet, in each slot."""

    def __init__(
        self,
        values: Sequence[Value],
        batch_ndim: int,
        walk: TreeWalk,
        slots: Sequence[Value | None],
    ):
        super().__init__(values, batch_ndim)
        self._walk, self._slots, self._count = walk, list(slots), len(walk.follows)


class _Outwards(_Walked[Value]):
    """Bodies from the root on. A slot holds the value of an open body."""

    def __init__(self, values: Sequence[Value], *given: Any):
        super().__init__(values, *given)
        body, value = len(values) - 1, values[-1]
        for s, slot in enumerate(self._slots):
            if may_open(s, body, self._count):
                opens = self._walk.opens[s, body]
                self._slots[s] = value if slot is None else _chosen(opens, value, slot)

    @override
    def followed_by(self, stacked: Value) -> PerBody[Value]:
        values = super().followed_by(stacked).values
        return _Outwards(values, self.batch_ndim, self._walk, self._slots)

    @override
    def of_parents(self, group: Group) -> Value:
        body, value = group.bodies.start, self.values[-1]
        for s, slot in enumerate(self._slots):
            if slot is not None and may_read(s, body, self._count):
                value = _chosen(self._walk.reads[s, body], slot, value)
        return jax.tree.map(lambda x: jnp.expand_dims(x, -self.batch_ndim - 1), value)


class _Inwards(_Walked[Value]):
    """Bodies from the last on. A slot holds a sum over children of an open body.

    The body before the last has all values of its children.
    """

    @override
    def plus_to_parents(self, group: Group, stacked: Value) -> PerBody[Value]:
        walk, child, slots, values = self._walk, group.bodies.start, self._slots, [*self.values]
        own = jax.tree.map(lambda x: jnp.squeeze(x, -self.batch_ndim - 1), stacked)
        before = _plus(values[child - 1], walk.follows[child], own)
        left: list[Value | None] = []
        for s, total in enumerate(slots):
            if total is not None and may_open(s, child, self._count):
                # The sum was for this body. The next sum is for an earlier body.
                none = jax.tree.map(jnp.zeros_like, total)
                total = _chosen(walk.opens[s, child], none, total)
            if may_read(s, child, self._count):
                total = _plus(total, walk.reads[s, child], own)
            if total is not None and may_open(s, child - 1, self._count):
                before = _plus(before, walk.opens[s, child - 1], total)
            left.append(total)
        values[child - 1] = before
        return _Inwards(values, self.batch_ndim, walk, left)


def _chosen(flag: Any, yes: Value, no: Value) -> Value:
    which = flag > 0
    return jax.tree.map(lambda x, y: jnp.where(which, x, y), yes, no)


def _plus(total: Value | None, flag: Any, value: Value) -> Value:
    """Return a sum to which a value is added if the flag is 1."""
    scaled = jax.tree.map(lambda x: jnp.asarray(flag, x.dtype) * x, value)
    return scaled if total is None else jax.tree.map(jnp.add, total, scaled)
