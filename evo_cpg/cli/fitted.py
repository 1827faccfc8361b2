"""The estimation of parameters from a recorded motion, for the command `fit`."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from evo_cpg.cli.errors import UsageError
from evo_cpg.cli.measured_motion import TARGET, MeasuredMotion, commands
from evo_cpg.cli.progress import Work
from evo_cpg.cli.tables import show_table
from evo_cpg.config.errors import ConfigError, nearest
from evo_cpg.config.numbers import number_at, with_numbers
from evo_cpg.config.parameters import Parameters
from evo_cpg.config.schema.experiment import ExperimentConfig

if TYPE_CHECKING:
    from evo_cpg.analysis.fit import Fit
    from evo_cpg.simulation.simulation import Simulation

INITIAL = "initial."
KINDS = ("position", "attitude", "angle")

# Where columns of several kinds are told apart by their noise, a kind needs so many numbers more
# than there are parameters. With that intervals hold the truth in 92 % or more; with one number
# less than there are parameters in 78 % (docs/models/gradients.md).
_OF_A_KIND = 5

# The search is repeated about its result until that moves by less than this share of its error.
_STILL, _MOST_SEARCHES = 0.05, 6


def number_in(text: str) -> float:
    """Return the number in ``KEY=VALUE``.

    Raises:
        UsageError: the value is no finite number.
    """
    key, _, value = text.partition("=")
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise UsageError(f"{key}: {value!r} is not a number")
    return number


def trial_of(recording: MeasuredMotion, config: ExperimentConfig) -> ExperimentConfig:
    """The configuration with a single trial, as long as the recording."""
    rate = config.simulation.control_rate_hz
    steps = max(1, math.ceil(float(recording.time.max()) * rate - 1e-9))
    trial = config.simulation.model_copy(update={"steps": steps, "trials": 1})
    return config.model_copy(update={"simulation": trial})


def check_names(
    recording: MeasuredMotion, simulation: "Simulation", beginnings: Sequence[str], path: Path
) -> None:
    """Check the names of columns and of initial values against the creature.

    Raises:
        UsageError: one does not exist.
    """
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
        short, valid = name.removeprefix(INITIAL), beginning_names(simulation)
        if short not in valid:
            raise UsageError(f"{name}: does not exist; {nearest(short, valid)}")


def is_positive(parameters: Parameters, name: str) -> bool:
    """Whether a number of the configuration is positive and must be."""
    if name not in parameters.keys:
        return False
    value = number_at(parameters.config, name)
    try:
        with_numbers(parameters.config, {name: -abs(value)}, parameters.source)
    except ConfigError:
        return value > 0
    return False


def require_many(
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
    known = {text.partition("=")[0]: number_in(text) for text in given}
    for kind, size in known.items():
        if kind not in KINDS or not size > 0:
            raise UsageError(f"--noise: {kind}={size:g}; give {'=.., '.join(KINDS)}=.. above 0")
    missing = [kind for kind in present if kind not in known]
    if missing:
        raise UsageError(f"--noise: also give that of {', '.join(missing)}, or none at all")
    return np.array([known[kind] for kind in present])


def search(
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
    fixed = {name.removeprefix(INITIAL): value for name, value in begun.items()}

    def observe(theta: Any) -> Any:
        simulation = parameters.simulation(theta[:inner])
        if genes is None:
            driver = commands(recording, parameters.experiment.simulation)
            driver = eqx.tree_at(lambda d: d.tree, driver, simulation.world.tree)
            simulation = eqx.tree_at(lambda s: s.controller, simulation, driver)
        initial: dict[str, Any] = {k: jnp.asarray(v, theta.dtype) for k, v in fixed.items()}
        for name, value in zip(names[inner:], theta[inner:], strict=True):
            initial[name.removeprefix(INITIAL)] = value
        own = jnp.asarray(
            np.zeros(simulation.genome.count) if genes is None else genes, theta.dtype
        )
        return track(simulation, own, recording.time, recording.columns, initial)

    def fit_to(start: Any, data: Any) -> Any:
        return fit(observe, data, start, positive, kind_numbers, wrapped, noise)

    with jax.enable_x64(True):
        program = jax.jit(fit_to)
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


def report(
    names: tuple[str, ...],
    start: np.ndarray,
    positive: np.ndarray,
    result: "Fit",
    recording: MeasuredMotion,
) -> None:
    """Print the estimates with their intervals, the noise and what is doubtful."""
    from evo_cpg.analysis.fit import fit_warnings

    found = zip(names, start, result.values, result.lower, result.upper, strict=True)
    rows = [
        (name, f"{first:.4g}", f"{value:.5g}", f"{low:.5g} to {high:.5g}")
        for name, first, value, low, high in found
    ]
    show_table(("parameter", "start", "estimate", "95 % interval"), rows)
    units = {"position": "m", "attitude": "rad", "angle": "rad"}
    kinds = [_kind(name) for name in recording.columns]
    present = [kind for kind in KINDS if kind in kinds]
    noise = [
        f"{kind} {size:.3g} {units[kind]}" for kind, size in zip(present, result.noise, strict=True)
    ]
    print(f"noise: {', '.join(noise)}; {int(result.freedom)} degrees of freedom")
    for words in fit_warnings(names, positive, result):
        print(f"beware: {words}")
