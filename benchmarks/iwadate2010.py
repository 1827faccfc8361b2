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

from evo_cpg.analysis.gait import gait
from evo_cpg.config.build import build_experiment
from evo_cpg.config.load import dump_config, load_config
from evo_cpg.simulation.rollout import as_recording, record, score
from evo_cpg.training.devices import fast_jit, population_mesh, use_cores
from evo_cpg.training.experiment import compile_trials, first_population
from evo_cpg.training.loop import replay_champion, train
from evo_cpg.training.run_folder import RunFolder

CONFIG = Path(__file__).parents[1] / "configs" / "iwadate2010_swimmer.yaml"
SEEDS = {"shared": range(5), "per_joint": range(3), "per_dof": range(3)}


def evolve(out: Path, drive: str, seed: int, devices: int) -> dict:
    """Train one run, or take it from OUT, and measure its champion."""
    config = load_config(CONFIG, [f"controller.drive={drive}", f"seed={seed}"])
    folder = RunFolder(out / f"{drive}-{seed}")
    if not folder.config.exists():
        folder.create(dump_config(config), {"devices": devices, "seed": seed})
    experiment = build_experiment(config, CONFIG)
    finished = train(experiment, folder)
    champion = finished.champion
    assert champion is not None
    _, terms, recording = replay_champion(experiment, champion, devices)
    folder.save_champion(champion, recording)
    rhythm = gait(recording)
    distance_at = [row["best_distance"] for row in finished.history]
    return {
        "drive": drive,
        "seed": seed,
        "fitness": champion.fitness,
        "generation": champion.generation,
        **terms,
        "first_under_10_percent": next(
            (i for i, distance in enumerate(distance_at) if distance < 0.1), None
        ),
        "axis": rhythm.axis,
        "frequency": rhythm.frequency.tolist(),
        "amplitude_deg": np.rad2deg(rhythm.amplitude).tolist(),
        "lag_deg": rhythm.lag.tolist(),
        "wave": rhythm.has_wave(),
    }


def random_search(seed: int) -> dict:
    """The best of as many random animals as a run evaluates."""
    experiment = build_experiment(load_config(CONFIG, [f"seed={seed}"]), CONFIG)
    simulation, size = experiment.simulation, experiment.genetics.population
    task, trials = simulation.task, compile_trials(simulation, population_mesh())
    scales: dict = {}
    fitness, distance = [], []
    for generation in range(experiment.generations):
        key = jax.random.fold_in(jax.random.key(1000 + seed), generation)
        genes = simulation.controller.random_genes(key, (size,), np.float32)
        outcome = trials(np.asarray(genes))
        scales = scales or task.scales(outcome.terms)
        fitness.append(np.asarray(score(task, outcome, scales)))
        distance.append(outcome.terms["distance"])
    best = int(np.concatenate(fitness).argmax())
    return {
        "seed": seed,
        "fitness": float(np.concatenate(fitness)[best]),
        "distance": float(np.concatenate(distance)[best]),
        "closest": float(np.nanmin(distance)),
    }


def untrained(count: int = 96) -> dict:
    """How many animals with random brains have a wave along the body."""
    config = load_config(CONFIG)
    experiment = build_experiment(config, CONFIG)
    simulation = experiment.simulation
    genes = first_population(experiment)[:, :count]
    frames = fast_jit(lambda genes: record(simulation, genes, count))(genes)
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
            study["runs"].append(evolve(out, drive, seed, devices))
            print(json.dumps(study["runs"][-1]), flush=True)
        if drive == "shared":
            study["untrained"] = untrained()
            print(study["untrained"], flush=True)
            for seed in seeds:
                study["random_search"].append(random_search(seed))
                print(study["random_search"][-1], flush=True)
    (out / "study.json").write_text(json.dumps(study, indent=1))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
