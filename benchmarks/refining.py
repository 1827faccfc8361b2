"""Compare gradients with generations: `python -m benchmarks.refining OUT [CONFIG] [KEY=VALUE ...]`.

Several runs evolve side by side. Then three methods run for equal times, without compilation:
refinement of each champion, further evolution, and further evolution whose elites learn. The
program prints the gained fitness of each method for docs/models/gradients.md, run by run and as
quartiles. OUT/refining.json and the run folders under OUT hold the rest.
"""

import argparse
import contextlib
import json
import shutil
import statistics
from pathlib import Path

import numpy as np

from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import dump_config, load_config
from evo_cpg.training.devices import use_cores
from evo_cpg.training.experiment import ExperimentParts, Learning
from evo_cpg.training.refine import Refinement, Round, compile_refinement
from evo_cpg.training.run_folder import Checkpoint, RunFolder
from evo_cpg.training.train import train

SWIMMER = Path(__file__).parents[1] / "configs" / "iwadate2010_swimmer.yaml"
RUNS = 5
# Six elites of each of five runs are 30 individuals, which almost fill the two vectors of 16 on two
# cores.
LEARNING = Learning(every=5, learners=6, steps=5)


def main() -> None:
    """Evolve, continue by each method for the same time, then print and store the fitness."""
    parser = argparse.ArgumentParser(prog="benchmarks.refining", description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("config", type=Path, nargs="?", default=SWIMMER)
    parser.add_argument("overrides", nargs="*", metavar="KEY=VALUE")
    parser.add_argument("--rounds", type=int, default=2)
    slow = "skip the third method, which takes minutes to compile"
    parser.add_argument("--skip-learning", action="store_true", help=slow)
    chosen = parser.parse_args()
    out, config_file, overrides = chosen.out, chosen.config, chosen.overrides
    devices = use_cores()
    config = load_config(config_file, [f"runs={RUNS}", *overrides])
    experiment = build_experiment(config, config_file)
    start = RunFolder(out / "start")
    if not start.config.exists():
        start.create(dump_config(config), {"devices": devices})
    started = train(experiment, start, _tell)
    before = [champion.fitness for champion in started.champions if champion]
    refined, seconds = _refine(experiment, started, chosen.rounds)
    methods = {"refined": refined, "evolved": _evolve(experiment, start, out / "evolved", seconds)}
    if not chosen.skip_learning:
        learner = experiment._replace(learning=LEARNING)
        methods["learned"] = _evolve(learner, start, out / "learned", seconds)
    study = {"before": before, "seconds": seconds, **methods}
    (out / "refining.json").write_text(json.dumps(study, indent=2))
    print(f"\n{config.name}: {experiment.generations} generations, then {seconds:.0f} s a method\n")
    print("| run | before | " + " | ".join(methods) + " |\n|---|---|" + "---|" * len(methods))
    gains = {name: np.subtract(after, before) for name, after in methods.items()}
    for run, fitness in enumerate(before):
        print(f"| {run} | {fitness:.4f} | " + _row(gain[run] for gain in gains.values()))
    for name, percentile in (("median", 50), ("lower quartile", 25), ("upper quartile", 75)):
        middle = np.percentile(before, percentile)
        print(
            f"| {name} | {middle:.4f} | "
            + _row(np.percentile(g, percentile) for g in gains.values())
        )


def _refine(
    experiment: ExperimentParts, started: Checkpoint, count: int
) -> tuple[list[float], float]:
    """Return every champion's refined fitness, and the time for each without compilation, s."""
    refine = compile_refinement(experiment, Refinement(count))
    rounds: list[Round] = []

    def keep(done: Round) -> None:
        rounds.append(done)
        print(f"round {done.number}: {done.champion.fitness:.4f}, {done.seconds:.1f} s", flush=True)

    after = [refine(champion, keep).fitness for champion in started.champions if champion]
    # The first round also compiles, so its time does not count.
    return after, count * statistics.median(done.seconds for done in rounds[1:])


def _evolve(
    experiment: ExperimentParts, start: RunFolder, path: Path, seconds: float
) -> list[float]:
    """Return every champion's fitness after more training, for ``seconds`` (s) per run."""
    shutil.rmtree(path, ignore_errors=True)
    folder = RunFolder(shutil.copytree(start.path, path))
    spent: list[float] = []

    class Enough(Exception):
        pass

    def watch(rows: list[dict[str, float]]) -> None:
        spent.append(rows[0]["seconds"])
        _tell(rows)
        # A generation that compiles counts like the other generations of its kind.
        every = experiment.learning.every if experiment.learning else 1
        kinds = [spent[i::every] for i in range(min(every, len(spent)))]
        plain = [statistics.median(kind[1:] or kind) * len(kind) for kind in kinds]
        if len(spent) > every and sum(plain) > seconds * experiment.runs:
            raise Enough

    with contextlib.suppress(Enough):
        train(experiment._replace(generations=10**6), folder, watch)
    done = folder.load()
    assert done is not None
    print(f"{path.name}: {len(spent)} generations", flush=True)
    return [champion.fitness for champion in done.champions if champion]


def _tell(rows: list[dict[str, float]]) -> None:
    best = " ".join(f"{row['champion']:.4f}" for row in rows)
    print(f"generation {rows[0]['generation']}: {best}, {rows[0]['seconds']:.1f} s", flush=True)


def _row(values) -> str:
    return " | ".join(f"{value:+.4f}" for value in values) + " |"


if __name__ == "__main__":
    main()
