"""Chapter 4 of Fukui 2003, tested: `python benchmarks/fukui2003.py OUT [GENERATIONS]`.

Each experiment is eight runs side by side. The three models without noise; Model 1 with a noisy
start and pushes, under the genetic algorithm as printed (7 kept, 8 replaced), under the one tried
first (5 and 10), and with the remedies that the thesis proposes: several copies of the best, and
several trials averaged. Beside them: animals that stand still, and random search.

What is done already in OUT is taken from there. OUT/study.json, OUT/*.png and the run folders
under OUT hold the results; docs/reproduction/fukui2003.md reports them.
"""

import json
import sys
from pathlib import Path

import jax
import numpy as np
from matplotlib.figure import Figure
from scipy import stats

from evo_cpg.config.build import build_experiment
from evo_cpg.config.load import dump_config, load_config
from evo_cpg.training.devices import population_mesh, use_cores
from evo_cpg.training.experiment import Experiment, compile_trials
from evo_cpg.training.loop import train
from evo_cpg.training.run_folder import RunFolder

CONFIGS = Path(__file__).parents[1] / "configs"
TORSO = 0.6  # m
NOISE = ["noise.joint_angle_deg=1", "noise.tilt_deg=1", "noise.push=0.02"]
EXPERIMENTS = {
    "model1": (1, []),
    "model2": (2, []),
    "model3": (3, []),
    "noise, 7 kept": (1, NOISE),
    "noise, 5 kept": (1, [*NOISE, "evolution.elites=5"]),
    "noise, 3 copies": (1, [*NOISE, "evolution.best_copies=3"]),
    "noise, 3 trials": (1, [*NOISE, "simulation.trials=3"]),
}
MODELS = ("model1", "model2", "model3")
# Of a fall of the best distance from its highest so far that counts as the loss of a lineage.
COLLAPSE = 0.25


def load(model: int, overrides: list[str]) -> tuple[Experiment, str]:
    path = CONFIGS / f"fukui2003_model{model}.yaml"
    config = load_config(path, overrides)
    return build_experiment(config, path), dump_config(config)


def evolve(out: Path, name: str, generations: int, devices: int) -> np.ndarray:
    """Best distance (m) of every generation and run ``(generations, runs)``."""
    model, overrides = EXPERIMENTS[name]
    experiment, text = load(model, [*overrides, f"evolution.generations={generations}"])
    folder = RunFolder(out / name.replace(", ", "-").replace(" ", "-"))
    if not folder.config.exists():
        folder.create(text, {"devices": devices, "seed": experiment.seed})
    rows = train(experiment, folder).history
    best = np.full((generations, experiment.runs), np.nan)
    for row in rows:
        best[int(row["generation"]), int(row["run"])] = row["best_distance"]
    return best


def random_search(model: int, batches: int) -> np.ndarray:
    """Distances (m) of random animals, ``(batches, 120)``."""
    experiment, _ = load(model, [])
    trials = compile_trials(experiment.simulation, population_mesh())
    distances = []
    for batch in range(batches):
        key = jax.random.fold_in(jax.random.key(1000), batch)
        size = (experiment.runs * experiment.genetics.population,)
        genes = experiment.simulation.controller.random_genes(key, size, np.float32)
        distances.append(trials(np.asarray(genes)).terms["distance"])
    return np.array(distances)


def summary(best: np.ndarray) -> dict:
    """What became of the runs of one experiment."""
    champions = np.nanmax(best, 0)
    highest = np.maximum.accumulate(best, 0)
    fallen = best < (1 - COLLAPSE) * highest
    return {
        "champions_m": champions.tolist(),
        "champion_median_lengths": float(np.median(champions) / TORSO),
        "last_tenth_median_m": np.median(best[-max(len(best) // 10, 1) :], 0).tolist(),
        "falls_per_run": (np.diff(fallen.astype(int), axis=0) == 1).sum(0).tolist(),
        "share_of_generations_fallen": fallen.mean(0).tolist(),
    }


def draw(bests: dict[str, np.ndarray], path: Path) -> None:
    """Medians over the runs with quartile bands; single runs thin."""
    figure = Figure(figsize=(8, 4.6), layout="constrained")
    axes = figure.subplots()
    for (name, best), color in zip(
        bests.items(), ("#0072B2", "#D55E00", "#009E73", "#E69F00"), strict=False
    ):
        generation = np.arange(len(best))
        low, middle, high = np.nanquantile(best, (0.25, 0.5, 0.75), axis=1)
        axes.plot(generation, best, color=color, lw=0.5, alpha=0.25)
        axes.fill_between(generation, low, high, color=color, alpha=0.2, lw=0)
        axes.plot(generation, middle, color=color, lw=2, label=name)
    axes.set_xlabel("generation")
    axes.set_ylabel("best distance in 20 s (m)")
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, title="median of 8 runs, half of them in the band")
    figure.savefig(path, dpi=130)


def main(out: Path, generations: int) -> None:
    """Run the study, keeping what is done so that it can be stopped and gone on with."""
    devices = use_cores()
    study: dict = {"generations": generations, "experiments": {}, "random_search": {}}
    bests = {}
    for name in EXPERIMENTS:
        bests[name] = evolve(out, name, generations, devices)
        study["experiments"][name] = summary(bests[name])
        print(name, json.dumps(study["experiments"][name]), flush=True)
    for model in (1, 2, 3):
        distance = random_search(model, max(generations // 12, 1))
        study["random_search"][f"model{model}"] = {
            "animals": int(distance.size),
            "best_m": float(np.nanmax(distance)),
            "median_m": float(np.nanmedian(distance)),
        }
    champions = {name: study["experiments"][name]["champions_m"] for name in study["experiments"]}
    study["kruskal_models_p"] = float(stats.kruskal(*(champions[m] for m in MODELS)).pvalue)
    study["mann_whitney_p"] = {
        f"{first} / {second}": float(stats.mannwhitneyu(champions[first], champions[second]).pvalue)
        for first, second in (
            ("model2", "model3"),
            ("model3", "model1"),
            ("model2", "model1"),
            ("noise, 7 kept", "noise, 5 kept"),
            ("noise, 7 kept", "noise, 3 copies"),
            ("noise, 7 kept", "noise, 3 trials"),
        )
    }
    print(json.dumps({key: study[key] for key in study if key != "experiments"}), flush=True)
    draw({name: bests[name] for name in MODELS}, out / "fukui2003_models.png")
    draw(
        {name: best for name, best in bests.items() if name not in MODELS},
        out / "fukui2003_noise.png",
    )
    (out / "study.json").write_text(json.dumps(study, indent=1))


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 500)
