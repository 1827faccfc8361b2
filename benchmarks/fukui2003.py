"""Chapter 4 of Fukui 2003, tested: `python benchmarks/fukui2003.py OUT [GENERATIONS [NAME ...]]`.

Each experiment is eight runs side by side. The three models without noise; Model 1 with a noisy
start and pushes, under the genetic algorithm as printed (7 kept, 8 replaced), under the one tried
first (5 and 10), and with the remedies that the thesis proposes: several copies of the best, and
several trials averaged; and the three models scored for their posture too, which the thesis
proposes for a walk. Noise and walk get half of the generations. Beside them: animals that hold one
posture, and random search.

What is done already in OUT is taken from there; with the NAMEs of experiments, only these are
evolved, and only which model goes farthest is reported, if all three are among them.
OUT/models.json, OUT/study.json, OUT/*.png and the run folders under OUT hold the results;
docs/reproduction/fukui2003.md reports them.
"""

import json
import sys
from collections.abc import Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy import stats

from evo_cpg.config.build import build_experiment
from evo_cpg.config.load import dump_config, load_config
from evo_cpg.control.controller import Controller
from evo_cpg.control.postures import PostureController
from evo_cpg.training.checkpoint import Champion, Checkpoint
from evo_cpg.training.devices import population_mesh, use_cores
from evo_cpg.training.experiment import Experiment, compile_trials
from evo_cpg.training.loop import train
from evo_cpg.training.run_folder import RunFolder

CONFIGS = Path(__file__).parents[1] / "configs"
TORSO = 0.6  # m
NOISE = ["noise.joint_angle_deg=1", "noise.tilt_deg=1", "noise.push=0.02"]
# The weights of configs/hexapod.yaml, as they were before the first of these runs.
WALK = ["task.type=walk", "task.tilt_weight=20", "task.bounce_weight=20", "task.airborne_weight=10"]
EXPERIMENTS = {
    "model1": (1, []),
    "model2": (2, []),
    "model3": (3, []),
    "noise, 7 kept": (1, NOISE),
    "noise, 5 kept": (1, [*NOISE, "evolution.elites=5"]),
    "noise, 3 copies": (1, [*NOISE, "evolution.best_copies=3"]),
    "noise, 3 trials": (1, [*NOISE, "simulation.trials=3"]),
    "model1, walk": (1, WALK),
    "model2, walk": (2, WALK),
    "model3, walk": (3, WALK),
}
MODELS = ("model1", "model2", "model3")
WALKS = {model: f"{model}, walk" for model in MODELS}
NOISES = [name for name in EXPERIMENTS if name.startswith("noise")]
MODEL_PAIRS = (("model2", "model3"), ("model3", "model1"), ("model2", "model1"))
NOISE_PAIRS = (
    ("model1", "noise, 7 kept"),
    ("noise, 7 kept", "noise, 5 kept"),
    ("noise, 7 kept", "noise, 3 copies"),
    ("noise, 7 kept", "noise, 3 trials"),
)
# Of a fall of the best distance from its highest so far that counts as the loss of a lineage.
COLLAPSE = 0.25
HELD_ANGLE = 170.0  # degrees; of the allowed angles one of the two next to straight down
RANDOM_SEED = 1000  # none of the runs has it
# Okabe and Ito's colours without yellow, which is too faint for a line on white.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#E69F00", "#CC79A7", "#56B4E9", "#000000")


