"""The three outer updates that turn a convex step problem into Coulomb contact.

Newton's method (`evo_cpg.physics.step.newton`) solves a problem in which the friction-cone radii,
the restitution and the velocity-product bias of touching limbs are fixed. Each of the three has an
update here. `evo_cpg.physics.step.step_solver` applies them.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from evo_cpg.creature.algebra.linear import where_each

# Factor by which one update reduces the restitution, and the number of reductions before it is 0.
_REDUCTION, _REDUCTIONS = 0.5, 2

# Least squared force (N^2) to divide by.
_NONE = 1e-12


class Cone(NamedTuple):
    """Friction-cone radii ``L``, with the previous round for Anderson's acceleration.

    Attributes:
        radius: L in this round, N.
        allowed: mu f_n of the previous round, N.
        missed: `allowed` minus the radius of the previous round, N.
        rounds: number of completed rounds.
    """

    radius: Float[Array, "p *n"]
    allowed: Float[Array, "p *n"]
    missed: Float[Array, "p *n"]
    rounds: Int[Array, "*n"]

    @classmethod
    def first(cls, radius: Float[Array, "p *n"]) -> "Cone":
        """Return the cones of the first round, which does not use `allowed` and `missed`."""
        return cls(radius, radius, radius, jnp.zeros(radius.shape[1:], jnp.int32))

    def updated(self, allowed: Float[Array, "p *n"]) -> "Cone":
        """Return the cones of the next round: ``L = mu f_n``, by Anderson's acceleration.

        Args:
            allowed: mu f_n with the normal forces of this round, N.
        """
        missed = allowed - self.radius
        change = missed - self.missed
        mixing = (missed * change).sum(0) / jnp.maximum((change * change).sum(0), _NONE)
        mixing = jnp.where(self.rounds > 0, jnp.clip(mixing, -1.0, 1.0), 0.0)
        radius = jnp.maximum(allowed - mixing[None] * (allowed - self.allowed), 0.0)
        return Cone(radius, allowed, missed, self.rounds + 1)

    def updated_where(self, mask: Bool[Array, "*n"], allowed: Float[Array, "p *n"]) -> "Cone":
        """Return the cones with an update of the individuals in a mask."""
        return where_each(mask, self.updated(allowed), self)


class PairBias(NamedTuple):
    """Velocity-product bias of touching limbs.

    Attributes:
        value: the bias, in the form of `evo_cpg.physics.contact.pair_contacts.PairContacts`.
        updates: number of updates.
    """

    value: Float[Array, "k *n"]
    updates: Int[Array, "*n"]

    @classmethod
    def first(cls, value: Float[Array, "k *n"]) -> "PairBias":
        """Return the bias at the joint rates at the start of the step."""
        return cls(value, jnp.zeros(value.shape[1:], jnp.int32))

    def updated_where(self, mask: Bool[Array, "*n"], value: Float[Array, "k *n"]) -> "PairBias":
        """Return the bias with another value for the individuals in a mask."""
        return where_each(mask, PairBias(value, self.updates + 1), self)


def reduced(restitution: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Halve the restitution, or return 0 after the last allowed halving."""
    less = _REDUCTION * restitution
    return jnp.where(less < _REDUCTION**_REDUCTIONS, 0.0, less)
