"""The study of the salamander: `python benchmarks/salamander.py OUT`.

Five seeds in water, on land, and across a shore; beside them random search with as many
evaluations, the champions of water and land in each other's world, and in both directions across
the shore. The tables go into docs/reproduction/salamander.md; OUT/study.json and the run folders
under OUT hold the rest.
"""

import json
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.study import evolve, random_search
from evo_cpg.config.build import build_experiment
from evo_cpg.config.load import load_config
from evo_cpg.training.devices import population_mesh, use_cores
from evo_cpg.training.experiment import compile_trials

CONFIGS = Path(__file__).parents[1] / "configs"
WORLDS = {
    "water": CONFIGS / "iwadate2010_salamander_water.yaml",
    "land": CONFIGS / "iwadate2010_salamander_land.yaml",
    "shore": CONFIGS / "salamander_amphibious.yaml",
}
SEEDS = range(5)


def put(
    animals: dict[str, np.ndarray], world: Path, overrides: Sequence[str] = ()
) -> dict[str, list[float]]:
    """Share of the distance that each animal leaves in each of a world's situations."""
    simulation = build_experiment(load_config(world, overrides), world).simulation
    count = len(simulation.situations)
    genes = np.stack(list(animals.values()), axis=1)
    numbers = np.tile(np.arange(count), len(animals)) if count > 1 else None
    outcome = compile_trials(simulation, population_mesh())(genes, None, numbers, count)
    shares = outcome.terms["distance"].reshape(-1, count)
    return {name: row.tolist() for name, row in zip(animals, shares, strict=True)}


def put_all(animals: dict[str, np.ndarray], name: str) -> dict[str, list[float]]:
    """Likewise for animals of all worlds, of which those of the shore alone have a depth gauge."""
    if name != "shore":
        return put(
            {key: x for key, x in animals.items() if not key.startswith("shore")}, WORLDS[name]
        )
    native = {key: x for key, x in animals.items() if key.startswith("shore")}
    others = {key: x for key, x in animals.items() if key not in native}
    return put(native, WORLDS[name]) | put(others, WORLDS[name], ["creature.depth_sensors=[]"])


def still() -> np.ndarray:
    """Genes of an animal whose brain gives its spinal cord no drive at all."""
    world = WORLDS["water"]
    controller = build_experiment(load_config(world), world).simulation.controller
    *_, hidden, outputs = controller.brain.sizes
    genes = np.zeros(controller.gene_count, np.float32)
    # The last layer's biases, each behind its weights.
    genes[-outputs * (hidden + 1) :].reshape(outputs, -1)[:, -1] = -60.0
    return genes


def main(out: Path) -> None:
    """Run the study, keeping what is done so that it can be stopped and gone on with."""
    devices = use_cores()
    study: dict = {name: {"runs": [], "random_search": []} for name in WORLDS}
    animals = {"motionless": still()}
    for name, world in WORLDS.items():
        for seed in SEEDS:
            measures, champion, _ = evolve(world, [f"seed={seed}"], out / f"{name}-{seed}", devices)
            animals[f"{name} {seed}"] = champion.genes
            study[name]["runs"].append(measures)
            print(name, json.dumps(measures), flush=True)
    for name in WORLDS:
        study[name]["animals"] = put_all(animals, name)
        print(name, json.dumps(study[name]["animals"]), flush=True)
    for name, world in WORLDS.items():
        for seed in SEEDS:
            study[name]["random_search"].append(random_search(world, seed))
            print(name, study[name]["random_search"][-1], flush=True)
    (out / "study.json").write_text(json.dumps(study, indent=1))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
