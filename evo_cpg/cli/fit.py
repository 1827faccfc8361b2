"""The command that estimates parameters from a recorded motion: fit."""

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from evo_cpg.cli.champions import open_champion
from evo_cpg.cli.errors import UsageError, require_free
from evo_cpg.cli.measured_motion import (
    TARGET,
    MeasuredMotion,
    commands,
    late_commands,
    read_motion,
)
from evo_cpg.cli.progress import Work, working
from evo_cpg.config.errors import ConfigError, nearest
from evo_cpg.config.load import dump_config, load_config
from evo_cpg.config.numbers import number_at, with_numbers
from evo_cpg.config.parameters import Parameters, parametrise
from evo_cpg.config.schema.experiment import ExperimentConfig
from evo_cpg.files import write_text
from evo_cpg.view.output import PLOT_SUFFIXES, output_path

if TYPE_CHECKING:
    from evo_cpg.analysis.fit import Fit
    from evo_cpg.simulation.simulation import Simulation

_INITIAL = "initial."
KINDS = ("position", "attitude", "angle")

# Where columns of several kinds are told apart by their noise, a kind needs so many numbers more
# than there are parameters. With that intervals hold the truth in 92 % or more; with one number
# less than there are parameters in 78 % (docs/models/gradients.md).
_OF_A_KIND = 5

# The search is repeated about its result until that moves by less than this share of its error.
_STILL, _MOST_SEARCHES = 0.05, 6


def fit_data(
    path: Path,
    data: Path,
    keys: Sequence[str],
    settings: Sequence[str],
    run: Path | None,
    noise: Sequence[str],
    out: Path | None,
    plot: Path | None,
    overwrite: bool,
) -> None:
    """`evo-cpg fit`."""
    for file, suffixes in ((out, (".yaml", ".yml")), (plot, PLOT_SUFFIXES)):
        if file is not None:
            require_free(output_path(file, suffixes), overwrite)
    recording = read_motion(data)
    own = [text for text in settings if not text.startswith(_INITIAL)]
    whole = load_config(path, own)
    names = [key.partition("=")[0] for key in keys]
    start = {key.partition("=")[0]: _number(key) for key in keys if "=" in key}
    begun = {text.partition("=")[0]: _number(text) for text in settings if text not in own}
    inner = tuple(name for name in names if not name.startswith(_INITIAL))
    for name in inner:
        number_at(whole, name, path)
    both = [name for name in names if name in {text.partition("=")[0] for text in settings}]
    if both:
        raise UsageError(
            f"{both[0]}: is searched for and set; give its start as {both[0]}=VALUE alone"
        )
    _check_keys(names, run)
    genes = None
    if run is not None:
        if recording.targets:
            raise UsageError("--run: the champion moves the joints; leave out the target columns")
        # Before anything starts JAX.
        genes = np.asarray(open_champion(run)[1].genes, float)
    config = with_numbers(whole, {k: v for k, v in start.items() if k in inner}, path)
    parameters = parametrise(_trial_of(recording, config), path, inner)
    simulation = parameters.experiment.simulation
    _check_names(recording, simulation, [*begun, *set(names) - set(inner)], data)
    if genes is not None and (wrong := simulation.genome.misfit(genes)):
        raise UsageError(f"--run: the champion of {run} does not fit {path}: {wrong}")
    ordered = (*inner, *(name for name in names if name not in inner))
    values = [number_at(config, name) for name in inner]
    values += [start.get(name, begun.get(name, 0.0)) for name in ordered[len(inner) :]]
    positive = np.array([_is_positive(parameters, name) for name in ordered])
    numbers = np.isfinite(recording.data).sum()
    if numbers <= len(ordered):
        raise UsageError(f"{data}: {numbers} numbers cannot determine {len(ordered)} parameters")
    _require_many(recording, len(ordered), noise, data)
    late = late_commands(recording, simulation)
    if late:
        print(
            f"evo-cpg: warning: {data}: {late} commands come between two control steps, of which "
            f"there are {simulation.control_rate:g} a second, and take effect at the next",
            file=sys.stderr,
        )
    with working("compiling the search") as work:
        result, shown = _search(
            parameters, recording, ordered, np.array(values), positive, begun, genes, noise, work
        )
    _report(ordered, np.array(values), positive, result, recording)
    if out is not None:
        found = dict(zip(ordered, map(float, result.values), strict=True))
        fitted = with_numbers(whole, {k: v for k, v in found.items() if k in inner}, path)
        text = dump_config(fitted)
        write_text(out, text)
        print(out)
    if plot is not None:
        from evo_cpg.view.figure import save_figure
        from evo_cpg.view.parameter_plots import fit_figure

        figure = fit_figure(recording.time, recording.columns, recording.data, shown)
        print(save_figure(figure, plot))


