"""Tables of champions near a light, compared with random search and an undriven animal."""

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np

from evo_cpg.control.brain_cpg import silent_genes
from evo_cpg.simulation.noise import Noise
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.studies.study import Table, beside, middle, percent, tabled
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.evaluate import compile_trials

if TYPE_CHECKING:
    from evo_cpg.studies.workshop import Workshop

# "Near the light": less than this fraction of the initial distance is left.
NEAR = 0.1


def light_table(
    workshop: "Workshop", evolved: str, random: str | None = None, *more: Mapping[str, str]
) -> Table:
    """Return a table with a row for each champion, then medians.

    Args:
        workshop: maker of the study, with the runs.
        evolved: name of the evolved runs.
        random: name of the runs of random search, if any.
        more: further rows.
    """
    rows, fitness = [], {}
    for title, name in (("evolved", evolved), ("random search", random)):
        if name is None:
            continue
        found, near = workshop.champions(name), workshop.column(name, "best_distance") < NEAR
        seed = workshop.experiment(name).seed
        for champion in found:
            under = near[:, champion.run]
            rows.append(
                {
                    "": title,
                    "seed": str(seed + champion.run),
                    "fitness": f"{champion.worth:.3f}",
                    **_terms(champion.terms),
                    "under 10 % after generation": str(under.argmax()) if under.any() else "never",
                }
            )
            title = ""
        fitness[name] = [champion.worth for champion in found]
        left = [100 * champion.terms["distance"] for champion in found]
        cells = {"fitness": middle(fitness[name], 3), "distance left": f"{middle(left, 1)} %"}
        rows.append({"": "median (range)"} | cells)
    if random is not None:
        words = beside(fitness, random)[evolved]
        rows.append({"": "evolution beats random search", "fitness": words})
    return tabled([*rows, *more])


def _terms(terms: Mapping[str, float]) -> dict[str, str]:
    """Return the cells for terms of the task."""
    return {
        "distance left": percent(terms["distance"]),
        "light seen": f"{terms['light']:.2f}",
        "energy (J)": f"{terms['energy']:.0f}",
    }


def still(workshop: "Workshop", name: str) -> dict[str, str]:
    """Return the row of an animal whose brain gives the spinal cord no drive.

    The fitness uses the scales of the first run.
    """
    simulation = workshop.experiment(name).simulation
    silent = simulation.genome.with_controller(silent_genes(simulation.controller)[:, None])
    terms = {key: x.mean() for key, x in evaluate(simulation, silent).items()}
    scales = {key: jnp.asarray(x) for key, x in workshop.champions(name)[0].scales.items()}
    fitness = simulation.task.fitness({key: jnp.asarray(x) for key, x in terms.items()}, scales)
    return {"": "no drive from the brain", "fitness": f"{float(fitness):.3f}", **_terms(terms)}


def evaluate(simulation: Simulation, genes: np.ndarray) -> dict[str, np.ndarray]:
    """Evaluate animals ``(genes, n)`` in each situation without noise.

    Returns:
        Terms of the task by name, shape ``(n, situations)``. They are NaN for diverged animals.
    """
    simulation = dataclasses.replace(simulation, noise=Noise())
    count = len(simulation.situations)
    numbers = np.tile(np.arange(count), genes.shape[1]) if count > 1 else None
    outcome = compile_trials(simulation, population_mesh())(genes, None, numbers, count)
    return {
        key: np.where(outcome.alive, x, np.nan).reshape(-1, count)
        for key, x in outcome.terms.items()
    }
