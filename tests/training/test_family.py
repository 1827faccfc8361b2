"""The family tree keeps every individual, through kills and resumption."""

import itertools
import shutil

import numpy as np
import pytest

from evo_cpg.api.experiment import load
from evo_cpg.api.training import resume, train
from evo_cpg.training.family import FAMILY_FILE, cut_family, founders, read_family
from evo_cpg.training.run_folder import RunFolder

SETTINGS = [
    "simulation.seconds=0.2",
    "evolution.population=20",
    "evolution.elites=4",
    "evolution.generations=4",
    "evolution.plan.bodies=2",
    "audit.after_training=false",
]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("family") / "run"
    train(load("virtual_creatures_water", SETTINGS), folder)
    return RunFolder(folder)


@pytest.mark.slow
def test_origins_lead_to_the_parents(run):
    blocks = read_family(run.path)
    assert [block.shape for block in blocks] == [(1, 20)] * 4
    for before, after in itertools.pairwise(blocks):
        kept = before["kind"][0] == 0
        assert kept.sum() == 4
        parents = before["first"][0, kept]
        np.testing.assert_array_equal(after["genome"][0, kept], before["genome"][0, parents])
        # Elites are the best, in order.
        np.testing.assert_array_equal(
            before["fitness"][0, parents], -np.sort(-before["fitness"][0])[:4]
        )
        alone = np.isin(before["kind"][0], (0, 1))
        np.testing.assert_array_equal(before["second"][0] == -1, alone)


@pytest.mark.slow
def test_ancestors_follow_first_parents(run):
    blocks = [block[0] for block in read_family(run.path)]
    born, found = founders(run.path, 4)
    ancestor = np.arange(20)
    for block in reversed(blocks):
        ancestor = block["first"][ancestor]
    assert born == 0
    np.testing.assert_array_equal(found, ancestor)
    born, found = founders(run.path, 4, least=5)
    assert len(set(found)) >= 5 and (born == 0 or len(set(blocks[born - 1]["first"][found])) < 5)
    assert founders(run.path, 0)[0] == 0 and founders(run.path, 5) is None


@pytest.mark.slow
@pytest.mark.parametrize("lost", [1, 200])
def test_a_cut_file_keeps_whole_generations(run, tmp_path, lost):
    copy = tmp_path / FAMILY_FILE
    shutil.copy(run.path / FAMILY_FILE, copy)
    whole = copy.read_bytes()
    copy.write_bytes(whole[:-lost])
    assert len(read_family(tmp_path)) < 4
    assert cut_family(tmp_path, 2)
    assert whole.startswith(copy.read_bytes()) and len(read_family(tmp_path)) == 2


@pytest.mark.slow
def test_a_resumed_run_has_the_same_tree(run, tmp_path):
    copy = shutil.copytree(run.path, tmp_path / "run")
    (copy / "checkpoints" / "generation_000004.npz").unlink()
    resume(copy)
    assert (copy / FAMILY_FILE).read_bytes() == (run.path / FAMILY_FILE).read_bytes()


@pytest.mark.slow
def test_a_tree_with_lost_generations_is_emptied(run, tmp_path):
    shutil.copy(run.path / FAMILY_FILE, tmp_path / FAMILY_FILE)
    assert not cut_family(tmp_path, 5)
    assert read_family(tmp_path) == [] and founders(tmp_path, 1) is None


def test_no_file_is_made_without_plans(tmp_path):
    assert cut_family(tmp_path, 0) and not (tmp_path / FAMILY_FILE).exists()
