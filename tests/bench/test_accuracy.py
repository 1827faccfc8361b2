"""Errors fall with the step as the order of the method predicts."""

import functools

import numpy as np
import pytest

from benchmarks.accuracy import (
    FINER,
    body_length,
    mujoco_error,
    mujoco_places,
    our_error,
    our_places,
    typical_distance,
)
from benchmarks.exercise import Wave
from benchmarks.moving import PHYSICS, WHOLE, Animal, measure
from benchmarks.mujoco_peer import WET
from benchmarks.plan import Plan, experiment_of
from evo_cpg.training.devices import population_mesh
from tiny_run import TINY

STEPS = 120
# Ratio of the errors with whole and quarter steps, if the method has the first order.
EXPECTED = (1 - 1 / FINER) / (1 / 4 - 1 / FINER)


@pytest.fixture(scope="module")
def chain():
    """Two boxes with one joint, which follows the wave."""
    return Wave(experiment_of("iwadate2010_swimmer", *TINY, "creature.bodies.1.repeat=1"))


@pytest.fixture(scope="module")
def places(chain):
    """Function of a side and the number of parts of a step: final places of the roots, m."""

    @functools.cache
    def found(side, finer):
        if side == "ours":
            return our_places(chain, population_mesh(), STEPS, finer)
        return mujoco_places(chain, WET[0], 1, STEPS, finer)

    return found


@pytest.mark.slow
def test_the_error_falls_with_the_step(places):
    """MuJoCo's error falls by the factor of the first order, to 25 %.

    Ours is smaller and falls at least as fast. A second-order error would fall by a factor of 17.
    Jumps of the commands leave a first-order error.
    """
    coarse, fine = (
        [typical_distance(places(side, n), places(side, FINER)) for side in ("ours", "MuJoCo")]
        for n in (1, 4)
    )
    assert coarse[1] / fine[1] == pytest.approx(EXPECTED, rel=0.25)
    assert 0.95 * EXPECTED < coarse[0] / fine[0] < 25
    assert 1e-6 < coarse[0] < 0.2 * coarse[1]


@pytest.mark.slow
def test_errors_are_in_body_lengths(chain, places):
    """The float32 motion at the step itself has about the error that its float64 twin has."""
    twin = typical_distance(places("ours", 1), places("ours", FINER)) / body_length(chain)
    # Rounding is about a tenth of this small error.
    assert our_error(chain, population_mesh()) == pytest.approx(twin, rel=0.2)
    peer = typical_distance(places("MuJoCo", 1), places("MuJoCo", FINER)) / body_length(chain)
    assert mujoco_error(chain, WET[0], 1) == pytest.approx(peer)


@pytest.mark.slow
def test_a_chains_body_length_is_from_centre_to_centre(chain):
    tree = chain.experiment.simulation.world.tree
    offset = tree.joint_offset[:, 1] + tree.joint_orientation[..., 1] @ tree.com[:, 1]
    assert body_length(chain) == pytest.approx(np.linalg.norm(offset - tree.com[:, 0]))


@pytest.mark.slow
def test_an_animal_is_measured_at_every_size(chain):
    """Both parts have a row for every kind of water, and a row for the largest population."""
    animal, plan = Animal("chain", chain, (1, 200, 208), flops=1000), Plan(2, None, 0.01, 2)
    rows = list(measure(animal, plan, 1e11))
    for size in animal.sizes:
        for part in (PHYSICS, WHOLE):
            own = [row for row in rows if (row.size, row.part) == (size, part)]
            assert [row.peer for row in own] == [kind.name for kind in WET]
            assert all(row.rate > 0 and row.peer_rate and row.ratio for row in own)
            assert all(row.note is None for row in own)
        physics = [row for row in rows if (row.size, row.part) == (size, PHYSICS)]
        assert all(0 < row.error < 0.2 * row.peer_error < 0.02 for row in physics)
        assert all(row.flops == pytest.approx(1000 * row.rate) for row in physics)
    large = [row for row in rows if row.part.endswith(", large")]
    assert [row.size for row in large] == [208, 208]
    assert all(row.ratio == pytest.approx(row.rate / row.peer_rate) for row in large)
