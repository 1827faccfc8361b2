"""Tables of champions that came to a light, beside random search and an animal that is still."""

import dataclasses
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np

from evo_cpg.control.brain_cpg import silent_genes
from evo_cpg.simulation.noise import Noise
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.studies.study import Table, beside, middle, percent
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.experiment import compile_trials

if TYPE_CHECKING:
    from evo_cpg.studies.workshop import Workshop

# "Near the light": this share of the distance at the start is left.
NEAR = 0.1


HEAD = ["", "seed", "fitness", "distance left", "light seen", "energy (J)",
        "under 10 % after generation"]  # fmt: skip


def light_table(workshop: "Workshop", evolved: str, random: str | None = None) -> Table:
    """A line for every champion, then medians.

    Args:
        workshop: where the runs are.
        evolved: name of the runs.
        random: name of those of random search.
    """
    rows, fitness = [], {}
    for title, name in (("evolved", evolved), ("random search", random)):
        if name is None:
            continue
        found, near = workshop.champions(name), workshop.column(name, "best_distance") < NEAR
        seed = workshop.experiment(name).seed
        for champion in found:
            under = near[:, champion.run]
            terms = champion.terms
            rows.append(
                [
                    title,
                    str(seed + champion.run),
                    f"{champion.worth:.3f}",
                    percent(terms["distance"]),
                    f"{terms['light']:.2f}",
                    f"{terms['energy']:.0f}",
                    str(int(under.argmax())) if under.any() else "never",
                ]
            )
            title = ""
        fitness[name] = [champion.worth for champion in found]
        left = [100 * champion.terms["distance"] for champion in found]
        cells = middle(fitness[name], 3), f"{middle(left, 1)} %", "", "", ""
        rows.append(["median (range)", "", *cells])
    if random is not None:
        words = beside(fitness, random)[evolved]
        rows.append(["evolution beats random search", "", words, "", "", "", ""])
    return Table("", HEAD, rows)


def still(workshop: "Workshop", name: str) -> list[str]:
    """The line of an animal whose brain gives its spinal cord no drive at all.

    Its fitness is by the yardsticks of the first run.
    """
    simulation = workshop.experiment(name).simulation
    silent = simulation.genome.with_controller(silent_genes(simulation.controller)[:, None])
    terms = {key: x.mean() for key, x in lived(simulation, silent).items()}
    scales = {key: jnp.asarray(x) for key, x in workshop.champions(name)[0].scales.items()}
    fitness = simulation.task.fitness({key: jnp.asarray(x) for key, x in terms.items()}, scales)
    shown = f"{float(fitness):.3f}", percent(terms["distance"]), f"{terms['light']:.2f}"
    return ["brain gives no drive", "", *shown, f"{terms['energy']:.0f}", ""]


def lived(simulation: Simulation, genes: np.ndarray) -> dict[str, np.ndarray]:
    """Terms of animals ``(genes, n)`` without noise, NaN of those that diverged.

    A row for each animal and a column for each situation.
    """
    simulation = dataclasses.replace(simulation, noise=Noise())
    count = len(simulation.situations)
    numbers = np.tile(np.arange(count), genes.shape[1]) if count > 1 else None
    outcome = compile_trials(simulation, population_mesh())(genes, None, numbers, count)
    return {
        key: np.where(outcome.alive, x, np.nan).reshape(-1, count)
        for key, x in outcome.terms.items()
    }
