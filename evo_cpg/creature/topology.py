"""Topology of a body plan: its tree of bodies with the axes of their joints.

It has no labels, sizes or places, and the order of children does not count. So two plans have one
topology if and only if one can be drawn over the other, joint by joint.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, UInt32

from evo_cpg.creature.development import Plan


def topology_number(plan: Plan) -> UInt32[Array, ""]:
    """Return a number that plans of one topology share.

    Other topologies have it with a probability of 2^-32. The number of a body is a hash of its axes
    and of the sum of its children's numbers.
    """
    own = plan.axes.astype(jnp.uint32) @ jnp.array([1, 2, 4], jnp.uint32)

    def add(i: Array, sums: UInt32[Array, " b"]) -> UInt32[Array, " b"]:
        body = len(own) - 1 - i
        number = jnp.where(plan.parent[body] >= 0, _mixed(sums[body] + own[body] + 1), 0)
        return sums.at[jnp.maximum(plan.parent[body], 0)].add(number.astype(jnp.uint32))

    return jax.lax.fori_loop(0, len(own), add, jnp.zeros_like(own))[0]


def _mixed(number: UInt32[Array, ""]) -> UInt32[Array, ""]:
    """Return a hash (Wellons' "lowbias32", which has little bias of all of its size)."""
    for shift, factor in ((16, 0x7FEB352D), (15, 0x846CA68B)):
        number = (number ^ (number >> shift)) * jnp.uint32(factor)
    return number ^ (number >> 16)
