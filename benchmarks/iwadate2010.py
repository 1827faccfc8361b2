"""The reproduction study of Iwadate 2010: `python benchmarks/iwadate2010.py OUT`.

Five seeds (three of the other drives) are evolved for 50 generations. Beside them: random search
with as many evaluations, and how often untrained animals have a wave. The tables go into
docs/reproduction/iwadate2010.md; OUT/study.json and the run folders under OUT hold the rest.
"""

import json
import sys
from pathlib import Path

import jax
import numpy as np

from benchmarks.study import evolve, random_search
from evo_cpg.analysis.gait import gait
from evo_cpg.config.build import build_experiment
from evo_cpg.config.load import load_config
from evo_cpg.simulation.rollout import as_recording, record
from evo_cpg.training.devices import use_cores
from evo_cpg.training.experiment import first_population

CONFIG = Path(__file__).parents[1] / "configs" / "iwadate2010_swimmer.yaml"
SEEDS = {"shared": range(5), "per_joint": range(3), "per_dof": range(3)}


def run(out: Path, drive: str, seed: int, devices: int) -> dict:
    """Train one run, or take it from OUT, and measure its champion."""
    overrides = [f"controller.drive={drive}", f"seed={seed}"]
    measures, _, recording = evolve(CONFIG, overrides, out / f"{drive}-{seed}", devices)
    rhythm = gait(recording)
    return {
        "drive": drive,
        **measures,
        "axis": rhythm.axis,
        "frequency": rhythm.frequency.tolist(),
        "amplitude_deg": np.rad2deg(rhythm.amplitude).tolist(),
        "lag_deg": rhythm.lag.tolist(),
        "wave": rhythm.has_wave(),
    }


def untrained(count: int = 96) -> dict:
    """How many animals with random brains have a wave along the body."""
    config = load_config(CONFIG)
    experiment = build_experiment(config, CONFIG)
    simulation = experiment.simulation
    genes = first_population(experiment)[:, :count]
    frames = jax.jit(lambda genes: record(simulation, genes, count))(genes)
    names = [body.name for body in experiment.creature.bodies]
    waves = 0
    for i in range(count):
        recording = as_recording(simulation, frames, names, i)
        waves += gait(recording).has_wave()
    return {"animals": count, "waves": waves}


def main(out: Path) -> None:
    """Run the study, keeping what is done so that it can be stopped and gone on with."""
    devices = use_cores()
    study: dict = {"runs": [], "random_search": []}
    for drive, seeds in SEEDS.items():
        for seed in seeds:
            study["runs"].append(run(out, drive, seed, devices))
            print(json.dumps(study["runs"][-1]), flush=True)
        if drive == "shared":
            study["untrained"] = untrained()
            print(study["untrained"], flush=True)
            for seed in seeds:
                study["random_search"].append(random_search(CONFIG, seed))
                print(study["random_search"][-1], flush=True)
    (out / "study.json").write_text(json.dumps(study, indent=1))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
