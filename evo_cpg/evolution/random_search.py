"""Random search: every generation is drawn anew, as the first one is.

What any search has to beat at the same number of evaluations.
"""

from collections.abc import Callable

import equinox as eqx
from jaxtyping import Array, Float

from evo_cpg.evolution.strategy import Evaluation, Strategy


class RandomSearch(Strategy):
    """Random genomes for ever.

    Attributes:
        population: individuals in every generation.
        draw: random genomes ``(g, n)`` from a key.
    """

    population: int = eqx.field(static=True)
    draw: Callable[[Array], Float[Array, "g n"]]

    def init(self, key: Array, genes: Float[Array, "g n"]) -> Float[Array, "g n"]:
        """The genomes that come first."""
        del key
        return genes

    def ask(
        self, key: Array, state: Float[Array, "g n"] | None
    ) -> tuple[Float[Array, "g n"], None]:
        """What comes first, then whatever is drawn."""
        return self.draw(key) if state is None else state, None

    def tell(
        self, key: Array, state: None, genes: Float[Array, "g n"], evaluation: Evaluation
    ) -> None:
        """Nothing is learnt."""
