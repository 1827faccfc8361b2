"""Lineage: earlier champions are kept, bounded, and equal after a kill."""

import numpy as np
import pytest

from evo_cpg.training import train
from evo_cpg.training.checkpoint import Champion, Checkpoint
from evo_cpg.training.lineage import KEPT, champion_at, extended, landmarks, representatives
from evo_cpg.training.run_folder import RunFolder, RunFolderError


def found_in(generation: int, run: int = 0, genes: int = 2) -> Champion:
    """Return a champion whose fitness rises with its generation."""
    own = np.full(genes, generation, np.float32)
    return Champion(own, generation / 7, generation, {"way": 2.0}, {"energy": 3.0}, run, 5)


def grown(generations, lineage=()) -> list[Champion]:
    """Return the lineage of a run that found a champion in each of these generations."""
    for generation in generations:
        lineage = extended(lineage, [found_in(generation)])
    return list(lineage)


def assert_same(one, other) -> None:
    assert len(one) == len(other)
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a.genes, b.genes)
        assert a.genes.dtype == b.genes.dtype and a[1:] == b[1:]


@pytest.fixture
def folder(tmp_path):
    made = RunFolder(tmp_path / "a")
    made.create("name: a\n", {})
    return made


def test_a_lineage_is_read_back_exactly(folder):
    lineage = extended([], [found_in(3, 1), found_in(0, 1), found_in(2, 0)])
    assert [(each.run, each.generation) for each in lineage] == [(0, 2), (1, 0), (1, 3)]
    folder.save_lineage(lineage)
    assert_same(folder.load_lineage(), lineage)
    with np.load(folder.lineage, allow_pickle=False) as arrays:
        assert arrays["genes"].shape == (3, 2)


def test_measures_added_later_are_nan_before(folder):
    early, late = found_in(0), found_in(1)._replace(terms={"way": 1.0, "slip": 0.5})
    folder.save_lineage([early, late])
    first, second = folder.load_lineage()
    assert np.isnan(first.terms["slip"]) and second.terms["slip"] == 0.5


def test_a_lineage_is_bounded_and_exact_at_landmarks():
    lineage = grown(range(3000))
    assert len(lineage) == KEPT
    assert landmarks(300) == [0, 1, 2, 5, 10, 20, 50, 100, 200]
    for mark in landmarks(2999):
        assert champion_at(lineage, mark).generation == mark
    generations = [each.generation for each in lineage]
    assert generations[0] == 0 and generations[-1] == 2999
    # No long stretch of generations is without a champion.
    age = np.log1p(generations)
    assert np.diff(age).max() < 0.95


def test_landmarks_stay_exact_if_champions_are_rare():
    """The champion at a landmark may have been found earlier."""
    generations = sorted({round(1.08**k) + k for k in range(120)})
    lineage = grown(generations)
    assert len(lineage) == KEPT < len(generations)
    for mark in landmarks(generations[-1]):
        expected = max((g for g in generations if g <= mark), default=None)
        one = champion_at(lineage, mark)
        assert (one and one.generation) == expected


def until(folder, lineage, champions, generation: int) -> list[Champion]:
    """Return the lineage in a folder after a number of generations."""
    folder.save_lineage(lineage)
    known = Checkpoint(generation, np.zeros((2, 4), np.float32), tuple(champions), [], {})
    return train._lineage_until(folder, known)


@pytest.mark.parametrize("lost", [1, 2])
def test_generations_repeated_after_a_kill_give_an_equal_lineage(folder, lost):
    """The file may be one generation ahead of the checkpoint, or two if that was damaged."""
    for last in (5, 90, 200):
        whole = grown(range(last))
        back = until(folder, whole, [found_in(last - lost - 1)], last - lost)
        assert back[-1].generation == last - lost - 1
        assert_same(grown(range(last - lost, last), back), whole)


def test_each_run_has_its_own_lineage(folder):
    lineage = grown(range(100)) + [found_in(g, 1) for g in (0, 50)]
    lineage = extended(lineage, [found_in(100, 1)])
    assert sum(each.run == 0 for each in lineage) == KEPT
    assert [each.generation for each in lineage if each.run == 1] == [0, 50, 100]


def test_a_refined_champion_replaces_the_original(folder):
    lineage = grown(range(4))
    better = lineage[-1]._replace(fitness=9.0)
    assert_same(until(folder, lineage, [better, None], 4), [*lineage[:-1], better])


def test_representatives_are_evenly_spaced():
    lineage = grown((0, 1, 2, 3, 5, 9, 20, 33))
    assert [each.generation for each in representatives(lineage, 4)] == [0, 2, 9, 33]
    assert representatives(lineage, 9) == lineage
    assert [each.generation for each in representatives(lineage, 1)] == [33]
    assert champion_at(lineage, 8).generation == 5
    assert champion_at(lineage[1:], 0) is None


def test_a_missing_or_damaged_lineage_is_named(folder):
    with pytest.raises(RunFolderError, match=r"no lineage\.npz"):
        folder.load_lineage()
    folder.lineage.write_bytes(b"no archive")
    with pytest.raises(RunFolderError, match="The run can continue"):
        folder.load_lineage()


def test_a_run_with_a_lost_lineage_continues_with_its_champions(folder):
    known = Checkpoint(6, np.zeros((2, 4), np.float32), (found_in(3), None), [], {})
    folder.lineage.write_bytes(b"no archive")
    assert_same(train._lineage_until(folder, known), [found_in(3)])
    # The genes belong to another brain, before a change of config.yaml.
    folder.save_lineage([found_in(2, genes=3)])
    assert_same(train._lineage_until(folder, known), [found_in(3)])
    folder.save_lineage([found_in(1)])
    assert_same(train._lineage_until(folder, known), [found_in(1), found_in(3)])
