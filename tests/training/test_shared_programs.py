"""Tests share compiled programs of equal content."""

from evo_cpg.training import ascent, train
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.experiment import Learning
from trials import experiment

MESH = population_mesh()


def programs(made):
    return (
        train.compile_trials(made.simulation, MESH),
        train.compile_evolution(made),
        ascent.compile_ascent(made, MESH, 2),
    )


def test_equal_parts_share_programs_and_others_do_not():
    first, again = programs(experiment(20)), programs(experiment(20))
    assert first == again
    # A program depends neither on the number of generations nor on learning.
    later = experiment(20)._replace(generations=9, learning=Learning(2, 2, 4))
    assert programs(later) == first
    for other in (experiment(21), experiment(20, eyes=())):
        assert not set(programs(other)) & set(first)


def test_a_test_with_monkeypatch_shares_no_programs(monkeypatch):
    del monkeypatch
    first, again = programs(experiment(20)), programs(experiment(20))
    assert not set(first) & set(again)
