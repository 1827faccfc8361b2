"""Measured motion: read it from a CSV file, and replay the commands that drove it."""

import csv
import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from evo_cpg.cli.errors import UsageError
from evo_cpg.control.commanded import Commanded
from evo_cpg.creature.axis_kinds import kind_named

if TYPE_CHECKING:
    from evo_cpg.simulation.simulation import Simulation

# Names of columns with commanded joint rates begin with this.
TARGET = "target."

# A command belongs to a control step if its time stamp is late by less than this fraction of a
# step. Time stamps are rounded to milliseconds or microseconds.
_ON_TIME = 0.05

_UNIT = re.compile(r"\s*\[([^]]*)\]$")
# Size of each unit, in SI units.
_TIMES = {"s": 1.0, "ms": 1e-3}
_LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_ANGLES = {"rad": 1.0, "deg": math.pi / 180, "mrad": 1e-3}
_RATES, _SPEEDS = (
    {f"{unit}/s": size for unit, size in units.items()} for units in (_ANGLES, _LENGTHS)
)
# A column with this suffix shows that `evo-cpg export` wrote the file. The first such column
# belongs to the root.
_EXPORTED = ".rotation_xx"
_ATTITUDE = ("xx", "yx", "zx", "zy", "zz")


class MeasuredMotion(NamedTuple):
    """Measured motion.

    Attributes:
        time: time of each row, s.
        columns: names of the measured quantities.
        data: value in each row and column, or NaN if nothing was measured.
        targets: commanded rates of joint axes by name, rad/s.
    """

    time: np.ndarray
    columns: tuple[str, ...]
    data: np.ndarray
    targets: dict[str, np.ndarray]


