"""The search: a genetic algorithm, or another strategy."""

import abc
import functools
import math
from collections.abc import Callable
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, model_serializer, model_validator

from evo_cpg.evolution.genetics import BitGenetics, RealGenetics
from evo_cpg.evolution.map_elites import AlongTheLine, MapElites, OfBits
from evo_cpg.evolution.plan_genetics import PlanGenetics
from evo_cpg.evolution.strategy import Axis, RandomSearch, Strategy
from evo_cpg.io.errors import KeyProblem, nearest
from evo_cpg.io.schema.plans import PlanConfig
from evo_cpg.io.schema.section import (
    Count,
    CustomConfig,
    Finite,
    Fraction,
    NotNegative,
    Options,
    Positive,
    Section,
    by_type,
)
from evo_cpg.simulation.simulation import Genome
from evo_cpg.system import command_for

# Number of individuals of a generation.
Population = Annotated[int, Field(ge=2, le=1_000_000)]

# Largest number of cells of a map. Each cell holds a genome.
_MOST_CELLS = 100_000


class IslandsConfig(Section):
    """Sub-populations that evolve apart, with migration of the best individuals.

    Attributes:
        count: number of islands, among which the population is divided equally.
        every: generations between migrations, in which copies of the best of each island replace
            the worst of the next.
        migrants: number of individuals that each island copies to the next.
    """

    count: Annotated[int, Field(ge=2, le=1000)]
    every: Count = 10
    migrants: Count = 1


class AxisConfig(Section):
    """An axis of a map of behaviour.

    Attributes:
        name: name of a descriptor: a measure of gait, or a term of the task.
        range: lower end of the first cell and upper end of the last cell.
        cells: number of cells.
    """

    name: str
    range: tuple[Finite, Finite]
    cells: Annotated[int, Field(ge=1, le=1000)] = 10

    @model_validator(mode="after")
    def _check(self) -> "AxisConfig":
        if not self.range[0] < self.range[1]:
            raise ValueError(f"range: must rise, got {self.range[0]:g} to {self.range[1]:g}")
        return self


class BodyGeneConfig(Section):
    """Genes of the body, for one quantity of some bodies.

    Attributes:
        range: smallest and largest value: m for a length, otherwise a factor on the creature's own
            value.
        scale: whether equal steps of a gene multiply the quantity (``log``) or add to it
            (``linear``); by default ``log`` for factors.
        genes: bodies that share a gene: left and right (``pairs``), none (``each``), or all
            (``one``).
    """

    range: tuple[Finite, Finite]
    scale: Literal["log", "linear"] | None = None
    genes: Literal["pairs", "each", "one"] = "pairs"


BodyGene = Annotated[
    Annotated[tuple[Finite, Finite], Tag("range")] | Annotated[BodyGeneConfig, Tag("section")],
    Discriminator(lambda value: "range" if isinstance(value, (list, tuple)) else "section"),
]


