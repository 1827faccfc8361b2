"""The figure of accuracy falls with the step as a method of first order lets it."""

import dataclasses

import jax
import numpy as np
import pytest

from benchmarks.accuracy import (
    CROWD,
    FINER,
    body_length,
    mujoco_error,
    mujoco_places,
    our_error,
    our_places,
    typical_distance,
)
from benchmarks.exercise import Wave
from benchmarks.mujoco_peer import WET
from benchmarks.ours import compile_motion, full_lanes
from benchmarks.plan import experiment_of
from creatures import box_chain, in_water
from evo_cpg.creature.creature import Actuator
from evo_cpg.training.devices import population_mesh

STEPS = 120
# Of a first-order method, with a sixteenth of the step as the reference.
EXPECTED = (1 - 1 / FINER) / (1 / 4 - 1 / FINER)


@pytest.fixture(scope="module")
def chain():
    """Two boxes, of which one is made to beat by the wave."""
    experiment = experiment_of("iwadate2010_swimmer")
    creature = box_chain(2, "z", Actuator(5.0))
    simulation = dataclasses.replace(experiment.simulation, world=in_water(creature))
    return Wave(experiment._replace(creature=creature, simulation=simulation))


@pytest.mark.parametrize("side", ["ours", "MuJoCo"])
def test_the_error_falls_in_the_first_order(chain, side):
    """To within a quarter: 1 s is long enough for the second order to show a little."""
    mesh = population_mesh()

    def places(finer):
        if side == "ours":
            return our_places(chain, mesh, STEPS, finer)
        return mujoco_places(chain, WET[0], 1, STEPS, finer)

    exact, coarse, fine = (places(finer) for finer in (FINER, 1, 4))
    errors = [typical_distance(found, exact) for found in (coarse, fine)]
    assert errors[0] / errors[1] == pytest.approx(EXPECTED, rel=0.25)
    assert errors[0] > 1e-5


def test_errors_are_in_body_lengths(chain):
    """The float32 motion at the step itself has the error that its float64 twin has."""
    mesh = population_mesh()
    lanes = chain.lanes(full_lanes(CROWD, mesh))
    found = our_error(chain, compile_motion(chain, lanes, mesh), mesh)
    coarse, exact = (our_places(chain, mesh, STEPS, finer) for finer in (1, FINER))
    assert found == pytest.approx(typical_distance(coarse, exact) / body_length(chain), rel=0.01)
    assert 0 < mujoco_error(chain, WET[0], 1) < 0.1


def test_the_swimmers_body_length_is_that_between_its_ends():
    exercise = Wave(experiment_of("iwadate2010_swimmer"))
    tree = exercise.experiment.simulation.world.tree
    joints = np.linalg.norm(np.asarray(tree.joint_offset), axis=0).sum()
    assert joints * 0.8 < body_length(exercise) < joints * 1.3
    assert not jax.config.jax_enable_x64
