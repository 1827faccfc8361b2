"""Random search: every generation consists of new random genomes, like the first one.

It is the baseline for any search with an equal number of evaluations.
"""

from collections.abc import Callable

import equinox as eqx
from jaxtyping import Array, Float

from evo_cpg.evolution.strategy import Evaluation, Strategy


class RandomSearch(Strategy):
    """Random genomes in every generation.

    Attributes:
        population: individuals in every generation.
        draw: random genomes ``(g, n)`` from a key.
    """

    population: int = eqx.field(static=True)
    draw: Callable[[Array], Float[Array, "g n"]]

    def init(self, key: Array, genes: Float[Array, "g n"]) -> Float[Array, "g n"]:
        """Return the first genomes."""
        del key
        return genes

    def ask(
        self, key: Array, state: Float[Array, "g n"] | None
    ) -> tuple[Float[Array, "g n"], None]:
        """Return the first genomes in the first generation, later new random genomes."""
        return self.draw(key) if state is None else state, None

    def tell(
        self, key: Array, state: None, genes: Float[Array, "g n"], evaluation: Evaluation
    ) -> None:
        """Return None: random search ignores the results."""
