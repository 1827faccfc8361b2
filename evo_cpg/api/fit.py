"""Estimate numbers of a configuration from a recorded motion."""

import contextlib
import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from evo_cpg.analysis.fit import Fit
from evo_cpg.analysis.fit import fit as fit_model
from evo_cpg.api.progress import working
from evo_cpg.control.commanded import Commanded
from evo_cpg.errors import UserError, nearest
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.load import load_config
from evo_cpg.io.numbers import number_at, with_numbers
from evo_cpg.io.parameters import Parameters, parametrise
from evo_cpg.io.run import open_run
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.io.shipped import find_config
from evo_cpg.io.trust import trusting
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.simulation.track import ATTITUDE, beginning_names, column_names, track
from evo_cpg.training.devices import use_cores

INITIAL = "initial."

# A command belongs to a control step if its time stamp is late by less than this fraction of a
# step. Time stamps are rounded to milliseconds or microseconds.
_ON_TIME = 0.05

# Ends of column names in the table that `evo-cpg export` writes.
_ANGLE, _COMMAND, _ROTATION = ".angle", ".target_rate", ".rotation_xx"
# Units of a table of measurements that would pass for s, m and rad.
_FOREIGN = frozenset(("ms", "min", "mm", "cm", "km", "in", "ft", "deg", "deg/s", "rpm", "°", "°/s"))


class MeasuredMotion(NamedTuple):
    """Measured motion.

    Attributes:
        time: time of each row, s.
        columns: names of the measured quantities, as in `evo_cpg.simulation.track`.
        data: value in each row and column, NaN if nothing was measured.
        commands: commanded rates of degrees of freedom by name, rad/s or m/s.
    """

    time: np.ndarray
    columns: tuple[str, ...]
    data: np.ndarray
    commands: dict[str, np.ndarray]


class FittedMotion(NamedTuple):
    """Estimates from a recorded motion.

    Attributes:
        names: names of the parameters.
        start: value of each parameter at the start of the search.
        fit: estimates, intervals, noise, and the simulated motion.
        recording: the recorded motion.
        config: configuration with the estimates.
        warnings: parameters that the data do not determine, and commands between control steps.
    """

    names: tuple[str, ...]
    start: np.ndarray
    fit: Fit
    recording: MeasuredMotion
    config: ExperimentConfig
    warnings: tuple[str, ...]