def _trial_of(recording: MeasuredMotion, config: ExperimentConfig) -> ExperimentConfig:
    """The configuration with a single trial, as long as the recording."""
    rate = config.simulation.control_rate_hz
    steps = max(1, math.ceil(float(recording.time.max()) * rate - 1e-9))
    trial = config.simulation.model_copy(update={"steps": steps, "trials": 1})
    return config.model_copy(update={"simulation": trial})


def _number(text: str) -> float:
    key, _, value = text.partition("=")
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise UsageError(f"{key}: {value!r} is not a number")
    return number


def _check_keys(names: Sequence[str], run: Path | None) -> None:
    for i, name in enumerate(names):
        if name in names[:i]:
            raise UsageError(f"{name}: is given twice")
        if run is None and name.startswith("controller."):
            raise UsageError(
                f"{name}: the recorded commands move the joints, not the controller; "
                "--run RUN takes a champion's"
            )


def _check_names(
    recording: MeasuredMotion, simulation: "Simulation", beginnings: Sequence[str], path: Path
) -> None:
    from evo_cpg.simulation.track import beginning_names, column_names

    dofs = simulation.world.tree.dof_names
    for valid, given, prefix in (
        (column_names(simulation), recording.columns, ""),
        (dofs, recording.targets, TARGET),
    ):
        for name in given:
            if name not in valid:
                hint = nearest(name, valid) if valid else "the creature has no joints"
                raise UsageError(f"{path}: there is nothing called {prefix}{name}; {hint}")
    for name in beginnings:
        short, valid = name.removeprefix(_INITIAL), beginning_names(simulation)
        if short not in valid:
            raise UsageError(f"{name}: does not exist; {nearest(short, valid)}")


def _is_positive(parameters: Parameters, name: str) -> bool:
    """Whether a number of the configuration is positive and must be."""
    if name not in parameters.keys:
        return False
    value = number_at(parameters.config, name)
    try:
        with_numbers(parameters.config, {name: -abs(value)}, parameters.source)
    except ConfigError:
        return value > 0
    return False


def _require_many(
    recording: MeasuredMotion, parameters: int, noise: Sequence[str], path: Path
) -> None:
    """Check that there are numbers enough of each kind to tell how noisy it is."""
    counts: dict[str, int] = dict.fromkeys(KINDS, 0)
    for name, count in zip(recording.columns, np.isfinite(recording.data).sum(0), strict=True):
        counts[_kind(name)] += int(count)
    present = {kind: count for kind, count in counts.items() if count}
    least = parameters + _OF_A_KIND
    for kind, count in present.items():
        if len(present) > 1 and count < least and not noise:
            raise UsageError(
                f"{path}: {count} number(s) of kind {kind} are too few to tell how noisy they are, "
                f"beside {parameters} parameter(s) {least} are needed; give "
                f"{' '.join(f'--noise {each}=..' for each in present)}, or leave them out"
            )


def _noise(given: Sequence[str], present: Sequence[str]) -> np.ndarray | None:
    if not given:
        return None
    known = {text.partition("=")[0]: _number(text) for text in given}
    for kind, size in known.items():
        if kind not in KINDS or not size > 0:
            raise UsageError(f"--noise: {kind}={size:g}; give {'=.., '.join(KINDS)}=.. above 0")
    missing = [kind for kind in present if kind not in known]
    if missing:
        raise UsageError(f"--noise: also give that of {', '.join(missing)}, or none at all")
    return np.array([known[kind] for kind in present])


