"""Record of one trial in named columns."""

import csv
import io
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.axis_kinds import kind_named
from evo_cpg.files import write_text, write_whole
from evo_cpg.simulation.recording import NERVE, SENSE, Recording
from evo_cpg.simulation.simulation import Simulation

_AXES = ("x", "y", "z")


class Record(Mapping[str, Float[np.ndarray, " t"]]):
    """Mapping from column names to arrays, with a row for every control step.

    Attributes:
        units: unit of every column, by name.
        recording: the motion as arrays by body, for films.
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
        # A swimmer has hundreds of columns.
        names = list(self)
        shown = names if len(names) <= 8 else [*names[:6], "...", names[-1]]
        return f"Record({len(self['time'])} steps, {len(names)} columns: {', '.join(shown)})"

    def to_csv(self, path: Path | str) -> None:
        """Write the record as a CSV table. Headers are names with units: ``time [s]``.

        Raises:
            OutputError: the file cannot be written.
        """
        table = io.StringIO()
        writer = csv.writer(table, lineterminator="\n")
        writer.writerow(f"{name} [{self.units[name]}]" for name in self)
        writer.writerows(zip(*(x.tolist() for x in self.values()), strict=True))
        write_text(Path(path), table.getvalue())

    def to_npz(self, path: Path | str) -> None:
        """Write the record as arrays by column name, for `numpy.load`.

        Two arrays of text are added: ``columns`` with the names and ``units`` with the units.

        Raises:
            OutputError: the file cannot be written.
        """
        names = np.array([list(self), [self.units[name] for name in self]])
        arrays = {"columns": names[0], "units": names[1], **self}
        write_whole(Path(path), lambda file: np.savez(file, **arrays))


def as_record(simulation: Simulation, frames: Mapping[str, Array], recording: Recording) -> Record:
    """Name the columns of a recorded trial.

    Args:
        simulation: simulation of the trial.
        frames: ``full`` frames of one individual (`evo_cpg.simulation.recording.Recorder`).
        recording: recording of the trial, in the order of the creature.
    """
    columns: dict[str, np.ndarray] = {"time": recording.time}
    units = {"time": "s"}

    def add(name: str, unit: str, values: np.ndarray) -> None:
        columns[name], units[name] = np.asarray(values), unit

    tree, contact_model = simulation.world.tree, simulation.world.contact_model
    owners = np.array(() if contact_model is None else contact_model.bodies, int)
    arrays = {name: np.asarray(values)[..., 0] for name, values in frames.items()}
    force, position, rotation = (arrays[n] for n in ("contact_force", "position", "rotation"))
    for i, body in enumerate(tree.names):
        for k, axis in enumerate(_AXES):
            add(f"{body}.{axis}", "m", position[:, k, i])
        for row, first in enumerate(_AXES):
            for column, second in enumerate(_AXES):
                add(f"{body}.rotation_{first}{second}", "1", rotation[:, row, column, i])
        for k, axis in enumerate(_AXES):
            add(f"{body}.velocity_{axis}", "m/s", arrays["velocity"][:, k, i])
        for k, axis in enumerate(_AXES):
            add(f"{body}.angular_velocity_{axis}", "rad/s", arrays["angular_velocity"][:, k, i])
        for k, axis in enumerate(_AXES if contact_model is not None else ()):
            add(f"{body}.contact_force_{axis}", "N", force[:, k, owners == i].sum(1))
    pairs = simulation.world.pairs
    if pairs is not None:
        pushes, points = arrays["pair_force"], np.array(pairs.owners)
        for first, second in zip(pairs.first, pairs.second, strict=True):
            own = (points[0] == first) & (points[1] == second)
            add(f"{tree.names[first]}-{tree.names[second]}.push", "N", pushes[:, own].sum(1))
    for j, dof in enumerate(recording.dof_names):
        unit, torque = kind_named(dof).unit, kind_named(dof).force_unit
        add(f"{dof}.angle", unit, recording.joint_angle[:, j])
        add(f"{dof}.rate", f"{unit}/s", arrays["joint_rate"][:, j])
        add(f"{dof}.target_rate", f"{unit}/s", recording.target_rate[:, j])
        add(f"{dof}.torque", torque, recording.torque[:, j])
        add(f"{dof}.signal", "1", recording.cpg_output[:, j])
    for name, values in arrays.items():
        if name.startswith((SENSE, NERVE)):
            rows = values.reshape(len(values), -1)
            for k in range(rows.shape[1]):
                add(f"{name}.{k}", "1", rows[:, k])
    add("energy", "J", arrays["energy"])
    for name in ("solved_residual", "coulomb_residual"):
        if name in arrays:
            add(name, "1", arrays[name])
    return Record(columns, units, recording)
