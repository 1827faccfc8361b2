"""Controller with prescribed joint rates, for experiments."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from evo_cpg.control.controller import Command, Controller, Observation
from evo_cpg.creature.algebra.linear import array_of, expand_dims_like
from evo_cpg.creature.tree import Tree


class Commanded(Controller):
    """Controller that commands a table of rates. All rates are 0 without a table.

    In a configuration: ``controller: {type: "evo_cpg.control.commanded:Commanded"}``. It also
    serves creatures without joints.

    Attributes:
        tree: the creature.
        rates: commanded rate of each degree of freedom in each control step, rad/s. After the end
            of the table its last row is held.
        gene_count: 0.
    """

    tree: Tree
    rates: Float[np.ndarray, "t d"] | None = None
    gene_count: int = eqx.field(static=True, default=0)

    def random_genes(
        self, key: Array, batch: tuple[int, ...], dtype: jnp.dtype | type
    ) -> Float[Array, "g *n"]:
        """Return empty genomes."""
        del key
        return jnp.zeros((0, *batch), dtype)

    def initial_state(self, batch: tuple[int, ...], dtype: jnp.dtype | type) -> Int[Array, "*n"]:
        """Return the number of completed steps, 0."""
        del dtype
        return jnp.zeros(batch, jnp.int32)

    def act(
        self, decoded: Float[Array, "g *n"], state: Int[Array, "*n"], observation: Observation
    ) -> tuple[Int[Array, "*n"], Command]:
        """Command the rates of the present control step, and count the step."""
        del decoded
        still = jnp.zeros_like(observation.joint_angle)
        if self.rates is None:
            return state + 1, Command(still, still)
        table = jnp.asarray(array_of(self.rates), still.dtype)
        # All individuals have completed the same number of steps.
        row = table[jnp.minimum(state.reshape(-1)[0], len(table) - 1)]
        rate = jnp.broadcast_to(expand_dims_like(row, still), still.shape)
        return state + 1, Command(rate, rate)