def _search(
    parameters: Parameters,
    recording: MeasuredMotion,
    names: tuple[str, ...],
    values: np.ndarray,
    positive: np.ndarray,
    begun: dict[str, float],
    genes: np.ndarray | None,
    given: Sequence[str],
    work: Work,
) -> tuple["Fit", np.ndarray]:
    """The estimate, and the motion that it gives; ``genes`` of a champion, if one moves the joints.

    Raises:
        UsageError: there is no estimate, or it is not allowed.
    """
    import equinox as eqx
    import jax
    import jax.numpy as jnp

    from evo_cpg.analysis.fit import fit
    from evo_cpg.simulation.track import ATTITUDE, track

    kinds = [_kind(name) for name in recording.columns]
    present = [kind for kind in KINDS if kind in kinds]
    kind_numbers = np.array([present.index(kind) for kind in kinds])
    wrapped = np.array([name in ATTITUDE for name in recording.columns])
    noise = _noise(given, present)
    inner = len(parameters.keys)
    fixed = {name.removeprefix(_INITIAL): value for name, value in begun.items()}

    def observe(theta: Any) -> Any:
        simulation = parameters.simulation(theta[:inner])
        if genes is None:
            driver = commands(recording, parameters.experiment.simulation)
            driver = eqx.tree_at(lambda d: d.tree, driver, simulation.world.tree)
            simulation = eqx.tree_at(lambda s: s.controller, simulation, driver)
        initial: dict[str, Any] = {k: jnp.asarray(v, theta.dtype) for k, v in fixed.items()}
        for name, value in zip(names[inner:], theta[inner:], strict=True):
            initial[name.removeprefix(_INITIAL)] = value
        own = jnp.asarray(np.zeros(0) if genes is None else genes, theta.dtype)
        return track(simulation, own, recording.time, recording.columns, initial)

    def search(start: Any, data: Any) -> Any:
        return fit(observe, data, start, positive, kind_numbers, wrapped, noise)

    with jax.enable_x64(True):
        program = jax.jit(search)
        for number in range(1, _MOST_SEARCHES + 1):
            if number > 1:
                work.doing(f"searching on from there: {number} of up to {_MOST_SEARCHES}")
            result = jax.device_get(program(jnp.asarray(values), jnp.asarray(recording.data)))
            unfelt = [n for n, felt in zip(names, result.felt, strict=True) if not felt]
            if unfelt:
                raise UsageError(
                    f"{unfelt[0]}: nothing that was measured depends on it at these values; leave "
                    "it out, or start elsewhere, KEY=VALUE"
                )
            if not np.isfinite(result.values).all():
                raise UsageError("the simulation diverges near these values; try others, KEY=VALUE")
            size = np.where(positive, np.abs(result.values), 1.0) * result.errors
            still = np.abs(result.values - values) <= _STILL * size
            values = np.asarray(result.values)
            try:
                parameters.require(values[:inner])
            except ConfigError as error:
                raise UsageError(_forbidden(names, values, size, error)) from None
            if still.all():
                break
        work.doing("the motion with the estimates")
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
        f"the data ask for {found}, which is not allowed ({error}); leave out what the data set at "
        "its bound, or start elsewhere, KEY=VALUE"
    )


def _kind(name: str) -> str:
    from evo_cpg.simulation.track import ATTITUDE, POSITION

    return "position" if name in POSITION else "attitude" if name in ATTITUDE else "angle"


def _report(
    names: tuple[str, ...],
    start: np.ndarray,
    positive: np.ndarray,
    result: "Fit",
    recording: MeasuredMotion,
) -> None:
    from evo_cpg.analysis.fit import doubts

    table = Table("parameter", "start", "estimate", "95 % interval", box=box.SIMPLE_HEAD)
    table.columns[0].overflow = "fold"
    for column in table.columns[1:]:
        column.justify = "right"
        column.no_wrap = True
    for name, first, value, low, high in zip(
        names, start, result.values, result.lower, result.upper, strict=True
    ):
        table.add_row(name, f"{first:.4g}", f"{value:.5g}", f"{low:.5g} to {high:.5g}")
    Console().print(table)
    units = {"position": "m", "attitude": "rad", "angle": "rad"}
    kinds = [_kind(name) for name in recording.columns]
    present = [kind for kind in KINDS if kind in kinds]
    noise = [
        f"{kind} {size:.3g} {units[kind]}" for kind, size in zip(present, result.noise, strict=True)
    ]
    print(f"noise: {', '.join(noise)}; {int(result.freedom)} degrees of freedom")
    for words in doubts(names, positive, result):
        print(f"beware: {words}")
