"""Controller without commands, for experiments."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.control.controller import Command, Controller, Observation
from evo_cpg.creature.tree import Tree


class Commanded(Controller):
    """Controller that commands a rate of 0 of all joints.

    In a configuration: ``controller: {type: "evo_cpg.control.commanded:Commanded"}``. It also
    serves creatures without joints.

    Attributes:
        tree: the creature.
        gene_count: 0.
    """

    tree: Tree
    gene_count: int = eqx.field(static=True, default=0)

    def random_genes(
        self, key: Array, batch: tuple[int, ...], dtype: jnp.dtype | type
    ) -> Float[Array, "g *n"]:
        """Return empty genomes."""
        del key
        return jnp.zeros((0, *batch), dtype)

    def initial_state(self, batch: tuple[int, ...], dtype: jnp.dtype | type) -> tuple[()]:
        """Return an empty state."""
        del batch, dtype
        return ()

    def act(
        self, decoded: Float[Array, "g *n"], state: tuple[()], observation: Observation
    ) -> tuple[tuple[()], Command]:
        """Command a rate of 0."""
        del decoded
        still = jnp.zeros_like(observation.joint_angle)
        return state, Command(still, still)