def read_motion(path: Path) -> MeasuredMotion:
    """Read a recorded motion from a CSV file.

    Raises:
        UsageError: the file cannot be read, or is not a recorded motion.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file)
            lines = [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UsageError(f"{path}: cannot be read ({error})") from None
    if len(lines) < 2:
        raise UsageError(f"{path}: has no numbers. Give a line of names, then lines of numbers")
    # A unit may follow a name: `time [s]`.
    heads = [name.strip() for name in lines[0][1]]
    names = [_UNIT.sub("", head) for head in heads]
    units = [match[1].strip() if (match := _UNIT.search(head)) else None for head in heads]
    twice = [name for i, name in enumerate(names) if name in names[:i]]
    if twice:
        raise UsageError(f"{path}: the column {twice[0]!r} occurs twice")
    if "time" not in names:
        raise UsageError(f"{path}: has no column time (s). It has {', '.join(names)}")
    table = np.full((len(lines) - 1, len(names)), np.nan)
    for i, (line, row) in enumerate(lines[1:]):
        if len(row) != len(names):
            raise UsageError(f"{path}: line {line} has {len(row)} cells, not {len(names)}")
        for j, cell in enumerate(row):
            table[i, j] = _measured(cell, f"{path}: line {line}, {names[j]}")
    root = next((name.removesuffix(_EXPORTED) for name in names if name.endswith(_EXPORTED)), "")
    table *= [_in_si(name, unit, root, path) for name, unit in zip(names, units, strict=True)]
    columns = dict(zip(names, table.T, strict=True))
    columns = _of_export(columns, root, path) if root else columns
    time = columns.pop("time")
    if not np.isfinite(time).all() or time.min() < 0 or (np.diff(time) <= 0).any():
        raise UsageError(f"{path}: time must begin at 0 or later and increase from row to row")
    targets = {name: columns.pop(name) for name in [*columns] if name.startswith(TARGET)}
    for name, column in targets.items():
        if not np.isfinite(column).all():
            raise UsageError(f"{path}: {name} must be a number in every row")
    if not columns:
        raise UsageError(f"{path}: has no measured column. Add at least one")
    targets = {name.removeprefix(TARGET): column for name, column in targets.items()}
    return MeasuredMotion(time, tuple(columns), np.stack(list(columns.values()), 1), targets)


def _in_si(name: str, unit: str | None, root: str, path: Path) -> float:
    """Return the size of a column's unit, in SI units, or 1 if the column has no unit or is unused.

    An exported motion has a root, and only some of its columns are used.

    Raises:
        UsageError: the unit does not fit the kind of the column.
    """
    from evo_cpg.simulation.track import POSITION

    body, _, what = name.rpartition(".")
    joint = body if what in ("angle", "target_rate") else name.removeprefix(TARGET)
    slides = kind_named(joint).unit == "m"
    if name == "time":
        allowed = _TIMES
    elif name.startswith(TARGET) or (root and what == "target_rate"):
        allowed = _SPEEDS if slides else _RATES
    elif body == root and what in POSITION:
        allowed = _LENGTHS
    else:
        angles = _LENGTHS if slides else _ANGLES
        allowed = angles if what == "angle" or not root else None
    if unit is None or allowed is None:
        return 1.0
    if unit not in allowed:
        raise UsageError(
            f"{path}: {name} cannot be in the unit [{unit}]. Allowed: {' or '.join(allowed)}"
        )
    return allowed[unit]


def _of_export(columns: dict[str, np.ndarray], root: str, path: Path) -> dict[str, np.ndarray]:
    """Convert an exported motion to the columns of a motion tracker.

    The attitude is yaw, then pitch, then roll about the axes of the root.
    """
    needed = [*(f"{root}.rotation_{axes}" for axes in _ATTITUDE), *(f"{root}.{x}" for x in "xyz")]
    lacking = [name for name in needed if name not in columns]
    if lacking:
        raise UsageError(f"{path}: an exported motion must have the column {lacking[0]}")
    xx, yx, zx, zy, zz = (columns[f"{root}.rotation_{axes}"] for axes in _ATTITUDE)
    seen = {"time": columns["time"], **{axis: columns[f"{root}.{axis}"] for axis in "xyz"}}
    seen |= {
        "roll": np.arctan2(zy, zz),
        "pitch": -np.arcsin(np.clip(zx, -1.0, 1.0)),
        "yaw": np.arctan2(yx, xx),
    }
    for name, values in columns.items():
        dof, _, what = name.rpartition(".")
        if what == "angle":
            seen[dof] = values
        elif what == "target_rate":
            seen[TARGET + dof] = values
    return seen


def commands(recording: MeasuredMotion, simulation: "Simulation") -> Commanded:
    """Return a controller that holds each recorded command from its row to the next."""
    tree, rate = simulation.world.tree, float(simulation.control_rate)
    step = (np.arange(simulation.steps) + _ON_TIME) / rate
    row = np.searchsorted(recording.time, step, side="right") - 1
    rates = np.zeros((simulation.steps, tree.dof_count))
    for name, column in recording.targets.items():
        rates[:, tree.dof_names.index(name)] = np.where(row >= 0, column[np.maximum(row, 0)], 0.0)
    return Commanded(tree=tree, rates=rates)


def late_commands(recording: MeasuredMotion, simulation: "Simulation") -> int:
    """Count the commands that change between two control steps."""
    if not recording.targets:
        return 0
    table = np.stack(list(recording.targets.values()), 1)
    new = np.append(table[:1] != 0, np.diff(table, axis=0) != 0, 0).any(1)
    steps = recording.time * float(simulation.control_rate)
    return int((new & (np.abs(steps - np.round(steps)) > _ON_TIME)).sum())


def _measured(cell: str, where: str) -> float:
    """Return the number in a cell, or NaN if the cell is empty.

    Raises:
        UsageError: the cell is not a number, or is infinite.
    """
    try:
        value = float(cell) if cell.strip() else math.nan
    except ValueError:
        value = math.inf
    if math.isinf(value):
        raise UsageError(f"{where}: {cell!r} is not a number")
    return value
