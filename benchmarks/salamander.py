"""The study of the salamander: `python benchmarks/salamander.py OUT`.

Five seeds in water, on land, and across a shore; beside them random search with as many
evaluations, the champions of water and land in each other's world, and in both directions across
the shore. The tables go into docs/reproduction/salamander.md; OUT/study.json and the run folders
under OUT hold the rest.
"""

import json
import sys
from pathlib import Path

import numpy as np

from benchmarks.study import evolve, random_search
from evo_cpg.config.build import build_experiment
from evo_cpg.config.load import load_config
from evo_cpg.training.devices import use_cores
from evo_cpg.training.probe import probe

CONFIGS = Path(__file__).parents[1] / "configs"
WORLDS = {
    "water": CONFIGS / "iwadate2010_salamander_water.yaml",
    "land": CONFIGS / "iwadate2010_salamander_land.yaml",
    "shore": CONFIGS / "salamander_amphibious.yaml",
}
SEEDS = range(5)


def put(genes: np.ndarray, world: Path) -> list[float]:
    """Share of the distance that an animal leaves in each of a world's situations."""
    simulation = build_experiment(load_config(world), world).simulation
    return [float(share) for share in probe(simulation, genes, simulation.situations).distance]


def still(world: Path) -> list[float]:
    """The same of an animal whose brain gives its spinal cord no drive at all."""
    controller = build_experiment(load_config(world), world).simulation.controller
    inputs, *hidden, outputs = controller.brain.sizes
    del inputs
    genes = np.zeros(controller.gene_count, np.float32)
    # The last layer's biases, each behind its weights.
    genes[-outputs * (hidden[-1] + 1) :].reshape(outputs, -1)[:, -1] = -60.0
    return put(genes, world)


def main(out: Path) -> None:
    """Run the study, keeping what is done so that it can be stopped and gone on with."""
    devices = use_cores()
    study: dict = {}
    for name, world in WORLDS.items():
        found = study[name] = {"runs": [], "random_search": []}
        for seed in SEEDS:
            measures, champion, _ = evolve(world, [f"seed={seed}"], out / f"{name}-{seed}", devices)
            measures["elsewhere"] = {
                other: put(champion.genes, place) for other, place in WORLDS.items()
            }
            found["runs"].append(measures)
            print(name, json.dumps(measures), flush=True)
        for seed in SEEDS:
            found["random_search"].append(random_search(world, seed))
            print(name, found["random_search"][-1], flush=True)
        found["still"] = still(world)
    (out / "study.json").write_text(json.dumps(study, indent=1))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
