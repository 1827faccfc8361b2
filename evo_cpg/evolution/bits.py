"""The genetic algorithm on bits of Fukui 2003, chapter 3.

Of 15 individuals the best 7 stay unchanged. The other 8 are overwritten by the children of 4 pairs,
two of each; the 8 parents are drawn independently by rank (so a pair may be twice the same), and
ranks 9 to 15 are never parents. The children come from one-point crossover, and with probability
1/2 a mutation happens, in which 2 to 30 genes are changed at random.

The thesis does not say whether mutation is per child or per pair, nor whether a gene is flipped or
drawn anew: here each child has its own, and a gene is drawn anew unless ``mutation`` says "flip".
Chapter 4 tells of a first attempt with 5 kept and 10 replaced (``elites`` 5), and proposes to
carry several copies of the best (``best_copies``). Differs from the thesis: an individual that
diverged is never kept, and its place goes to one more child.

A bit is a gene of 0.0 or 1.0, so that one type of array serves all genomes; genes come first and
individuals last, ``(g, n)``.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, ScalarLike

from evo_cpg.evolution.generation import Genetics, keep_elites
from evo_cpg.evolution.selection import draw_parents
from evo_cpg.evolution.variation import one_point_crossover

# What happens to a gene that is changed: it is drawn anew, so half of them stay as they are, or it
# becomes the other bit.
MUTATIONS = ("redraw", "flip")

# Decimal probabilities such as the thesis's add up to 1 but for rounding.
_SUM_TOLERANCE = 1e-6


class BitGenetics(Genetics):
    """The genetic algorithm on bits; the defaults are those of Fukui 2003.

    Attributes:
        population: number of individuals.
        elites: places of the next generation that hold the best individuals, unchanged;
            children fill the others.
        best_copies: how many of these places hold the best one.
        rank_probabilities: that a parent is of each rank, best first; lower ranks are no parents.
        mutation_probability: that a child mutates.
        mutated_genes: fewest and most genes that a mutation changes; every number between is as
            likely.
        mutation: what happens to a gene that is changed, one of ``MUTATIONS``.

    Raises:
        ValueError: a value outside its range.
    """

    population: int = eqx.field(static=True, default=15)
    elites: int = eqx.field(static=True, default=7)
    best_copies: int = eqx.field(static=True, default=1)
    rank_probabilities: tuple[float, ...] = eqx.field(
        static=True, default=(0.30, 0.20, 0.20, 0.10, 0.10, 0.05, 0.03, 0.02)
    )
    mutation_probability: float = eqx.field(static=True, default=0.5)
    mutated_genes: tuple[int, int] = eqx.field(static=True, default=(2, 30))
    mutation: str = eqx.field(static=True, default="redraw")

    def __post_init__(self):
        if self.population < 1:
            raise ValueError(f"population must be at least 1, got {self.population}")
        if not 0 <= self.elites < self.population:
            raise ValueError(
                f"elites must be at least 0 and less than the population of "
                f"{self.population}, got {self.elites}"
            )
        most_copies = max(self.elites, 1)
        if not 1 <= self.best_copies <= most_copies:
            raise ValueError(
                f"best_copies must be from 1 to {most_copies} with "
                f"{self.elites} elites, got {self.best_copies}"
            )
        if not 1 <= len(self.rank_probabilities) <= self.population:
            raise ValueError(
                f"rank_probabilities must be 1 to {self.population} numbers, no more than the "
                f"population, got {len(self.rank_probabilities)}"
            )
        if not all(p >= 0 for p in self.rank_probabilities):
            raise ValueError(
                f"rank_probabilities must not be negative, got {self.rank_probabilities}"
            )
        total = sum(self.rank_probabilities)
        if not abs(total - 1) <= _SUM_TOLERANCE:
            raise ValueError(f"rank_probabilities must add up to 1, got a sum of {total:g}")
        if not 0 <= self.mutation_probability <= 1:
            raise ValueError(
                f"mutation_probability must be from 0 to 1, got {self.mutation_probability}"
            )
        fewest, most = self.mutated_genes
        if not 1 <= fewest <= most:
            raise ValueError(
                f"mutated_genes must be fewest, at least 1, and most, got {fewest} and {most}"
            )
        if self.mutation not in MUTATIONS:
            raise ValueError(f"mutation must be {' or '.join(MUTATIONS)}, got {self.mutation!r}")

    def next_generation(
        self,
        key: Array,
        genes: Float[Array, "g n"],
        fitness: Float[Array, " n"],
        trial_fitness: Float[Array, "trials n"] | None = None,
    ) -> Float[Array, "g n"]:
        """Elites, and children of parents drawn by rank; siblings stand side by side.

        Raises:
            ValueError: genomes with fewer genes than a mutation may change.
        """
        del trial_fitness
        parent_key, cross_key, mutate_key = jax.random.split(key, 3)
        # Whole pairs for every place: how many elites there are is known only at run time.
        pairs = -(-self.population // 2)
        parents = draw_parents(parent_key, fitness, np.array(self.rank_probabilities), 2 * pairs)
        children = one_point_crossover(cross_key, genes, parents[:pairs], parents[pairs:], 1.0)
        # Counted from the last place on, so the elites, which come first, part one pair at most.
        children = children[:, 2 * pairs - self.population :]
        children = bit_mutation(
            mutate_key,
            children,
            self.mutation_probability,
            *self.mutated_genes,
            self.mutation,
        )
        return keep_elites(genes, fitness, children, self.elites, self.best_copies)

    def around(self, key: Array, genes: Float[Array, "g n"]) -> Float[Array, "g n"]:
        """All but the first mutated, every one."""
        changed = bit_mutation(key, genes, 1.0, *self.mutated_genes, self.mutation)
        return changed.at[:, 0].set(genes[:, 0])


def random_bits(
    key: Array, gene_count: int, population: int, dtype: jnp.dtype | type
) -> Float[Array, "g n"]:
    """Random genomes: 0 or 1 with equal chances.

    Args:
        key: random key.
        gene_count: bits in a genome.
        population: number of individuals.
        dtype: floating-point type.
    """
    return jax.random.bernoulli(key, 0.5, (gene_count, population)).astype(dtype)


def bit_mutation(
    key: Array,
    genes: Float[Array, "g n"],
    probability: ScalarLike,
    fewest: ScalarLike,
    most: int,
    mutation: str,
) -> Float[Array, "g n"]:
    """Change a random number of randomly chosen, different genes of some individuals.

    Args:
        key: random key.
        genes: genomes, 0 or 1.
        probability: that an individual mutates.
        fewest: genes that are changed in one that does.
        most: genes that are changed; every number between is as likely.
        mutation: what happens to a gene that is changed, one of ``MUTATIONS``.

    Raises:
        ValueError: genomes with fewer genes than may be changed.
    """
    count, individuals = genes.shape
    if most > count:
        raise ValueError(f"a mutation may change {most} genes, but a genome has only {count}")
    whether_key, number_key, which_key, value_key = jax.random.split(key, 4)
    mutates = jax.random.bernoulli(whether_key, probability, (individuals,))
    number = jax.random.randint(number_key, (individuals,), fewest, most + 1)
    places = different_places(which_key, count, jnp.where(mutates, number, 0), most)
    changed = genes.at[places, jnp.arange(individuals)[None]]
    if mutation == "flip":
        values = 1.0 - changed.get(mode="fill", fill_value=0.0)
    else:
        values = random_bits(value_key, most, individuals, genes.dtype)
    return changed.set(values, mode="drop")


def different_places(
    key: Array, count: int, number: Int[Array, " n"], most: int
) -> Int[Array, "most n"]:
    """For each individual a number of different places of 0 to ``count`` - 1, any set as likely.

    Floyd's algorithm (Bentley and Floyd 1987, Communications of the ACM 30, 754): to a set of
    places below ``j`` comes one of 0 to ``j``, or ``j`` itself if that one is already there; ``j``
    rises to ``count`` - 1.

    Args:
        key: random key.
        count: of the places.
        number: how many places each individual gets.
        most: at least the largest of them.

    Returns:
        The places, in no order that means anything, and behind them ``count``.
    """
    step = jnp.arange(most)[:, None]
    needed = step < number[None]
    last = jnp.where(needed, count - number[None] + step, 0)
    drawn = jax.random.randint(key, last.shape, 0, last + 1)
    none = jnp.full_like(drawn, count)

    def choose(places: Array, i: Array) -> tuple[Array, None]:
        taken = (places == drawn[i][None]).any(0)
        place = jnp.where(taken, last[i], drawn[i])
        return places.at[i].set(jnp.where(needed[i], place, count)), None

    return jax.lax.scan(choose, none, jnp.arange(most))[0]