def read_motion(path: Path) -> MeasuredMotion:
    """Read a recorded motion from a CSV file with the columns of `evo-cpg export`.

    Instead of a rotation matrix, ``roll``, ``pitch`` and ``yaw`` may give the attitude.

    Raises:
        UserError: the file cannot be read, or is not a recorded motion.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            heads, *lines = [row for row in csv.reader(file) if any(map(str.strip, row))]
        cells = [[float(cell) if cell.strip() else math.nan for cell in line] for line in lines]
        table = np.array(cells, float).reshape(len(cells), len(heads))
    except (OSError, ValueError, csv.Error) as error:
        raise UserError(f"{path}: cannot be read as a table of numbers ({error})") from None
    # A unit may follow a name: `time [s]`.
    names = [head.partition("[")[0].strip() for head in heads]
    for head in heads:
        if head.partition("[")[2].rstrip("] ") in _FOREIGN:
            raise UserError(f"{path}: {head.strip()!r}: columns must be in SI units: s, m and rad")
    if len(set(names)) < len(names) or "time" not in names or not len(table):
        raise UserError(f"{path}: needs rows of numbers, and different columns, one of them time")
    given = dict(zip(names, table.T, strict=True))
    time = given.pop("time")
    if not np.isfinite(time).all() or time.min() < 0 or (np.diff(time) <= 0).any():
        raise UserError(f"{path}: time must begin at 0 or later and increase from row to row")
    root = next((name.removesuffix(_ROTATION) for name in names if name.endswith(_ROTATION)), None)
    seen: dict[str, np.ndarray] = {}
    if root is not None:
        try:
            seen |= {axis: given[f"{root}.{axis}"] for axis in "xyz"}
            turns = ("xx", "yx", "zx", "zy", "zz")
            xx, yx, zx, zy, zz = (given[f"{root}.rotation_{axes}"] for axes in turns)
        except KeyError as error:
            raise UserError(f"{path}: an exported motion must have the column {error}") from None
        seen["roll"], seen["pitch"] = np.arctan2(zy, zz), -np.arcsin(np.clip(zx, -1.0, 1.0))
        seen["yaw"] = np.arctan2(yx, xx)
    # An export has more columns than a fit can use.
    seen |= {
        name.removesuffix(_ANGLE): column
        for name, column in given.items()
        if root is None or name.endswith(_ANGLE)
    }
    data = {name: column for name, column in seen.items() if not name.endswith(_COMMAND)}
    commands = {n.removesuffix(_COMMAND): c for n, c in given.items() if n.endswith(_COMMAND)}
    if not data or not all(np.isfinite(column).all() for column in commands.values()):
        raise UserError(
            f"{path}: needs a measured column, and a number in every row of {_COMMAND} columns"
        )
    if np.isinf(list(data.values())).any():
        raise UserError(f"{path}: measured numbers must be finite. Leave missing ones empty")
    return MeasuredMotion(time, tuple(data), np.stack(list(data.values()), 1), commands)


def commanded(recording: MeasuredMotion, simulation: Simulation) -> tuple[Commanded, int]:
    """Return a controller that holds each recorded command from its row to the next.

    Returns:
        The controller, and the number of commands that change between two control steps.
    """
    tree, rate = simulation.world.tree, float(simulation.control_rate)
    table = np.zeros((len(recording.time), tree.dof_count))
    for name, column in recording.commands.items():
        table[:, tree.dof_names.index(name)] = column
    step = (np.arange(simulation.steps) + _ON_TIME) / rate
    row = np.searchsorted(recording.time, step, side="right") - 1
    rates = np.where(row[:, None] >= 0, table[np.maximum(row, 0)], 0.0)
    steps = recording.time * rate
    new = (np.diff(table, axis=0, prepend=0.0) != 0).any(1)
    late = int((new & (np.abs(steps - np.round(steps)) > _ON_TIME)).sum())
    return Commanded(tree=tree, rates=rates), late


def fit(
    config: Path | str,
    data: Path | str,
    keys: Sequence[str],
    settings: Sequence[str] = (),
    *,
    run: Path | str | None = None,
    trust: bool = False,
) -> FittedMotion:
    """Estimate numbers of a configuration from a recorded motion.

    Args:
        config: YAML file, or name of a shipped configuration.
        data: CSV table with the recorded motion (docs/cli.md).
        keys: keys of the parameters, ``KEY`` or ``KEY=START``, such as ``world.water.form_drag`` or
            ``initial.velocity.x``.
        settings: other values, ``KEY=VALUE``.
        run: run folder of the champion that moves the joints, or None for the recorded commands.
        trust: whether you trust the configuration, see `evo_cpg.load`.

    Raises:
        UserError: an argument is wrong, or there is no estimate.
    """
    source, path = find_config(config), Path(data)
    recording = read_motion(path)
    with trusting(trust):
        use_cores()
        names, begin, fixed, whole = _values(source, keys, settings)
        inner = tuple(name for name in names if not name.startswith(INITIAL))
        genes = (
            None if run is None else np.asarray(open_run(run).with_champion().own.champion.genes)
        )
        if run is None and any(name.startswith("controller.") for name in inner):
            raise UserError(f"the recorded commands move the joints of {path}. Add --run RUN")
        if run is not None and recording.commands:
            raise UserError(
                f"--run: the champion moves the joints. Leave out the {_COMMAND} columns"
            )
        found = dict(zip(names, begin, strict=True))
        start = with_numbers(whole, {name: found[name] for name in inner}, source)
        rate = whole.simulation.control_rate_hz
        seconds = max(1, math.ceil(float(recording.time.max()) * rate - 1e-9)) / rate
        trial = start.simulation.model_copy(update={"seconds": seconds, "trials": 1})
        parameters = parametrise(start.model_copy(update={"simulation": trial}), source, inner)
        simulation = parameters.experiment.simulation
        given = [n[len(INITIAL) :] for n in (*names, *fixed) if n.startswith(INITIAL)]
        for what, valid, own in (
            (f"{path}: unknown column", column_names(simulation), recording.columns),
            (f"{path}: unknown command", simulation.world.tree.dof_names, recording.commands),
            ("unknown initial value", beginning_names(simulation), given),
        ):
            for name in own:
                if name not in valid:
                    hint = nearest(name, valid) if valid else "the creature has no joints"
                    raise UserError(f"{what} {name}: {hint}")
        wrong = None if genes is None else simulation.genome.misfit(genes)
        if wrong:
            raise UserError(f"--run: the champion of {run} does not fit {source}: {wrong}")
        if np.isfinite(recording.data).sum() <= len(names):
            raise UserError(f"{path}: too few numbers for {len(names)} parameters")
        positive = np.array([name in inner and number_at(start, name) > 0 for name in names])
        for i in np.flatnonzero(positive):
            # A positive number stays positive if its negative is not allowed.
            opposite = {names[i]: -number_at(start, names[i])}
            with contextlib.suppress(ConfigError):
                with_numbers(parameters.config, opposite, source)
                positive[i] = False
        with working("fitting"):
            result, late = _search(recording, parameters, names, begin, positive, fixed, genes)
    values = dict(zip(names, map(float, result.values), strict=True))
    try:
        parameters.require(result.values[: len(inner)])
        fitted = with_numbers(whole, {name: values[name] for name in inner}, source)
    except ConfigError as error:
        best = ", ".join(f"{name}={value:.4g}" for name, value in values.items())
        raise UserError(
            f"the best fit is {best}, which is not allowed ({error}). Leave out the parameter at "
            "its bound, or start elsewhere, KEY=VALUE"
        ) from None
    warnings = result.warnings(names, positive)
    if late:
        warnings.append(f"{late} commands lie between two control steps and wait for the next one")
    return FittedMotion(names, begin, result, recording, fitted, tuple(warnings))


def _values(
    source: Path, keys: Sequence[str], settings: Sequence[str]
) -> tuple[tuple[str, ...], np.ndarray, dict[str, float], ExperimentConfig]:
    """Return names and starts of the parameters, fixed initial values, and the configuration."""

    def number_in(text: str) -> float:
        name, _, value = text.partition("=")
        try:
            return float(value)
        except ValueError:
            raise UserError(f"{name}: {value!r} is not a number") from None

    own = [text for text in settings if not text.startswith(INITIAL)]
    fixed = {text.partition("=")[0]: number_in(text) for text in settings if text not in own}
    # A parameter of the controller or the world begins at its value in the configuration.
    whole = load_config(source, own)
    start: dict[str, float] = {}
    for text in keys:
        name = text.partition("=")[0]
        if name in start or name in {setting.partition("=")[0] for setting in settings}:
            raise UserError(f"{name}: is given twice. Give it once, and its start as {name}=VALUE")
        known = 0.0 if name.startswith(INITIAL) else number_at(whole, name, source)
        start[name] = number_in(text) if "=" in text else known
    names = tuple(sorted(start, key=lambda name: name.startswith(INITIAL)))
    return names, np.array([start[name] for name in names]), fixed, whole


def _search(
    recording: MeasuredMotion,
    parameters: Parameters,
    names: tuple[str, ...],
    start: np.ndarray,
    positive: np.ndarray,
    fixed: dict[str, float],
    genes: np.ndarray | None,
) -> tuple[Fit, int]:
    """Return the fit, and the number of commands that change between two control steps."""
    inner = len(parameters.keys)
    driver, late = commanded(recording, parameters.experiment.simulation)

    def observe(theta: jax.Array) -> jax.Array:
        simulation, own = parameters.simulation(theta[:inner]), genes
        if own is None:
            moved = eqx.tree_at(lambda d: d.tree, driver, simulation.world.tree)
            simulation = eqx.tree_at(lambda s: s.controller, simulation, moved)
            own = np.zeros(simulation.genome.count)
        begin = fixed | dict(zip(names[inner:], theta[inner:], strict=True))
        initial = {n.removeprefix(INITIAL): jnp.asarray(v, theta.dtype) for n, v in begin.items()}
        own = jnp.asarray(own, theta.dtype)
        return track(simulation, own, recording.time, recording.columns, initial)

    def evaluate(theta: jax.Array) -> tuple[jax.Array, jax.Array]:
        # Forward derivatives, and values without a second simulation.
        along = jnp.eye(len(names), dtype=theta.dtype)
        derivative = jax.vmap(
            lambda direction: jax.jvp(observe, (theta,), (direction,)), out_axes=(None, -1)
        )
        return derivative(along)

    wrapped = np.array([name in ATTITUDE for name in recording.columns])
    with jax.enable_x64(True):
        program = jax.jit(evaluate)
        _, derivatives = program(jnp.asarray(start))
        felt = (np.asarray(derivatives) != 0).any((0, 1))
        if not felt.all():
            raise UserError(
                f"{names[int(np.argmin(felt))]}: does not influence any measured quantity at these "
                "values. Leave it out, or start elsewhere, KEY=VALUE"
            )
        try:
            result = fit_model(
                lambda x: program(jnp.asarray(x)), recording.data, start, positive, wrapped
            )
        except FloatingPointError:
            raise UserError(
                "the simulation diverges near these values. Try others, KEY=VALUE"
            ) from None
    return result, late
