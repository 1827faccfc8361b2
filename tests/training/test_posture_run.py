"""Evolution of postures as bits, from a configuration to the last population."""

import numpy as np
import pytest
import yaml

from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import check_config
from evo_cpg.training.run_folder import RunFolder
from evo_cpg.training.train import train

# Two boxes in water on a dashpot hinge can flap.
FLAPPER = """
name: flapper
creature:
  name: flapper
  materials: {flesh: {density: 1000}}
  bodies:
    - {name: body, shape: {type: box, size: [0.2, 0.1, 0.1]}, material: flesh}
    - name: fin
      shape: {type: box, size: [0.2, 0.1, 0.02]}
      material: flesh
      joint:
        {parent: body, at: [-0.11, 0, 0], child_at: [0.11, 0, 0], axes: [y], limits_deg: [-75, 75],
         actuator: {gain: 0.5, stiffness: 10, torque_limit: 5}}
simulation: {seconds: 2}
controller: {type: postures}
task: {light: {distance: 1.0}}
evolution: {type: bits, generations: 4, mutated_genes: [2, 10]}
"""


@pytest.mark.slow
def test_postures_evolve(tmp_path):
    """Genes stay bits. The seven best are kept, so the best fitness never falls."""
    experiment = build_experiment(check_config(yaml.safe_load(FLAPPER), "flapper"), "flapper")
    folder = RunFolder(tmp_path / "run")
    folder.create(FLAPPER, {"devices": 1, "seed": 0})
    finished = train(experiment, folder)
    assert set(np.unique(finished.genes)) == {0.0, 1.0}
    assert finished.genes.shape == (24, 15)
    best = [row["best"] for row in finished.history]
    assert len(best) == 4 and np.all(np.diff(best) >= 0)
    assert all(row["diverged"] == 0 for row in finished.history)
    # The population has the champion's exact genome.
    assert (finished.genes == finished.champion.genes[:, None]).all(0).any()
