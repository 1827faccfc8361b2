"""The study of the starfish: `python benchmarks/starfish.py RUN...`.

How far behind the one before it each arm of a champion is, around the rings of its config: the mean
over the second half of the trial, and the same in each of `WINDOWS` parts of that half. The tables
are those of docs/models/controller.md.
"""

import sys
from pathlib import Path

import numpy as np

from evo_cpg.analysis.gait import ring_lags
from evo_cpg.cli.training import open_champion
from evo_cpg.control.brain_cpg import BrainCpg
from evo_cpg.control.couplings import ring_members
from evo_cpg.simulation.recording import Recording

WINDOWS = 3


def parts(recording: Recording) -> list[Recording]:
    """The second half of a recording, in equal parts."""
    edges = np.linspace(0.5, 1, WINDOWS + 1) * len(recording.time)
    found = []
    for start, stop in zip(edges[:-1].astype(int), edges[1:].astype(int), strict=True):
        found.append(
            recording._replace(
                time=recording.time[start:stop], joint_angle=recording.joint_angle[start:stop]
            )
        )
    return found


def main(run: Path) -> None:
    """Print a table for each ring."""
    experiment, champion, recording, _ = open_champion(run)
    controller = experiment.simulation.controller
    assert isinstance(controller, BrainCpg)
    tree = experiment.simulation.world.tree
    distance = recording.distance
    print(f"{run}: fitness {champion.fitness:.4f}, {distance[0]:.2f} to {distance[-1]:.2f} m")
    for i, ring in enumerate(controller.settings.cpg.rings):
        joints = [tree.dof_names[member] for member in ring_members(tree, ring, i)]
        whole = ring_lags(recording, joints)
        pieces = np.array([ring_lags(part, joints, last=1.0) for part in parts(recording)])
        print("| | " + " | ".join(joints) + " |")
        cells = [
            f"{lag:.1f} ({piece.min():.1f} to {piece.max():.1f})"
            for lag, piece in zip(whole, pieces.T, strict=True)
        ]
        print(f"| `{experiment.name}` | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    for argument in sys.argv[1:]:
        main(Path(argument))
