"""The shipped starfish under a constant drive: its arms follow the commanded rhythm in water."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from evo_cpg.analysis.gait import dominant_frequency, ring_lags
from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import load_config
from evo_cpg.native.engine import using
from evo_cpg.simulation.recording import Recorder, as_recording
from evo_cpg.simulation.rollout import rollout
from tiny_run import REPOSITORY

ARMS = [f"arm{j}_1.y" for j in range(1, 6)]


def constant_drive(*changes):
    """Return 8 s of motion of a starfish whose brain sets u = 0.5 and b = 5.5 everywhere."""
    path = REPOSITORY / "configs/starfish.yaml"
    experiment = build_experiment(load_config(path, ["simulation.seconds=8", *changes]), path)
    simulation = experiment.simulation
    genes = jnp.zeros((simulation.controller.gene_count, 1), jnp.float32)
    with using(simulation.engine):
        frames = jax.jit(lambda genes: rollout(simulation, genes, observers=Recorder()))(genes)
    return as_recording(simulation, frames, [body.name for body in experiment.creature.bodies])


@pytest.mark.slow
def test_arms_of_a_starfish_beat_one_after_the_other():
    motion = constant_drive()
    np.testing.assert_allclose(ring_lags(motion, ARMS), 72, atol=2)
    chosen = [motion.dof_names.index(name) for name in ARMS]
    step = float(motion.time[1] - motion.time[0])
    frequency = dominant_frequency(motion.joint_angle[240:, chosen], step)
    np.testing.assert_allclose(frequency, frequency[0], rtol=0.01)


@pytest.mark.slow
def test_arms_beat_together_without_the_ring():
    motion = constant_drive("controller.cpg.rings=[]")
    np.testing.assert_allclose(ring_lags(motion, ARMS), 0, atol=2)
