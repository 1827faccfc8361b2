"""One trial in named columns."""

import csv
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Array, Float

from evo_cpg.simulation.recording import Recording
from evo_cpg.simulation.simulation import Simulation

_AXES = ("x", "y", "z")


class Record(Mapping[str, Float[np.ndarray, " t"]]):
    """A row for every control step; a mapping from the names of columns to arrays.

    Attributes:
        units: of every column.
        recording: the same motion as arrays by body, as films need it.
    """

    def __init__(self, columns: dict[str, np.ndarray], units: dict[str, str], recording: Recording):
        self._columns, self.units, self.recording = columns, units, recording

    def __getitem__(self, name: str) -> Float[np.ndarray, " t"]:
        return self._columns[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)

    def __repr__(self) -> str:
        return f"Record({len(self['time'])} steps, {len(self)} columns: {', '.join(self)})"

    def to_csv(self, path: Path | str) -> None:
        """Write it as a table whose header is the names."""
        with Path(path).open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(self)
            writer.writerows(zip(*(x.tolist() for x in self.values()), strict=True))


def as_record(simulation: Simulation, frames: Mapping[str, Array], recording: Recording) -> Record:
    """Name the columns of a recorded trial.

    Args:
        simulation: the trial.
        frames: of one individual, see `evo_cpg.simulation.rollout.record`.
        recording: the same in the order of the creature.
    """
    columns: dict[str, np.ndarray] = {"time": recording.time}
    units = {"time": "s"}

    def add(name: str, unit: str, values: np.ndarray) -> None:
        columns[name], units[name] = np.asarray(values), unit

    tree, footing = simulation.world.tree, simulation.world.footing
    owners = np.array(() if footing is None else footing.bodies, int)
    force = np.asarray(frames["contact_force"])[..., 0]
    position, rotation = (np.asarray(frames[name])[..., 0] for name in ("position", "rotation"))
    for i, body in enumerate(tree.names):
        for k, axis in enumerate(_AXES):
            add(f"{body}.{axis}", "m", position[:, k, i])
        for row, first in enumerate(_AXES):
            for column, second in enumerate(_AXES):
                add(f"{body}.rotation_{first}{second}", "1", rotation[:, row, column, i])
        for k, axis in enumerate(_AXES if footing is not None else ()):
            add(f"{body}.contact_force_{axis}", "N", force[:, k, owners == i].sum(1))
    pairs = simulation.world.pairs
    if pairs is not None:
        pushes, points = np.asarray(frames["pair_force"])[..., 0], np.array(pairs.owners)
        for first, second in zip(pairs.first, pairs.second, strict=True):
            own = (points[0] == first) & (points[1] == second)
            add(f"{tree.names[first]}-{tree.names[second]}.push", "N", pushes[:, own].sum(1))
    for j, dof in enumerate(recording.dof_names):
        add(f"{dof}.angle", "rad", recording.joint_angle[:, j])
        add(f"{dof}.target_rate", "rad/s", recording.target_rate[:, j])
        add(f"{dof}.torque", "N m", recording.torque[:, j])
        add(f"{dof}.signal", "1", recording.cpg_output[:, j])
    add("energy", "J", np.asarray(frames["energy"])[:, 0])
    for name in ("solved_residual", "coulomb_residual"):
        if name in frames:
            add(name, "1", np.asarray(frames[name])[:, 0])
    return Record(columns, units, recording)
