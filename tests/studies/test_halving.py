"""Displacements of champions at smaller time steps."""

import jax
import numpy as np
import pytest

from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import load_config
from evo_cpg.studies.fukui2003 import Displacements, displacements, kept
from tiny_run import CONFIG, PAIR


@pytest.mark.slow
def test_a_swimmer_keeps_its_displacement_at_half_the_step():
    """Motion in water is not chaotic, so the difference falls with the step."""
    config = load_config(CONFIG, [*PAIR, "simulation.seconds=4"])
    simulation = build_experiment(config, CONFIG).simulation
    genes = np.asarray(simulation.genome.random(jax.random.key(1), (16,), np.float32)).T
    found = displacements(simulation, genes)
    moves = found.own > 1e-3
    assert moves.sum() > 3
    found = Displacements(*(each[moves] for each in found))
    np.testing.assert_allclose(found.hair, found.own, rtol=1e-3)
    first, second = np.abs(found.half - found.own), np.abs(found.quarter - found.half)
    assert first.max() > 1e-6
    assert np.median(second / first) < 0.75
    assert 0.9 < kept(found.own, found.half) <= 1


def test_the_kept_fraction_is_a_median_of_fractions_up_to_1():
    own = np.array([2.0, 4.0, 1.0])
    assert kept(own, np.array([1.0, 5.0, 0.9])) == 0.9
