"""The genetic algorithm on bits of Fukui 2003, chapter 3.

The best 7 of 15 individuals stay unchanged. Eight children overwrite the other 8: two children of
each of 4 pairs of parents. The 8 parents are drawn independently by rank, so one may be both
parents of a pair. Ranks 9 to 15 are never parents. One-point crossover makes the children. A child
mutates with probability 1/2. A mutation changes 2 to 30 random genes.

The thesis does not say whether mutation is per child or per pair, or how a gene changes. Here each
child has its own mutation. A gene is redrawn unless ``mutation`` is "flip". Chapter 4 describes a
first attempt with 5 individuals kept and 10 replaced (``elites`` 5). The chapter proposes to keep
several copies of the best individual (``best_copies``). Differs from the thesis: an individual that
diverged is never kept, and one more child takes its place.

A bit is a gene of 0.0 or 1.0, so that one type of array serves all genomes. Genes come first and
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

# Change of a mutated gene. A redrawn gene keeps its value with probability 1/2. A flipped gene
# becomes the other bit.
MUTATIONS = ("redraw", "flip")

# Sums of decimal probabilities such as the thesis's differ from 1 by rounding.
_SUM_TOLERANCE = 1e-6


class BitGenetics(Genetics):
    """The genetic algorithm on bits, with the defaults of Fukui 2003.

    Attributes:
        population: number of individuals.
        elites: number of places for the best individuals, unchanged, in the next generation.
            Children fill the other places.
        best_copies: number of the elites' places that copies of the best individual take.
        rank_probabilities: probability of each rank to be drawn as a parent, best first. Ranks
            after the last number have probability 0.
        mutation_probability: probability that a child mutates.
        mutated_genes: fewest and most genes that a mutation changes. All numbers in between are
            equally likely.
        mutation: change of a mutated gene, one of ``MUTATIONS``.

    Raises:
        ValueError: a value is outside its range.
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
                f"rank_probabilities must be 1 to {self.population} numbers (at most the "
                f"population), got {len(self.rank_probabilities)}"
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
                f"mutated_genes must be two numbers, 1 <= fewest <= most, got {fewest} and {most}"
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
        """Return elites, and children of parents drawn by rank, with siblings adjacent.

        Raises:
            ValueError: genomes have fewer genes than a mutation may change.
        """
        del trial_fitness
        parent_key, cross_key, mutate_key = jax.random.split(key, 3)
        # Make children for every place, because the number of finite elites is known only at run
        # time.
        pairs = -(-self.population // 2)
        parents = draw_parents(parent_key, fitness, np.array(self.rank_probabilities), 2 * pairs)
        children = one_point_crossover(cross_key, genes, parents[:pairs], parents[pairs:], 1.0)
        # If there is one child too many, drop the first. Elites overwrite the first children, and
        # so separate at most one pair of siblings.
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
        """Return the genomes, with a mutation in each but the first."""
        changed = bit_mutation(key, genes, 1.0, *self.mutated_genes, self.mutation)
        return changed.at[:, 0].set(genes[:, 0])


def random_bits(
    key: Array, gene_count: int, population: int, dtype: jnp.dtype | type
) -> Float[Array, "g n"]:
    """Return random genomes: 0 or 1 with equal chances.

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
    """Change a random number of different random genes in some individuals.

    Args:
        key: random key.
        genes: genomes, 0 or 1.
        probability: probability that an individual mutates.
        fewest: smallest number of changed genes in a mutation.
        most: largest number of changed genes. All numbers in between are equally likely.
        mutation: change of a mutated gene, one of ``MUTATIONS``.

    Raises:
        ValueError: genomes have fewer genes than a mutation may change.
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
    """Draw a set of indices from 0 to ``count`` - 1 for each individual, all sets equally likely.

    Floyd's algorithm (Bentley and Floyd 1987, Communications of the ACM 30, 754) extends a set of
    indices below ``j``. It adds a random index from 0 to ``j``, or ``j`` itself if that index is in
    the set. ``j`` rises to ``count`` - 1.

    Args:
        key: random key.
        count: number of indices to draw from.
        number: number of indices to draw for each individual.
        most: upper bound of these numbers.

    Returns:
        The indices of each individual in arbitrary order, then ``count`` as padding.
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
