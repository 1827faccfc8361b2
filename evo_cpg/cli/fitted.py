"""Estimation of parameters from a recorded motion, for the command `fit`."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from evo_cpg.analysis.fit import Fit, fit, fit_warnings
from evo_cpg.api.display import Work, working
from evo_cpg.cli.champions import open_champion
from evo_cpg.cli.errors import UsageError, warn
from evo_cpg.cli.measured_motion import (
    TARGET,
    MeasuredMotion,
    commands,
    late_commands,
    read_motion,
)
from evo_cpg.cli.tables import show_table
from evo_cpg.files import write_text
from evo_cpg.io.errors import ConfigError, nearest
from evo_cpg.io.load import dump_config, load_config
from evo_cpg.io.numbers import number_at, with_numbers
from evo_cpg.io.parameters import Parameters, parametrise
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.simulation.track import ATTITUDE, POSITION, beginning_names, column_names, track
from evo_cpg.view.figure import save_figure
from evo_cpg.view.plots import fit_figure

INITIAL = "initial."
UNITS = {"position": "m", "attitude": "rad", "angle": "rad"}

# Measured numbers that each kind of column needs beyond the number of parameters, if the noise of
# several kinds is estimated. The intervals then contain the true value in at least 92 % of cases.
# With one number less than parameters, they contain it in 78 % (docs/models/gradients.md).
_OF_A_KIND = 5

# The search restarts from its result until the result changes by less than this fraction of its
# standard error.
_STILL, _MOST_SEARCHES = 0.05, 6


class Problem(NamedTuple):
    """Estimation problem.

    Attributes:
        recording: recorded motion.
        parameters: simulation as a function of the numbers of its configuration.
        names: names of all parameters: numbers of the configuration, then initial values.
        start: value of each parameter at the start of the search.
        positive: whether each parameter is positive and must stay positive.
        initial: initial values that are set, by name.
        genes: genes of the champion that moves the joints, or None for the recorded commands.
        noise: standard deviation by kind of column, m or rad, or empty to estimate it.
    """

    recording: MeasuredMotion
    parameters: Parameters
    names: tuple[str, ...]
    start: np.ndarray
    positive: np.ndarray
    initial: dict[str, float]
    genes: np.ndarray | None
    noise: dict[str, float]

    @property
    def kinds(self) -> list[str]:
        """Kind of each column of the recording."""
        return [_kind(name) for name in self.recording.columns]

    @property
    def present(self) -> list[str]:
        """Kinds that occur among the columns."""
        return [kind for kind in UNITS if kind in self.kinds]


def fit_motion(
    config: Path,
    data: Path,
    keys: Sequence[str],
    settings: Sequence[str],
    run: Path | None,
    noise: Sequence[str],
    out: Path | None,
    plot: Path | None,
) -> None:
    """Estimate parameters, print them, and write the requested files.

    Args:
        config: path of the configuration.
        data: path of the table with the recorded motion.
        keys: keys of the parameters, each optionally with ``=START``.
        settings: other values, ``key=value``.
        run: run folder of the champion that moves the joints, or None for the recorded commands.
        noise: standard deviations by kind of column, ``kind=value``.
        out: file for the fitted configuration, if any.
        plot: file for a picture of data and fit, if any.

    Raises:
        UsageError: an argument is wrong, or there is no estimate.
    """
    recording = read_motion(data)
    set_here = {text.partition("=")[0]: text for text in settings}
    whole = load_config(
        config, [text for name, text in set_here.items() if not name.startswith(INITIAL)]
    )
    initial = {n: _number_in(text) for n, text in set_here.items() if n.startswith(INITIAL)}
    given = [key.partition("=")[0] for key in keys]
    start = {key.partition("=")[0]: _number_in(key) for key in keys if "=" in key}
    inner = tuple(name for name in given if not name.startswith(INITIAL))
    outer = tuple(name for name in given if name.startswith(INITIAL))
    for name in inner:
        number_at(whole, name, config)
    _check_keys(given, set_here, run)
    genes = None
    if run is not None:
        if recording.targets:
            raise UsageError("--run: the champion moves the joints. Leave out the target columns")
        # Opening the run sets the number of cores, which must precede the start of JAX.
        genes = np.asarray(open_champion(run).champion.genes, float)
    begins = with_numbers(whole, {k: v for k, v in start.items() if k in inner}, config)
    parameters = parametrise(_trial_of(recording, begins), config, inner)
    simulation = parameters.experiment.simulation
    _check_names(recording, simulation, [*initial, *outer], data)
    if genes is not None and (wrong := simulation.genome.misfit(genes)):
        raise UsageError(f"--run: the champion of {run} does not fit {config}: {wrong}")
    values = [number_at(begins, name) for name in inner]
    values += [start.get(name, 0.0) for name in outer]
    names = (*inner, *outer)
    problem = Problem(
        recording,
        parameters,
        names,
        np.array(values),
        np.array([_is_positive(parameters, name) for name in names]),
        initial,
        genes,
        {text.partition("=")[0]: _number_in(text) for text in noise},
    )
    _require_numbers(problem, data)
    late = late_commands(recording, simulation)
    if late:
        warn(
            f"{data}: {late} commands lie between two control steps "
            f"({simulation.control_rate:g} steps per second) and take effect at the next one"
        )
    with working("compiling the search") as work:
        result, shown = search(problem, work)
    _report(problem, result)
    if out is not None:
        found = dict(zip(inner, map(float, result.values), strict=False))
        write_text(out, dump_config(with_numbers(whole, found, config)))
        print(out)
    if plot is not None:
        figure = fit_figure(recording.time, recording.columns, recording.data, shown)
        print(save_figure(figure, plot))


def _number_in(text: str) -> float:
    """Return the number in ``KEY=VALUE``.

    Raises:
        UsageError: the value is not a finite number.
    """
    key, _, value = text.partition("=")
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise UsageError(f"{key}: {value!r} is not a number")
    return number


def _check_keys(names: Sequence[str], set_here: dict[str, str], run: Path | None) -> None:
    for i, name in enumerate(names):
        if name in set_here:
            raise UsageError(
                f"{name}: is both estimated and set. Leave out --set, and give its start as "
                f"{name}=VALUE"
            )
        if name in names[:i]:
            raise UsageError(f"{name}: is given twice. Give it once")
        if run is None and name.startswith("controller."):
            raise UsageError(
                f"{name}: the recorded commands move the joints, not the controller. "
                "Add --run RUN to let the controller of a champion move them"
            )


def _trial_of(recording: MeasuredMotion, config: ExperimentConfig) -> ExperimentConfig:
    """Return the configuration with a single trial, as long as the recording."""
    rate = config.simulation.control_rate_hz
    steps = max(1, math.ceil(float(recording.time.max()) * rate - 1e-9))
    trial = config.simulation.model_copy(update={"seconds": steps / rate, "trials": 1})
    return config.model_copy(update={"simulation": trial})


def _check_names(
    recording: MeasuredMotion, simulation: Simulation, beginnings: Sequence[str], path: Path
) -> None:
    """Check the names of columns and of initial values against the creature.

    Raises:
        UsageError: a name does not exist.
    """
    dofs = simulation.world.tree.dof_names
    for valid, given, prefix in (
        (column_names(simulation), recording.columns, ""),
        (dofs, recording.targets, TARGET),
    ):
        for name in given:
            if name not in valid:
                hint = nearest(name, valid) if valid else "the creature has no joints"
                raise UsageError(f"{path}: unknown column {prefix}{name}: {hint}")
    for name in beginnings:
        short, valid = name.removeprefix(INITIAL), beginning_names(simulation)
        if short not in valid:
            raise UsageError(f"{name}: does not exist: {nearest(short, valid)}")


def _is_positive(parameters: Parameters, name: str) -> bool:
    """Return whether a number of the configuration is positive and must stay positive."""
    if name not in parameters.keys:
        return False
    value = number_at(parameters.config, name)
    try:
        with_numbers(parameters.config, {name: -abs(value)}, parameters.source)
    except ConfigError:
        return value > 0
    return False


def _require_numbers(problem: Problem, path: Path) -> None:
    """Check that there are enough numbers in all, and enough of each kind to estimate its noise."""
    present, parameters = problem.present, len(problem.names)
    counts = dict.fromkeys(present, 0)
    measured = np.isfinite(problem.recording.data).sum(0)
    for kind, count in zip(problem.kinds, measured, strict=True):
        counts[kind] += int(count)
    total = sum(counts.values())
    if total <= parameters:
        raise UsageError(f"{path}: {total} numbers cannot determine {parameters} parameters")
    least = parameters + _OF_A_KIND
    for kind, count in counts.items():
        if len(present) > 1 and count < least and not problem.noise:
            raise UsageError(
                f"{path}: {count} number(s) of kind {kind} are too few to estimate their noise. "
                f"With {parameters} parameter(s), at least {least} are needed. Give "
                f"{' '.join(f'--noise {each}=..' for each in present)}, or leave them out"
            )


def _noise(problem: Problem) -> np.ndarray | None:
    known, present = problem.noise, problem.present
    if not known:
        return None
    for kind, size in known.items():
        if kind not in UNITS or not size > 0:
            raise UsageError(
                f"--noise: {kind}={size:g} is wrong. Allowed: {'=.., '.join(UNITS)}=.. above 0"
            )
    missing = [kind for kind in present if kind not in known]
    if missing:
        raise UsageError(f"--noise: is missing for {', '.join(missing)}. Give it, or none at all")
    return np.array([known[kind] for kind in present])


def search(problem: Problem, work: Work) -> tuple[Fit, np.ndarray]:
    """Return the estimate, and the motion simulated with the estimate.

    Raises:
        UsageError: there is no estimate, or the configuration does not allow it.
    """
    recording, parameters, names = problem.recording, problem.parameters, problem.names
    positive, values, inner = problem.positive, problem.start, len(problem.parameters.keys)
    kind_numbers = np.array([problem.present.index(kind) for kind in problem.kinds])
    wrapped = np.array([name in ATTITUDE for name in recording.columns])
    noise = _noise(problem)

    def observe(theta: Any) -> Any:
        simulation = parameters.simulation(theta[:inner])
        if problem.genes is None:
            driver = commands(recording, parameters.experiment.simulation)
            driver = eqx.tree_at(lambda d: d.tree, driver, simulation.world.tree)
            simulation = eqx.tree_at(lambda s: s.controller, simulation, driver)
        found = dict(zip(names[inner:], theta[inner:], strict=True))
        begin = {
            name.removeprefix(INITIAL): jnp.asarray(value, theta.dtype)
            for name, value in (problem.initial | found).items()
        }
        genes = problem.genes
        if genes is None:
            genes = np.zeros(simulation.genome.count)
        own = jnp.asarray(genes, theta.dtype)
        return track(simulation, own, recording.time, recording.columns, begin)

    def fit_to(start: Any, data: Any) -> Any:
        return fit(observe, data, start, positive, kind_numbers, wrapped, noise)

    with jax.enable_x64(True):
        program = jax.jit(fit_to)
        for number in range(1, _MOST_SEARCHES + 1):
            if number > 1:
                work.doing(f"searching again from the result: {number} of up to {_MOST_SEARCHES}")
            result = jax.device_get(program(jnp.asarray(values), jnp.asarray(recording.data)))
            unfelt = [n for n, felt in zip(names, result.felt, strict=True) if not felt]
            if unfelt:
                raise UsageError(
                    f"{unfelt[0]}: does not influence any measured quantity at these values. Leave "
                    "it out, or start elsewhere, KEY=VALUE"
                )
            if not np.isfinite(result.values).all():
                raise UsageError("the simulation diverges near these values. Try others, KEY=VALUE")
            size = np.where(positive, np.abs(result.values), 1.0) * result.errors
            still = np.abs(result.values - values) <= _STILL * size
            values = np.asarray(result.values)
            try:
                parameters.require(values[:inner])
            except ConfigError as error:
                raise UsageError(_forbidden(names, values, size, error)) from None
            if still.all():
                break
        work.doing("simulating the motion with the estimates")
        shown = jax.device_get(jax.jit(observe)(jnp.asarray(values)))
    return result, shown


def _forbidden(
    names: Sequence[str], values: np.ndarray, sizes: np.ndarray, error: ConfigError
) -> str:
    found = ", ".join(
        f"{name}={value:.4g} (standard error {size:.2g})"
        for name, value, size in zip(names, values, sizes, strict=True)
    )
    return (
        f"the best fit is {found}, which is not allowed ({error}). Leave out the parameter at "
        "its bound, or start elsewhere, KEY=VALUE"
    )


def _kind(name: str) -> str:
    return "position" if name in POSITION else "attitude" if name in ATTITUDE else "angle"


def _report(problem: Problem, result: Fit) -> None:
    """Print the estimates with their intervals, the noise and the warnings."""
    columns = problem.names, problem.start, result.values, result.lower, result.upper
    rows = [
        (name, f"{first:.4g}", f"{value:.5g}", f"{low:.5g} to {high:.5g}")
        for name, first, value, low, high in zip(*columns, strict=True)
    ]
    show_table(("parameter", "start", "estimate", "95 % interval"), rows)
    sizes = zip(problem.present, result.noise, strict=True)
    noise = ", ".join(f"{kind} {size:.3g} {UNITS[kind]}" for kind, size in sizes)
    print(f"noise: {noise} ({int(result.freedom)} degrees of freedom)")
    for words in fit_warnings(problem.names, problem.positive, result):
        print(f"warning: {words}")
