"""Weight and buoyancy: the forces on a creature at rest in still water.

They are one law, and no `evo_cpg.physics.water.force_law.ForceLaw`. In deep water their difference
``(rho V - m) g`` is one number (Iwadate 2010, eq. 7), because a sum of two forces has larger
rounding errors. A body whose centre of mass is not that of its volume has both forces, each at its
own centre. Both are gradients of a potential, which energy balances count as stored energy.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import cross, expand_dims_like
from evo_cpg.creature.algebra.numerics import Numbers, xp
from evo_cpg.physics.water.buoyancy import buoyancy
from evo_cpg.physics.water.force_law import Bodies


def weight(bodies: Bodies) -> Float[Array, "6 b *n"]:
    """Return the wrench of weight and buoyancy on every body, in body axes."""
    tree, water, displaced = bodies.tree, bodies.water, bodies.displaced
    under = water.density * tree.volume if water is not None and displaced is None else 0.0
    up = bodies.up
    if tree.centre_of_volume is not None:
        return _apart(bodies, under)
    force = expand_dims_like((under - tree.mass) * bodies.gravity, up[0])[None] * up
    wrench = jnp.concatenate([cross(expand_dims_like(tree.com, up), force), force])
    if water is None or displaced is None:
        return wrench
    return wrench + buoyancy(displaced, up, water.density * bodies.gravity)


def _apart(bodies: Bodies, under: Numbers | float) -> Float[Array, "6 b *n"]:
    """Return weight at the centres of mass, plus buoyancy at the centres of volume.

    Args:
        bodies: bodies whose centre of mass is not that of their volume.
        under: mass of the displaced water in deep water, or 0, kg.
    """
    tree, water, up = bodies.tree, bodies.water, bodies.up
    pull = expand_dims_like(-tree.mass * bodies.gravity, up[0])[None] * up
    lift = (
        expand_dims_like(xp.broadcast_to(under * bodies.gravity, tree.mass.shape), up[0])[None] * up
    )
    com, centre = (expand_dims_like(x, up) for x in (tree.com, tree.centre))
    wrench = jnp.concatenate([cross(com, pull) + cross(centre, lift), pull + lift])
    if water is None or bodies.displaced is None:
        return wrench
    return wrench + buoyancy(bodies.displaced, up, water.density * bodies.gravity)


def buoyancy_alone(bodies: Bodies) -> Float[Array, "6 b *n"]:
    """Return the wrench of buoyancy on every body, in body axes."""
    up = bodies.up
    pull = expand_dims_like(bodies.tree.mass * bodies.gravity, up[0])[None] * up
    offset = expand_dims_like(bodies.tree.com, up)
    return weight(bodies) + jnp.concatenate([cross(offset, pull), pull])
