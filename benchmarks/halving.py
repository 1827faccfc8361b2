"""How far champions go at smaller steps: `python -m benchmarks.halving RUN [RUN ...]`.

The champions of all runs in a run folder, replayed at the step that they evolved at, at half and at
a quarter of it, and once more at their own with all joints turned by a hair (1e-6 rad) at first.
What a hair changes is the animal's own chaos; only what half a step changes beyond that is the
step's. The way is that of the root from start to end, over the ground or through the water.
"""

import argparse
import dataclasses
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float
from rich.console import Console

from evo_cpg.cli.training import champion_of, open_run
from evo_cpg.physics.state import State
from evo_cpg.simulation.rollout import motion
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.training.variations import finer

# How much each joint is turned, rad.
HAIR = 1e-6

HEADER = """\
| run | champions | go at their step, m | at half of it, m | at a quarter, m | \
kept at half, % | kept after a hair, % |
|---|---|---|---|---|---|---|"""


class Ways(NamedTuple):
    """How far each of some champions gets, m.

    Attributes:
        own: at the step that it evolved at.
        half: at half of it.
        quarter: at a quarter.
        hair: at its own, with joints turned by `HAIR` at the start.
    """

    own: Float[np.ndarray, " n"]
    half: Float[np.ndarray, " n"]
    quarter: Float[np.ndarray, " n"]
    hair: Float[np.ndarray, " n"]


def ways(simulation: Simulation, genes: Float[np.ndarray, "n g"]) -> Ways:
    """How far champions get, without noise, in the first of their situations."""

    def way(times: int, turned: float = 0.0) -> np.ndarray:

        def begin(state: State) -> State:
            return dataclasses.replace(state, q=state.q + turned)

        states = jax.jit(lambda genes: motion(finer(simulation, times), genes, begin))(genes.T)
        place = np.asarray(states.position)
        return np.linalg.norm(place[-1, :2] - place[0, :2], axis=0)

    return Ways(way(1), way(2), way(4), way(1, HAIR))


def kept(own: Float[np.ndarray, " n"], other: Float[np.ndarray, " n"]) -> float:
    """The median share of its way that a champion keeps, at most all of it."""
    return float(np.median(np.minimum(other / own, 1.0)))


def champions(run: Path) -> tuple[str, Simulation, Float[np.ndarray, "n g"]]:
    """Those of all runs in a folder, and the trial that they evolved in."""
    folder, _, experiment = open_run(run)
    genes = [champion_of(folder, number).genes for number in range(experiment.runs)]
    return experiment.name, experiment.simulation, np.stack(genes).astype(np.float32)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n", 1)[0])
    parser.add_argument("runs", nargs="+", metavar="RUN", type=Path)
    console = Console()
    console.print(HEADER, soft_wrap=True)
    for run in parser.parse_args().runs:
        name, simulation, genes = champions(run)
        found = ways(simulation, genes)
        cells = (
            name,
            f"{len(genes)}",
            *(
                f"{np.median(each):.2f} ({each.min():.2f} to {each.max():.2f})"
                for each in found[:3]
            ),
            f"{100 * kept(found.own, found.half):.0f}",
            f"{100 * kept(found.own, found.hair):.0f}",
        )
        console.print("| " + " | ".join(cells) + " |", soft_wrap=True)


if __name__ == "__main__":
    main()
