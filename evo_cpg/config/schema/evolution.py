"""The genetic algorithm."""

from typing import Annotated, Literal

from pydantic import Field, Tag, model_validator

from evo_cpg.config.schema.choice import by_type
from evo_cpg.config.schema.section import Count, NotNegative, Positive, Section, Share
from evo_cpg.evolution.bits import BitGenetics
from evo_cpg.evolution.generation import RealGenetics


class LearningConfig(Section):
    """Elites climb along the slope of their fitness and pass on what they learn.

    Attributes:
        every: so many generations.
        elites: how many, the best first; 16 if left out, or all where there are fewer.
        steps: moves of each.
    """

    every: Count = 5
    elites: Count | None = None
    steps: Count = 5


class RealEvolutionConfig(Section):
    """The genetic algorithm on real-valued genomes.

    Attributes:
        type: ``real``.
        generations: to evolve.
        population: individuals.
        elites: best individuals that pass on unchanged.
        parent_fraction: best part of the population that may become parents; the chance falls
            linearly with the rank.
        crossover_probability: that two parents' genomes are cut at one place and rejoined.
        mutation_rate: probability that a gene changes.
        mutation_sigma: standard deviation of a change.
        gene_bound: largest magnitude of a gene.
        learning: steps uphill of some elites; none if left out.
    """

    type: Literal["real"] = "real"
    generations: Count = 50
    population: Annotated[int, Field(ge=2, le=1_000_000)] = 200
    elites: Annotated[int, Field(ge=0)] = 20
    parent_fraction: Annotated[float, Field(gt=0, le=1)] = 0.5
    crossover_probability: Share = 0.2
    mutation_rate: Share = 0.05
    mutation_sigma: NotNegative = 0.5
    gene_bound: Positive = 8.0
    learning: LearningConfig | None = None

    def build(self) -> RealGenetics:
        """The settings of the generation step."""
        return RealGenetics(
            population=self.population,
            elite_count=self.elites,
            parent_fraction=self.parent_fraction,
            crossover_probability=self.crossover_probability,
            mutation_rate=self.mutation_rate,
            mutation_sigma=self.mutation_sigma,
            gene_bound=self.gene_bound,
        )

    @model_validator(mode="after")
    def _check(self) -> "RealEvolutionConfig":
        if self.elites >= self.population:
            raise ValueError(
                f"elites: must be fewer than the population of {self.population}, got {self.elites}"
            )
        if self.learning and not 1 <= (self.learning.elites or 1) <= self.elites:
            raise ValueError(
                f"learning.elites: at least one and at most all {self.elites} elites can learn, "
                f"got {self.learning.elites or 1}"
            )
        return self


class BitEvolutionConfig(Section):
    """The genetic algorithm on bits of Fukui 2003, chapter 3, whose numbers are the defaults.

    Attributes:
        type: ``bits``.
        generations: to evolve.
        population: individuals.
        elites: best individuals that pass on unchanged; children fill the other places.
        best_copies: how many of the kept places hold the best individual.
        rank_probabilities: that a parent is of each rank, best first.
        mutation_probability: that a child mutates.
        mutated_genes: fewest and most genes that a mutation changes.
        mutation: whether a changed gene is drawn anew or flipped.
    """

    type: Literal["bits"] = "bits"
    generations: Count = 500
    population: Annotated[int, Field(ge=2, le=1_000_000)] = 15
    elites: Annotated[int, Field(ge=0)] = 7
    best_copies: Count = 1
    rank_probabilities: tuple[Share, ...] = BitGenetics().rank_probabilities
    mutation_probability: Share = 0.5
    mutated_genes: tuple[Count, Count] = (2, 30)
    mutation: Literal["redraw", "flip"] = "redraw"

    def build(self) -> BitGenetics:
        """The settings of the generation step.

        Raises:
            ValueError: values that do not go together.
        """
        fewest, most = self.mutated_genes
        return BitGenetics(
            population=self.population,
            elite_count=self.elites,
            best_copies=self.best_copies,
            rank_probabilities=self.rank_probabilities,
            mutation_probability=self.mutation_probability,
            mutated_genes_min=fewest,
            mutated_genes_max=most,
            mutation=self.mutation,
        )

    @model_validator(mode="after")
    def _check(self) -> "BitEvolutionConfig":
        self.build()
        return self


EvolutionConfig = Annotated[
    Annotated[RealEvolutionConfig, Tag("real")] | Annotated[BitEvolutionConfig, Tag("bits")],
    by_type("real"),
]
