"""A controller without a will: joint rates written down beforehand, as in an experiment."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from evo_cpg.control.controller import Command, Controller, Observation
from evo_cpg.creature.tree import Tree
from evo_cpg.spatial.linear import array_of, expand_dims_like


class Commanded(Controller):
    """Every motor follows a table of rates; without one, all are asked to stand still.

    In a configuration it is ``controller: {type: "evo_cpg.control.commanded:Commanded"}``, which
    also serves creatures without joints.

    Attributes:
        tree: the creature.
        rates: asked of each degree of freedom in each control step, rad/s; the last one is held.
        gene_count: none.
    """

    tree: Tree
    rates: Float[np.ndarray, "t d"] | None = None
    gene_count: int = eqx.field(static=True, default=0)

    def random_genes(
        self, key: Array, batch: tuple[int, ...], dtype: jnp.dtype | type
    ) -> Float[Array, "g *n"]:
        """Nothing evolves."""
        del key
        return jnp.zeros((0, *batch), dtype)

    def initial_state(self, batch: tuple[int, ...], dtype: jnp.dtype | type) -> Int[Array, "*n"]:
        """No step done."""
        del dtype
        return jnp.zeros(batch, jnp.int32)

    def act(
        self, decoded: Float[Array, "g *n"], state: Int[Array, "*n"], observation: Observation
    ) -> tuple[Int[Array, "*n"], Command]:
        """The rates of the present control step."""
        del decoded
        still = jnp.zeros_like(observation.joint_angle)
        if self.rates is None:
            return state + 1, Command(still, still)
        table = jnp.asarray(array_of(self.rates), still.dtype)
        # All individuals are at the same step.
        row = table[jnp.minimum(state.reshape(-1)[0], len(table) - 1)]
        rate = jnp.broadcast_to(expand_dims_like(row, still), still.shape)
        return state + 1, Command(rate, rate)
