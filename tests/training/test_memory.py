"""A run that does not fit into memory is refused before it starts."""

import dataclasses

import pytest

from evo_cpg.evolution.evosax import Evosax
from evo_cpg.evolution.map_elites import Mapped
from evo_cpg.evolution.strategy import Axis
from evo_cpg.training import memory
from trials import experiment


def sized(population, runs=1):
    small = experiment(population=11)
    genetics = dataclasses.replace(small.strategy, population=population)
    return small._replace(strategy=genetics, runs=runs)


def test_memory_grows_with_the_genomes():
    few, many, twice = (memory.needed(sized(*x))[0] for x in ((10**5,), (2 * 10**5,), (10**5, 2)))
    # There are two genes of four bytes. Breeding holds several copies.
    assert 4 * 8 * 10**5 <= many - few == twice - few <= 10 * 8 * 10**5


def test_the_cells_of_a_map_count(monkeypatch):
    genetics = experiment(population=11).strategy
    axes = tuple(Axis(name, 0.0, 1.0, 300) for name in ("distance", "energy"))
    mapped = experiment()._replace(strategy=Mapped(11, axes, genetics))
    # A cell holds two genes, two descriptors, fitness, generation and index, four bytes each.
    need, state = memory.needed(mapped)
    assert state == pytest.approx(7 * 4 * 90_000, rel=1e-3)
    assert need == memory.needed(sized(11))[0] + 6 * state
    monkeypatch.setattr(memory, "available", lambda: 2**29 + 2**20)
    with pytest.raises(memory.TooLargeError, match=r"0\.0023 GiB of search state .*No pop"):
        memory.require_memory(mapped)


@pytest.mark.slow
def test_the_state_of_evosax_counts():
    """A covariance matrix grows with the square of the genes."""

    def of(strategy, genes):
        simulation = experiment().simulation
        controller = dataclasses.replace(simulation.controller, gene_count=genes)
        own = dataclasses.replace(simulation, controller=controller)
        return memory.needed(experiment()._replace(simulation=own, strategy=strategy))[1]

    pytest.importorskip("evosax")
    full = [of(Evosax("CMA_ES", 12, genes), genes) for genes in (100, 200)]
    assert full[0] > 4 * 100**2 and 3.5 < full[1] / full[0] < 4.1


def test_the_memory_of_the_machine_is_known():
    there = memory.available()
    assert there is None or there > 2**27


def test_the_error_names_the_largest_population_that_fits(monkeypatch):
    monkeypatch.setattr(memory, "available", lambda: 2**30)
    memory.require_memory(sized(10**6))
    with pytest.raises(memory.TooLargeError, match=r"Allowed here: (\d+)") as caught:
        memory.require_memory(sized(10**8, 2))
    most = int(str(caught.value).rsplit(" ", 1)[1])
    memory.require_memory(sized(most, 2))
    with pytest.raises(memory.TooLargeError):
        memory.require_memory(sized(most + 100, 2))
    monkeypatch.setattr(memory, "available", lambda: None)
    memory.require_memory(sized(10**9))
