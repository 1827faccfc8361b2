"""A run that does not fit is refused before it starts."""

import dataclasses

import pytest

from evo_cpg.evolution.map_elites import Axis, Mapped
from evo_cpg.training import memory
from trials import experiment


def sized(population, runs=1):
    small = experiment(population=11)
    genetics = dataclasses.replace(small.strategy, population=population)
    return small._replace(strategy=genetics, runs=runs)


def test_what_is_needed_grows_with_genomes_alone():
    few, many, twice = (memory.needed(sized(*x)) for x in ((10**5,), (2 * 10**5,), (10**5, 2)))
    # Two genes of four bytes, of which breeding holds several copies.
    assert 4 * 8 * 10**5 <= many - few == twice - few <= 10 * 8 * 10**5


def test_a_map_counts_with_its_cells(monkeypatch):
    genetics = experiment(population=11).strategy
    axes = tuple(Axis(name, 0.0, 1.0, 300) for name in ("distance", "energy"))
    mapped = experiment()._replace(strategy=Mapped(11, axes, genetics))
    assert memory.needed(mapped) == memory.needed(sized(11 + 90_000))
    monkeypatch.setattr(memory, "available", lambda: 2**29 + 2**20)
    with pytest.raises(memory.TooLargeError, match=r"and 90000 cells of a map, .* allowed here: 0"):
        memory.require_memory(mapped)


def test_the_machine_is_known():
    there = memory.available()
    assert there is None or there > 2**27


def test_a_population_that_does_not_fit_is_refused_with_the_one_that_does(monkeypatch):
    monkeypatch.setattr(memory, "available", lambda: 2**30)
    memory.require_memory(sized(10**6))
    with pytest.raises(memory.TooLargeError, match=r"allowed here: (\d+)") as caught:
        memory.require_memory(sized(10**8, 2))
    most = int(str(caught.value).rsplit(" ", 1)[1])
    memory.require_memory(sized(most, 2))
    with pytest.raises(memory.TooLargeError):
        memory.require_memory(sized(most + 100, 2))
    monkeypatch.setattr(memory, "available", lambda: None)
    memory.require_memory(sized(10**9))