class MapSection(Section):
    """A search, which may keep a map of behaviour and evolve the body.

    Attributes:
        body: genes of the body, by names of bodies and a quantity, such as
            ``"*_femur.length": [0.1, 0.3]`` (see docs/searches.md).
        axes: axes of the map, which keeps the fittest individual of every cell; no map if left
            out, except in a search that requires a map.
    """

    body: dict[str, BodyGene] = Field(default_factory=dict)
    axes: Annotated[tuple[AxisConfig, ...], Field(max_length=6)] = ()

    @model_serializer(mode="wrap")
    def _leave_out(self, write: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        """Write no genes of a fixed body, as in configurations of earlier versions."""
        found = write(self)
        return found if found.get("body") else {k: x for k, x in found.items() if k != "body"}

    @property
    def body_genes(self) -> dict[str, BodyGeneConfig]:
        """Genes of the body, each as a section."""
        given = self.body.items()
        return {
            key: x if isinstance(x, BodyGeneConfig) else BodyGeneConfig(range=x) for key, x in given
        }

    @model_validator(mode="after")
    def _check_map_and_islands(self) -> "MapSection":
        names = [axis.name for axis in self.axes]
        if len(set(names)) < len(names):
            raise ValueError(f"axes: names must be unique, got {', '.join(names)}")
        cells = math.prod(axis.cells for axis in self.axes)
        if cells > _MOST_CELLS:
            raise ValueError(f"axes: a map has at most {_MOST_CELLS} cells, got {cells}")
        islands: IslandsConfig | None = getattr(self, "islands", None)
        if not islands:
            return self
        population, count = getattr(self, "population", 0), islands.count
        size, rest = divmod(population, count)
        least = max(2, getattr(self, "elites", 0) + 1)
        if rest:
            problem = f"count: {population} cannot be divided equally among {count} islands"
        elif size < least:
            problem = f"count: each of {count} islands gets {size} individuals, but needs {least}"
        elif islands.migrants >= size:
            problem = f"migrants: must be fewer than the {size} of an island"
        else:
            return self
        raise ValueError(f"islands.{problem}")

    @abc.abstractmethod
    def build(self, genome: Genome, population: int) -> Strategy:
        """Build the search on one island.

        Raises:
            KeyProblem: the search is not installed, or does not fit the genome.
        """

    def build_axes(self) -> tuple[Axis, ...]:
        """Return the axes in the form that the search uses."""
        return tuple(Axis(axis.name, *axis.range, axis.cells) for axis in self.axes)


class LearningConfig(Section):
    """Gradient ascent of some individuals before their trials.

    Attributes:
        every: generations between two rounds of learning.
        learners: number of individuals that learn: elites, the best first, then children (default:
            16, or all elites if fewer).
        steps: gradient steps of each.
        inherited: whether offspring inherit what was learned (Lamarckian), or only the genes before
            it (Baldwinian).
    """

    every: Count = 5
    learners: Count | None = None
    steps: Count = 5
    inherited: bool = True


def _check_learning(search: Any) -> None:
    """Check the learning of a search.

    Raises:
        ValueError: too many would learn, or nobody, or there are islands.
    """
    learning, most = search.learning, search.population
    if learning and not 1 <= (learning.learners or search.elites) <= most:
        raise ValueError(
            f"learning.learners: from 1 to all {most} individuals can learn, "
            f"got {learning.learners or search.elites}"
        )
    if search.islands and learning:
        raise ValueError("learning: cannot be combined with islands. Leave out one of the two")


class RealEvolutionConfig(MapSection):
    """The genetic algorithm on real-valued genomes.

    Attributes:
        type: ``real``.
        generations: number of generations.
        population: number of individuals.
        elites: number of best individuals that pass on unchanged.
        selection: selection of parents: by the rank of the mean over all trials, or by lexicase
            selection, which compares one trial after the other.
        parent_fraction: best fraction of the population that may become parents, with a
            probability that falls linearly with the rank (unused by lexicase selection).
        crossover_probability: probability that the genomes of two parents are crossed at one
            point.
        mutation_rate: probability that a gene changes.
        mutation_sigma: standard deviation of a change.
        gene_bound: largest magnitude of a gene.
        learning: gradient ascent of some individuals (default: none).
        islands: sub-populations, to each of which all keys but ``population`` apply
            (default: none).
    """

    type: Literal["real"] = "real"
    generations: Count = 50
    population: Population = 200
    elites: Annotated[int, Field(ge=0)] = 20
    selection: Literal["rank", "lexicase"] = "rank"
    parent_fraction: Annotated[float, Field(gt=0, le=1)] = 0.5
    crossover_probability: Fraction = 0.2
    mutation_rate: Fraction = 0.05
    mutation_sigma: NotNegative = 0.5
    gene_bound: Positive = 8.0
    learning: LearningConfig | None = None
    islands: IslandsConfig | None = None

    def build(self, genome: Genome, population: int) -> RealGenetics:
        """Build the search (see `MapSection.build`)."""
        del genome
        return self.into(RealGenetics, population=population)

    @model_validator(mode="after")
    def _check(self) -> "RealEvolutionConfig":
        if self.elites >= self.population:
            given = "got" if "elites" in self.model_fields_set else "but the default is"
            raise ValueError(
                f"elites: must be fewer than the population of {self.population}, "
                f"{given} {self.elites}"
            )
        _check_learning(self)
        return self


class BitEvolutionConfig(MapSection):
    """The genetic algorithm on bits of Fukui 2003, chapter 3, whose numbers are the defaults.

    Attributes:
        type: ``bits``.
        generations: number of generations.
        population: number of individuals.
        elites: number of best individuals that pass on unchanged (children fill the other places).
        best_copies: number of the elite places that hold the best individual.
        rank_probabilities: probability of each rank to be chosen as a parent, best first.
        mutation_probability: probability that a child mutates.
        mutated_genes: fewest and most genes that a mutation changes.
        mutation: whether a changed gene is redrawn or flipped.
        islands: sub-populations, to each of which all keys but ``population`` apply
            (default: none).
    """

    type: Literal["bits"] = "bits"
    generations: Count = 500
    population: Population = 15
    elites: Annotated[int, Field(ge=0)] = 7
    best_copies: Count = 1
    rank_probabilities: tuple[Fraction, ...] = BitGenetics().rank_probabilities
    mutation_probability: Fraction = 0.5
    mutated_genes: tuple[Count, Count] = (2, 30)
    mutation: Literal["redraw", "flip"] = "redraw"
    islands: IslandsConfig | None = None

    def build(self, genome: Genome, population: int) -> BitGenetics:
        """Build the search (see `MapSection.build`)."""
        _require_enough(genome, self.mutated_genes)
        return self.into(BitGenetics, population=population)

    @model_validator(mode="after")
    def _check(self) -> "BitEvolutionConfig":
        each = self.population // (self.islands.count if self.islands else 1)
        self.into(BitGenetics, population=each)
        return self


class PlanEvolutionConfig(MapSection):
    """The genetic algorithm on body plans (Sims 1994, "Evolving virtual creatures").

    Attributes:
        type: ``plans``.
        generations: number of generations.
        population: number of individuals.
        elites: number of best individuals that pass on unchanged.
        parent_fraction: best fraction of the population that may become parents, with a
            probability that falls linearly with the rank.
        crossed: fraction of the children that mix the parts of two plans.
        grafted: fraction of the children with a part of another plan.
        alterations: mean number of alterations of a child.
        evolve: what may change: ``all``, only the ``body``, whose rhythm is then fixed, or only the
            ``brain``.
        founders: number of different bodies in the first generation (default: all differ).
        protect: whether new topologies are protected: the best plan of each ranks first. It has no
            effect if only brains evolve.
        plan: what body plans may be like.
        learning: gradient ascent of some individuals (default: none).
        islands: sub-populations, to each of which all keys but ``population`` apply
            (default: none).
    """

    type: Literal["plans"] = "plans"
    generations: Count = 100
    population: Population = 300
    elites: Annotated[int, Field(ge=0)] = 60
    parent_fraction: Annotated[float, Field(gt=0, le=1)] = 0.2
    crossed: Fraction = 0.3
    grafted: Fraction = 0.3
    alterations: NotNegative = 3.0
    evolve: Literal["all", "body", "brain"] = "all"
    founders: Annotated[int, Field(ge=1)] | None = None
    protect: bool = True
    plan: PlanConfig = PlanConfig()
    learning: LearningConfig | None = None
    islands: IslandsConfig | None = None

    def build(self, genome: Genome, population: int) -> PlanGenetics:
        """Build the search (see `MapSection.build`)."""
        assert genome.plans is not None
        return self.into(
            PlanGenetics, population=population, layout=genome.plans.layout, bounds=self.plan.bounds
        )

    @model_validator(mode="after")
    def _check(self) -> "PlanEvolutionConfig":
        if self.elites >= self.population:
            raise ValueError(
                f"elites: must be fewer than the population of {self.population}, got {self.elites}"
            )
        _check_learning(self)
        if self.crossed + self.grafted > 1:
            raise ValueError("crossed and grafted add up to more than 1")
        if self.body:
            raise ValueError("body: plans evolve their whole bodies. Leave body out")
        return self


class MapElitesConfig(MapSection):
    """MAP-Elites: the fittest individual of every kind of behaviour.

    Attributes:
        type: ``map_elites``.
        generations: number of generations.
        population: number of children in each generation.
        axes: axes of the map.
        iso_sigma: standard deviation of the noise on each gene (real-valued genes).
        line_sigma: standard deviation of a child's step along the line between its parents
            (real-valued genes).
        gene_bound: largest magnitude of a gene (real-valued genes).
        crossover: probability that two parents are crossed (bits).
        mutation_probability: probability that a child mutates (bits).
        mutated_genes: fewest and most genes that a mutation changes (bits).
        mutation: whether a changed gene is redrawn or flipped (bits).
    """

    type: Literal["map_elites"] = "map_elites"
    generations: Count = 100
    population: Population = 200
    iso_sigma: NotNegative = 0.05
    line_sigma: NotNegative = 0.2
    gene_bound: Positive = 8.0
    crossover: Fraction = 1.0
    mutation_probability: Fraction = 0.5
    mutated_genes: tuple[Count, Count] = (2, 30)
    mutation: Literal["redraw", "flip"] = "redraw"

    def build(self, genome: Genome, population: int) -> MapElites:
        """Build the search (see `MapSection.build`)."""
        if genome.binary:
            _require_enough(genome, self.mutated_genes)
        vary = self.into(OfBits if genome.binary else AlongTheLine)
        return MapElites(population, self.build_axes(), vary)

    @model_validator(mode="after")
    def _check(self) -> "MapElitesConfig":
        if not self.axes:
            raise ValueError("axes: at least one is needed, such as {name: speed, range: [0, 1]}")
        fewest, most = self.mutated_genes
        if fewest > most:
            raise ValueError(f"mutated_genes must be fewest and most, got {fewest} and {most}")
        return self


class EvosaxConfig(MapSection):
    """An algorithm of evosax (Lange 2022), which has to be installed.

    Attributes:
        type: ``evosax``.
        algorithm: name of its class, such as ``Sep_CMA_ES``.
        generations: number of generations.
        population: number of individuals.
        sigma: standard deviation of the first sample, if the algorithm has one (``std_init``).
        gene_bound: largest magnitude of a gene.
        learning_rate: learning rate of Adam, if the algorithm follows a gradient (``Open_ES``).
        params: parameters that differ from the defaults, by their names in evosax.
        options: arguments of its constructor.
        islands: sub-populations, to each of which all keys but ``population`` apply
            (default: none).
    """

    type: Literal["evosax"] = "evosax"
    algorithm: str
    generations: Count = 50
    population: Population = 200
    sigma: Positive = 0.5
    gene_bound: Positive = 8.0
    learning_rate: Positive = 0.02
    params: dict[str, Finite | bool] = Field(default_factory=dict)
    options: Options = Field(default_factory=dict)
    islands: IslandsConfig | None = None

    def build(self, genome: Genome, population: int) -> Strategy:
        """Build the search (see `MapSection.build`)."""
        from evo_cpg.evolution.evosax import Evosax, algorithms

        try:
            known = algorithms()
        except ImportError as error:
            problem = f"'evosax' is not installed here ({error})"
            command = command_for("evosax")
            raise KeyProblem(("type",), f"{problem}. Install it with `{command}`") from None
        if self.algorithm not in known:
            problem = f"evosax has no {self.algorithm!r}: {nearest(self.algorithm, known)}"
            raise KeyProblem(("algorithm",), problem)
        try:
            return self.into(
                Evosax,
                gene_count=genome.count,
                binary=genome.binary,
                gene_bound=None if genome.binary else self.gene_bound,
                population=population,
                params=tuple(sorted(self.params.items())),
                options=tuple(sorted(self.options.items())),
            )
        except (AssertionError, TypeError, ValueError) as error:
            whose = f"{population} individuals" + (" on each island" if self.islands else "")
            problem = f"{self.algorithm} of {whose} cannot be built ({error})"
            raise KeyProblem((), problem) from None


class RandomSearchConfig(MapSection):
    """Random search, the baseline for every other search.

    Attributes:
        type: ``random``.
        generations: number of generations.
        population: number of individuals in each generation.
    """

    type: Literal["random"] = "random"
    generations: Count = 50
    population: Population = 200

    def build(self, genome: Genome, population: int) -> RandomSearch:
        """Build the search (see `MapSection.build`)."""
        return RandomSearch(population, functools.partial(genome.random, batch=(population,)))


class CustomEvolutionConfig(CustomConfig, MapSection):
    """A `Strategy` of your own.

    Attributes:
        type: ``my_module:MyStrategy``.
        generations: number of generations.
        population: number of individuals.
        options: keyword arguments of its constructor.
        islands: sub-populations, to each of which all keys but ``population`` apply
            (default: none).
    """

    generations: Count = 50
    population: Population = 200
    islands: IslandsConfig | None = None

    def build(self, genome: Genome, population: int) -> Strategy:
        """Build the search (see `MapSection.build`)."""
        about = {"population": population, "gene_count": genome.count, "binary": genome.binary}
        return self.instance(Strategy, **about)


def _require_enough(genome: Genome, mutated: tuple[int, int]) -> None:
    """Check that the genome has as many genes as a mutation may change.

    Raises:
        KeyProblem: the genome has fewer genes.
    """
    if mutated[1] > genome.count:
        problem = f"at most {genome.count}, the bits in a genome of this creature, can change"
        raise KeyProblem(("mutated_genes",), f"{problem}, got {mutated[1]}")


EvolutionConfig = Annotated[
    Annotated[RealEvolutionConfig, Tag("real")]
    | Annotated[BitEvolutionConfig, Tag("bits")]
    | Annotated[MapElitesConfig, Tag("map_elites")]
    | Annotated[PlanEvolutionConfig, Tag("plans")]
    | Annotated[EvosaxConfig, Tag("evosax")]
    | Annotated[RandomSearchConfig, Tag("random")]
    | Annotated[CustomEvolutionConfig, Tag("custom")],
    by_type("real"),
]
