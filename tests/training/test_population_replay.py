"""Individuals of a population that are replayed side by side."""

import numpy as np
import pytest

from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import load_config
from evo_cpg.training.checkpoint import Champion, Checkpoint
from evo_cpg.training.evaluate import compile_population_replay, compile_replay
from evo_cpg.training.experiment import begin, placeholder_scales
from tiny_run import CONFIG, PAIR


@pytest.mark.slow
def test_individuals_side_by_side_move_as_in_their_own_replays():
    """Each has the noise of its own place and run, so no two of them are the same."""
    settings = [*PAIR, "runs=2", "noise.joint_angle_deg=5", "noise.push=0.05"]
    config = load_config(CONFIG, settings)
    experiment = build_experiment(config, CONFIG)
    genes = np.asarray(begin(experiment)[0])
    checkpoint = Checkpoint(4, genes, (None, None), [], placeholder_scales(experiment))
    places = [6, 1, 4]
    found = compile_population_replay(experiment)(checkpoint, 1, places)
    replay = compile_replay(experiment, 1)
    for place, one in zip(places, found, strict=True):
        scales = dict.fromkeys(checkpoint.scales, 1.0)
        alone = Champion(genes[:, 8 + place], 0.0, 4, {}, scales, 1, place)
        own = replay(alone)
        assert one.fitness == pytest.approx(own.fitness, rel=1e-4)
        np.testing.assert_allclose(one.recording.position, own.recording.position, atol=1e-4)
        np.testing.assert_allclose(one.recording.joint_angle, own.recording.joint_angle, atol=1e-3)
    assert len({each.fitness for each in found}) == 3
