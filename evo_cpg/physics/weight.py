"""Weight and buoyancy: the forces on a creature at rest in still water.

They are one law, and no `evo_cpg.physics.force_law.ForceLaw`. In deep water their difference
``(rho V - m) g`` is one number (Iwadate 2010, eq. 7), because a sum of two forces has larger
rounding errors. Both are gradients of a potential, which energy balances count as stored energy.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.physics.buoyancy import buoyancy
from evo_cpg.physics.force_law import Bodies
from evo_cpg.spatial.linear import cross, expand_dims_like


def weight(bodies: Bodies) -> Float[Array, "6 b *n"]:
    """Return the wrench of weight and buoyancy on every body, in body axes."""
    tree, water, displaced = bodies.tree, bodies.water, bodies.displaced
    under = water.density * tree.volume if water is not None and displaced is None else 0.0
    up = bodies.up
    force = expand_dims_like((under - tree.mass) * bodies.gravity, up[0])[None] * up
    wrench = jnp.concatenate([cross(expand_dims_like(tree.com, up), force), force])
    if water is None or displaced is None:
        return wrench
    return wrench + buoyancy(displaced, up, water.density * bodies.gravity)


def buoyancy_alone(bodies: Bodies) -> Float[Array, "6 b *n"]:
    """Return the wrench of buoyancy on every body, in body axes."""
    up = bodies.up
    pull = expand_dims_like(bodies.tree.mass * bodies.gravity, up[0])[None] * up
    offset = expand_dims_like(bodies.tree.com, up)
    return weight(bodies) + jnp.concatenate([cross(offset, pull), pull])
