"""Depth of overlap between walkers' limbs: `python -m benchmarks.limbs RUN [RUN ...]`.

The champions have posture controllers (`evo-cpg train configs/fukui2003_model1.yaml`). Every
physics step of their whole trials is measured. The figures are in docs/models/contact.md.
"""

import argparse
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from rich.console import Console

from evo_cpg.api.runs import open_champion
from evo_cpg.control.postures import PostureController
from evo_cpg.physics.contact.pairs import separations
from evo_cpg.physics.step.step import first_warmstart, step
from evo_cpg.physics.tree.joint_torque import MotorCommand
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import resting_state
from evo_cpg.simulation.simulation import Simulation

HEADER = """\
| run | generation | displacement, m | limbs touch, % of steps | deepest overlap, mm |
|---|---|---|---|---|"""


class Limbs(NamedTuple):
    """Results of every physics step.

    Attributes:
        overlap: deepest overlap, m, 0 without any.
        touches: whether limbs pushed each other.
        displacement: final horizontal distance of the root from the world's origin, m.
    """

    overlap: Float[np.ndarray, " t"]
    touches: Bool[np.ndarray, " t"]
    displacement: float


def walk(simulation: Simulation, genes: Float[np.ndarray, " g"]) -> Limbs:
    """Simulate a walker's trial from its genes, without noise.

    Raises:
        TypeError: its controller has no postures, or no parts of it can touch each other.
    """
    controller, world, h = simulation.controller, simulation.world, simulation.step_length
    pairs = world.pairs
    if not isinstance(controller, PostureController) or pairs is None:
        raise TypeError("the run needs a posture controller, and limbs that can touch each other")
    postures = controller.decode(jnp.asarray(genes, jnp.float32)[:, None])
    count = simulation.steps * simulation.substeps
    numbers = [int(controller.posture(jnp.int32(i // simulation.substeps))) for i in range(count)]
    place = simulation.situations[0].start_position
    start = resting_state(world.tree, (1,), jnp.float32, position=place)
    none = jnp.zeros_like(start.qd)

    def advance(carry: tuple, number: jax.Array) -> tuple[tuple, tuple]:
        state, warmstart = carry
        state, effort = step(world, state, MotorCommand(none, postures[number]), h, warmstart)
        assert effort.pair_force is not None
        gap = separations(pairs, kinematics(world.tree, state)).gap.min()
        return (state, effort.warmstart), (gap, (effort.pair_force > 0).any())

    begin = start, first_warmstart(world, (1,), start.q.dtype)
    run = jax.jit(lambda begin: jax.lax.scan(advance, begin, jnp.asarray(numbers)))
    (end, _), (gap, touches) = run(begin)
    displacement = float(np.hypot(*np.asarray(end.position)[:2, 0]))
    return Limbs(np.maximum(-np.asarray(gap), 0.0), np.asarray(touches), displacement)


def main() -> None:
    """Simulate the champions of the runs, and print the table of their limbs' overlaps."""
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n", 1)[0])
    parser.add_argument("runs", nargs="+", metavar="RUN", type=Path)
    console = Console()
    console.print(HEADER, soft_wrap=True)
    for run in parser.parse_args().runs:
        opened = open_champion(run)
        experiment, champion = opened.experiment, opened.champion
        found = walk(experiment.simulation, champion.genes)
        cells = (
            experiment.name,
            f"{champion.generation}",
            f"{found.displacement:.2f}",
            f"{100 * found.touches.mean():.0f}",
            f"{1e3 * found.overlap.max():.1f}",
        )
        console.print("| " + " | ".join(cells) + " |", soft_wrap=True)


if __name__ == "__main__":
    main()
