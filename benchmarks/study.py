"""What the studies share: a run and the measures of its champion, random search, one champion
in another world.
"""

from pathlib import Path

import jax
import numpy as np

from evo_cpg.config.build import build_experiment
from evo_cpg.config.load import dump_config, load_config
from evo_cpg.simulation.recording import Recording
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.experiment import compile_trials, judge, situation_numbers
from evo_cpg.training.loop import replay_champion, train
from evo_cpg.training.run_folder import Champion, RunFolder

# "Near the light": this share of the distance at the start is left.
NEAR = 0.1


def evolve(
    config_file: Path, overrides: list[str], run: Path, devices: int
) -> tuple[dict, Champion, Recording]:
    """Train one run, or take it from its folder, and replay its champion.

    Returns:
        What it amounts to, the champion, and its way.
    """
    config = load_config(config_file, overrides)
    folder = RunFolder(run)
    if not folder.config.exists():
        folder.create(dump_config(config), {"devices": devices, "seed": config.seed})
    experiment = build_experiment(config, config_file)
    finished = train(experiment, folder)
    champion = finished.champion
    assert champion is not None
    _, terms, recording = replay_champion(experiment, champion, devices)
    folder.save_champion(champion, recording)
    distance_at = [row["best_distance"] for row in finished.history]
    measures = {
        "seed": config.seed,
        "fitness": champion.fitness,
        "generation": champion.generation,
        **terms,
        "first_under_10_percent": next(
            (i for i, distance in enumerate(distance_at) if distance < NEAR), None
        ),
    }
    return measures, champion, recording


def random_search(config_file: Path, seed: int, overrides: tuple[str, ...] = ()) -> dict:
    """The best of as many random animals as a run evaluates."""
    config = load_config(config_file, [*overrides, f"seed={seed}"])
    experiment = build_experiment(config, config_file)
    simulation, size = experiment.simulation, experiment.strategy.population
    task, trials = simulation.task, compile_trials(simulation, population_mesh())
    situations = situation_numbers(experiment)
    numbers = None if situations is None else np.tile(situations, size)
    scales: dict = {}
    fitness, distance = [], []
    for generation in range(experiment.generations):
        key = jax.random.fold_in(jax.random.key(1000 + seed), generation)
        genes = simulation.controller.random_genes(key, (size,), np.float32)
        outcome = trials(np.asarray(genes), None, numbers, experiment.trials)
        outcome = outcome._replace(
            terms={name: np.where(outcome.alive, x, np.nan) for name, x in outcome.terms.items()}
        )
        scales = scales or task.scales(outcome.terms)
        grouped = jax.tree.map(lambda x: x.reshape(size, experiment.trials), outcome)
        score, mean = judge(task, grouped, scales)
        fitness.append(np.asarray(score))
        distance.append(np.asarray(mean.terms["distance"]))
    best = int(np.concatenate(fitness).argmax())
    return {
        "seed": seed,
        "fitness": float(np.concatenate(fitness)[best]),
        "distance": float(np.concatenate(distance)[best]),
        "closest": float(np.nanmin(distance)),
    }
