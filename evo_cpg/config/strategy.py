"""From the section ``evolution`` to a search."""

import functools
from pathlib import Path

from evo_cpg.config.errors import ConfigError, nearest
from evo_cpg.config.own_classes import build_own
from evo_cpg.config.own_returns import check_own_strategy
from evo_cpg.config.schema.evolution import (
    BitEvolutionConfig,
    CustomEvolutionConfig,
    EvosaxConfig,
    MapElitesConfig,
    PyribsConfig,
    RandomSearchConfig,
)
from evo_cpg.config.schema.experiment import ExperimentConfig
from evo_cpg.evolution import from_evosax
from evo_cpg.evolution.from_pyribs import Ribs
from evo_cpg.evolution.islands import Islands
from evo_cpg.evolution.map_elites import MapElites, Mapped
from evo_cpg.evolution.pyribs_host import UnknownPyribsError
from evo_cpg.evolution.random_search import RandomSearch
from evo_cpg.evolution.strategy import Strategy
from evo_cpg.installation import command_for
from evo_cpg.simulation.genome import Genome
from evo_cpg.simulation.simulation import Simulation

_KEY = ("evolution",)


def build_strategy(
    config: ExperimentConfig, simulation: Simulation, trials: int, source: Path | str
) -> Strategy:
    """Build the search of a configuration.

    Args:
        config: the configuration.
        simulation: the trial.
        trials: number of trials of an individual.
        source: file that the configuration came from.

    Raises:
        ConfigError: the search is not available, does not suit these genomes, or is the user's own
            and returns something of the wrong kind.
    """
    given, genome = config.evolution, simulation.genome
    islands = getattr(given, "islands", None)
    population = given.population // (islands.count if islands else 1)
    strategy = _on_an_island(config, genome, population, source)
    check_own_strategy(config, strategy, simulation, trials, source)
    if islands:
        strategy = Islands(
            given.population, strategy, islands.count, islands.every, islands.migrants
        )
    if given.axes and not strategy.map_axes:
        strategy = Mapped(given.population, given.build_axes(), strategy)
    return strategy


def _on_an_island(
    config: ExperimentConfig, genome: Genome, population: int, source: Path | str
) -> Strategy:
    given, genes = config.evolution, genome.count
    if isinstance(given, CustomEvolutionConfig):
        about = {"population": population, "gene_count": genes, "binary": genome.binary}
        return build_own(given, Strategy, _KEY, source, **about)
    if isinstance(given, EvosaxConfig):
        return _build_evosax(given, genome, population, source)
    if isinstance(given, PyribsConfig):
        return _build_pyribs(given, genome, population, source)
    if isinstance(given, MapElitesConfig):
        if genome.binary and given.mutated_genes[1] > genes:
            raise _too_many_mutated(given.mutated_genes[1], genes, source)
        vary = given.of_bits() if genome.binary else given.of_numbers()
        return MapElites(population, given.build_axes(), vary)
    if isinstance(given, RandomSearchConfig):
        draw = functools.partial(genome.random, batch=(population,))
        return RandomSearch(population, draw)
    if isinstance(given, BitEvolutionConfig) and given.mutated_genes[1] > genes:
        raise _too_many_mutated(given.mutated_genes[1], genes, source)
    return given.build(population)


def _too_many_mutated(most: int, genes: int, source: Path | str) -> ConfigError:
    return ConfigError(
        source,
        (*_KEY, "mutated_genes"),
        f"at most {genes}, the bits in a genome of this creature, can change, got {most}",
    )


def _build_evosax(
    given: EvosaxConfig, genome: Genome, population: int, source: Path | str
) -> Strategy:
    try:
        known = from_evosax.algorithms()
    except ImportError as error:
        raise _missing("evosax", error, source) from None
    if given.algorithm not in known:
        raise ConfigError(
            source,
            (*_KEY, "algorithm"),
            f"evosax has no {given.algorithm!r}; {nearest(given.algorithm, known)}",
        )
    try:
        return from_evosax.Evosax(
            algorithm=given.algorithm,
            population=population,
            gene_count=genome.count,
            binary=genome.binary,
            sigma=given.sigma,
            gene_bound=genome.bound(given.gene_bound),
            learning_rate=given.learning_rate,
            params=tuple(sorted(given.params.items())),
            options=tuple(sorted(given.options.items())),
        )
    except (AssertionError, TypeError, ValueError) as error:
        whose = f"{population} individuals" + (" on each island" if given.islands else "")
        raise ConfigError(
            source, _KEY, f"{given.algorithm} of {whose} cannot be built ({error})"
        ) from None


def _build_pyribs(
    given: PyribsConfig, genome: Genome, population: int, source: Path | str
) -> Strategy:
    try:
        return Ribs(
            population=population,
            gene_count=genome.count,
            axes=given.build_axes(),
            binary=genome.binary,
            emitters=given.emitters,
            es=given.es,
            sigma=given.sigma,
            learning_rate=given.learning_rate,
            threshold_min=given.threshold_min,
            gene_bound=genome.bound(given.gene_bound),
            options=tuple(sorted(given.options.items())),
        )
    except ImportError as error:
        raise _missing("pyribs", error, source) from None
    except UnknownPyribsError as error:
        raise ConfigError(source, (*_KEY, "type"), str(error)) from None
    except (TypeError, ValueError) as error:
        raise ConfigError(source, _KEY, f"{given.es} cannot be built ({error})") from None


def _missing(extra: str, error: ImportError, source: Path | str) -> ConfigError:
    """What to say where the package of an extra cannot be imported."""
    return ConfigError(
        source,
        (*_KEY, "type"),
        f"'{extra}' is not installed here ({error}); `{command_for(extra)}` installs it",
    )