def generation_count(name: str, generations: int) -> int:
    """Of an experiment; those beside the thesis's three models get half as many."""
    return generations if name in MODELS else max(generations // 2, 1)


def load(model: int, overrides: list[str]) -> tuple[Experiment, str]:
    path = CONFIGS / f"fukui2003_model{model}.yaml"
    config = load_config(path, overrides)
    return build_experiment(config, path), dump_config(config)


def evolve(out: Path, name: str, generations: int, devices: int) -> Checkpoint:
    """The eight runs of an experiment after the last generation."""
    model, overrides = EXPERIMENTS[name]
    experiment, text = load(model, [*overrides, f"evolution.generations={generations}"])
    folder = RunFolder(out / name.replace(", ", "-").replace(" ", "-"))
    if not folder.config.exists():
        folder.create(text, {"devices": devices, "seed": experiment.seed})
    return train(experiment, folder)


def best_distances(runs: Checkpoint, generations: int) -> np.ndarray:
    """Best distance (m) of every generation and run ``(generations, runs)``."""
    best = np.array([row["best_distance"] for row in runs.history])
    return best.reshape(generations, len(runs.champions))


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


def one_posture(controller: Controller, angle: float) -> np.ndarray:
    """The genome in whose every posture all joints have one angle (degrees)."""
    assert isinstance(controller, PostureController)
    settings = controller.settings
    number = round((angle - settings.lowest_angle) / settings.angle_step)
    bits = [number >> place & 1 for place in reversed(range(settings.bits_per_joint))]
    return np.tile(np.array(bits, np.float32), controller.gene_count // settings.bits_per_joint)


def measure(
    out: Path, model: str, generations: int, champions: dict[str, tuple[Champion | None, ...]]
) -> dict:
    """Trials beside the evolution of a model, and its champions' once more.

    All are tried under the walk task, which reports the distance too, and by one program in
    batches as large as in training, so that all are measured alike. The distance in training
    stands beside that of the champions: a trial rounded otherwise would end elsewhere.

    Args:
        out: where the result is kept.
        model: name of the experiment without noise.
        generations: that a run evolves; random search tries as many animals as one run does.
        champions: of the runs, by what they evolved for.
    """
    kept = out / f"{model}-measured-{generations}.json"
    if kept.exists():
        return json.loads(kept.read_text())
    experiment, _ = load(*EXPERIMENTS[WALKS[model]])
    simulation, population = experiment.simulation, experiment.strategy.population
    batch = experiment.runs * population
    trials = compile_trials(simulation, population_mesh())

    def terms(genes: np.ndarray) -> dict[str, np.ndarray]:
        count = genes.shape[1]
        outcome = trials(np.pad(genes, ((0, 0), (0, batch - count)), mode="edge"))
        return {
            name: np.where(outcome.alive, values, np.nan)[:count]
            for name, values in outcome.terms.items()
        }

    def random_distances(number: int) -> np.ndarray:
        key = jax.random.fold_in(jax.random.key(RANDOM_SEED), number)
        genes = simulation.controller.random_genes(key, (batch,), np.float32)
        return terms(np.asarray(genes))["distance"]

    batches = max(round(generations * population / batch), 1)
    distance = np.concatenate([random_distances(number) for number in range(batches)])
    held = one_posture(simulation.controller, HELD_ANGLE)
    result: dict = {
        "one_posture_held_m": float(terms(held[:, None])["distance"][0]),
        "random_search": {
            "animals": distance.size,
            "best_m": float(np.nanmax(distance)),
            "median_m": float(np.nanmedian(distance)),
        },
        "champions": {},
    }
    for evolved_for, found in champions.items():
        living = [champion for champion in found if champion is not None]
        measured = terms(np.stack([champion.genes for champion in living], axis=1))
        result["champions"][evolved_for] = {
            **{name: values.tolist() for name, values in measured.items()},
            "walk_score": simulation.task.fitness(jax.tree.map(jnp.asarray, measured), {}).tolist(),
            "distance_in_training": [champion.terms["distance"] for champion in living],
        }
    kept.write_text(json.dumps(result))
    return result


def panel(width: float) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(width, 4.6), layout="constrained")
    axes = figure.subplots()
    axes.grid(alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)
    return figure, axes


def draw(bests: dict[str, np.ndarray], path: Path, single_runs: bool) -> None:
    """Medians over the runs with quartile bands; single runs thin, if at all."""
    figure, axes = panel(8)
    for (name, best), color in zip(bests.items(), COLORS[: len(bests)], strict=True):
        generation = np.arange(len(best))
        low, middle, high = np.nanquantile(best, (0.25, 0.5, 0.75), axis=1)
        if single_runs:
            axes.plot(generation, best, color=color, lw=0.5, alpha=0.25)
        axes.fill_between(generation, low, high, color=color, alpha=0.15, lw=0)
        axes.plot(generation, middle, color=color, lw=2, label=name)
    axes.set_xlabel("generation")
    axes.set_ylabel("best distance in 20 s (m)")
    axes.set_ylim(bottom=0)
    axes.legend(frameon=False, title="median of 8 runs, half of them in the band")
    figure.savefig(path, dpi=130)


def draw_run_or_walk(champions: dict[str, dict[str, dict]], path: Path) -> None:
    """Distance against tilt of every run's champion, by model and by what it evolved for."""
    figure, axes = panel(6)
    for (model, by_score), color in zip(champions.items(), COLORS[: len(champions)], strict=True):
        for (evolved_for, terms), fill in zip(by_score.items(), ("none", color), strict=True):
            axes.scatter(
                terms["tilt"],
                terms["distance"],
                edgecolors=color,
                facecolors=fill,
                label=f"{model}, evolved to {evolved_for}",
            )
    axes.set_xlabel("mean tilt of the torso: 0 upright, 1 on its side, 2 on its back")
    axes.set_ylabel("distance in 20 s (m)")
    axes.set_xlim(left=-0.05)
    axes.set_ylim(bottom=0)
    figure.legend(frameon=False, ncols=2, loc="outside upper center")
    figure.savefig(path, dpi=130)


def compare(
    experiments: dict[str, dict], pairs: Sequence[tuple[str, str]]
) -> dict[str, dict[str, float]]:
    """Whether values differ from the runs of one experiment to another's: p, two-sided."""
    return {
        value: {
            f"{first} / {second}": float(
                stats.mannwhitneyu(experiments[first][value], experiments[second][value]).pvalue
            )
            for first, second in pairs
        }
        for value in ("champions_m", "last_tenth_median_m")
    }


def report_models(out: Path, generations: int, runs: dict[str, Checkpoint]) -> None:
    """Which of the three models goes farthest."""
    bests = {model: best_distances(runs[model], generations) for model in MODELS}
    experiments = {model: summary(best) for model, best in bests.items()}
    farthest = [experiments[model]["champions_m"] for model in MODELS]
    found = {
        "generations": generations,
        "experiments": experiments,
        "kruskal_models_p": float(stats.kruskal(*farthest).pvalue),
        "mann_whitney_p": compare(experiments, MODEL_PAIRS),
    }
    (out / "models.json").write_text(json.dumps(found, indent=1))
    draw(bests, out / "fukui2003_models.png", single_runs=True)


def main(out: Path, generations: int, names: Sequence[str] = ()) -> None:
    """Run the study, keeping what is done so that it can be stopped and gone on with."""
    devices = use_cores()
    runs = {}
    for name in names or EXPERIMENTS:
        runs[name] = evolve(out, name, generation_count(name, generations), devices)
        print(f"{name}: done", flush=True)
    if set(MODELS) <= set(runs):
        report_models(out, generations, runs)
    if names:
        return
    bests = {
        name: best_distances(runs[name], generation_count(name, generations)) for name in NOISES
    }
    measured = {
        model: measure(
            out,
            model,
            generations,
            {"run": runs[model].champions, "walk": runs[WALKS[model]].champions},
        )
        for model in MODELS
    }
    without = best_distances(runs["model1"], generations)
    experiments = {name: summary(best) for name, best in ({"model1": without} | bests).items()}
    study = {
        "generations": generations,
        "experiments": experiments,
        "measured": measured,
        "mann_whitney_p": compare(experiments, NOISE_PAIRS),
    }
    (out / "study.json").write_text(json.dumps(study, indent=1))
    draw(
        {"no noise": without[: generation_count(NOISES[0], generations)]} | bests,
        out / "fukui2003_noise.png",
        single_runs=False,
    )
    draw_run_or_walk(
        {model: measured[model]["champions"] for model in MODELS},
        out / "fukui2003_run_or_walk.png",
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]), int((sys.argv[2:3] or ["500"])[0]), sys.argv[3:])
