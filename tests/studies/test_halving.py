"""Ways of champions at smaller steps: of what keeps its way, and of what does not."""

import jax
import numpy as np

from evo_cpg.config.build import build_experiment
from evo_cpg.config.load import load_config
from evo_cpg.studies.halving import Ways, kept, ways
from tiny_run import CONFIG, PAIR


def test_a_swimmer_goes_as_far_at_half_the_step():
    """In water motion is no chaos: the step's error is what is left, and falls with the step."""
    config = load_config(CONFIG, [*PAIR, "simulation.steps=240"])
    simulation = build_experiment(config, CONFIG).simulation
    genes = np.asarray(simulation.genome.random(jax.random.key(1), (16,), np.float32)).T
    found = ways(simulation, genes)
    moves = found.own > 1e-3
    assert moves.sum() > 3
    found = Ways(*(way[moves] for way in found))
    np.testing.assert_allclose(found.hair, found.own, rtol=1e-3)
    first, second = np.abs(found.half - found.own), np.abs(found.quarter - found.half)
    assert first.max() > 1e-6
    assert np.median(second / first) < 0.75
    assert 0.9 < kept(found.own, found.half) <= 1


def test_what_is_kept_is_the_median_share_and_never_more_than_all():
    own = np.array([2.0, 4.0, 1.0])
    assert kept(own, np.array([1.0, 5.0, 0.9])) == 0.9
