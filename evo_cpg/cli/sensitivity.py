"""`evo-cpg sensitivity`: rank the parameters that a champion's success depends on."""

import itertools
import math
from typing import TYPE_CHECKING, Annotated, Any

import typer

from evo_cpg.cli.errors import UsageError
from evo_cpg.cli.options import Folder, Number, Run, Which
from evo_cpg.cli.writing import writes_to_run

if TYPE_CHECKING:
    import numpy as np

    from evo_cpg.analysis.sensitivity import Sensitivity
    from evo_cpg.api.display import Work
    from evo_cpg.io.parameters import Parameters
    from evo_cpg.training.checkpoint import Champion

# Number of rows on the terminal and of bars in the picture. The table file has all rows.
_SHOWN = 25

# Pseudo-key for a factor of all genes. It is not a key of the configuration.
GENES = "genes"


@writes_to_run("out", "--out")
def sensitivity(
    run: Run,
    keys: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="KEY",
            help="Numbers of the configuration, such as world.water.form_drag, or genes "
            "(default: all except shapes in water).",
        ),
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(min=0, help="Seconds to simulate from the start of the trial (default: all)."),
    ] = None,
    shapes: Annotated[
        bool, typer.Option("--shapes", help="Include numbers that change surfaces in water (slow).")
    ] = False,
    number: Number = None,
    out: Folder = None,
) -> None:
    """Rank the parameters that speed and fitness depend on."""
    from evo_cpg.api.display import working
    from evo_cpg.cli.champions import open_champion
    from evo_cpg.cli.tables import show_table
    from evo_cpg.files import make_folder, write_table
    from evo_cpg.io.parameters import all_parameters, parametrise
    from evo_cpg.io.run import class_folders
    from evo_cpg.view.answer_plots import sensitivity_figure
    from evo_cpg.view.figure import save_figure

    which = Which(number)
    opened = open_champion(run, which)
    experiment, config, beside = opened.experiment, opened.config, class_folders(opened.folder)
    if experiment.simulation.situations[1:]:
        print(f"{run}: using the first of {experiment.trials} trials")
    rate, steps = experiment.simulation.control_rate, experiment.simulation.steps
    if seconds is not None:
        control_steps = seconds * rate
        # A displacement needs two steps. The comparison also rejects infinity and NaN.
        if not 1.5 < control_steps < steps + 0.5:
            raise UsageError(
                f"--seconds: {seconds:g} s is not allowed. Allowed: {2 / rate:.3g} to "
                f"{steps / rate:g} s, the length of a trial of {run}"
            )
        steps = round(control_steps)
    trial = config.simulation.model_copy(update={"seconds": steps / rate})
    if isinstance(trial.trials, list):
        trial = trial.model_copy(update={"trials": trial.trials[:1]})
    config = config.model_copy(update={"simulation": trial})
    bits = not getattr(config.controller, "graded", True)
    if bits and GENES in (keys or []):
        raise UsageError(
            f"{GENES}: bits are 0 or 1 and cannot change by 1 %. Allowed: keys of numbers, or "
            "controller.graded: true"
        )
    source, chosen = opened.folder.config, tuple(key for key in keys or [] if key != GENES)
    if not keys:
        with working("finding the numbers that can change"):
            chosen = all_parameters(config, source, beside, shapes)
    with working("finding the effects of each number"):
        parameters = parametrise(config, source, chosen, beside)
    place = make_folder(out or run)
    scaled = not bits and (not keys or GENES in keys)
    with working("compiling and differentiating the trial") as work:
        speed, fitness = _measure(parameters, opened.champion, scaled, work)
    rows = [_row(one, other) for one in speed for other in fitness if one.key == other.key]
    table = place / f"sensitivity{which.of_run}.csv"
    write_table(table, rows)
    time = steps / rate
    title = f"{experiment.name}: speed {speed[0].measure:.3g} m/s over {time:.3g} s"
    figure = sensitivity_figure(speed, "speed", title, _SHOWN)
    picture = save_figure(figure, table.with_suffix(".png"))
    show_table(("parameter", "value", "speed", "fitness"), map(_cells, rows[:_SHOWN]))
    stuck = sum(not one.step for one in speed)
    doubtful = sum(not one.confirmed for one in speed) - stuck
    print(f"speed {speed[0].measure:.4g} m/s, fitness {fitness[0].measure:.4g} over {time:.3g} s")
    if doubtful:
        print(
            f"{doubtful} of {len(rows)} marked ?: trials with 1 % more and less disagree with the "
            "derivative, so the table shows their change. Try a shorter trial: --seconds"
        )
    if stuck:
        print(
            f"{stuck} of {len(rows)} marked ?: a change by 1 % is not allowed in either direction, "
            "so the derivative is not checked"
        )
    print(table)
    print(picture)


def _measure(parameters: "Parameters", champion: "Champion", scaled: bool, work: "Work") -> tuple:
    """Compute the sensitivities of speed and fitness, in float64."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    from evo_cpg.analysis.sensitivity import changed, differentiate, measured, sensitivities
    from evo_cpg.io.errors import ConfigError
    from evo_cpg.training.experiment import champion_keys

    keys = (*parameters.keys, GENES) if scaled else parameters.keys
    values = np.append(parameters.values, 1.0) if scaled else parameters.values
    noise = champion_keys(parameters.experiment, champion)
    with jax.enable_x64(True):
        genes = jnp.asarray(champion.genes, jnp.float64)
        own = None if noise is None else noise[:, 0]

        def outcome(values: Any) -> Any:
            strength = values[-1] if scaled else 1.0
            simulation = parameters.simulation(values[: len(parameters.keys)])
            return measured(simulation, strength * genes, champion.scales, own)

        program = jax.jit(lambda values: differentiate(outcome, values))
        measures, slopes = jax.device_get(program(jnp.asarray(values)))
        work.doing("changing each number")
        tried = itertools.count(1)

        def allowed(place: "np.ndarray") -> bool:
            work.reached(next(tried), 2 * len(values))
            try:
                parameters.require(place[: len(parameters.keys)])
            except ConfigError:
                return False
            return True

        places = changed(values, allowed)
        steps = np.diagonal(places[1] - places[0])
        work.doing("compiling and simulating the trial with each number changed")
        run_all = jax.jit(jax.vmap(outcome, out_axes=1))
        after = jax.device_get(run_all(jnp.asarray(places.reshape(-1, len(values)))))
    return sensitivities(keys, values, measures, slopes, after.reshape(len(measures), 2, -1), steps)


def _row(speed: "Sensitivity", fitness: "Sensitivity") -> dict[str, str | float | int]:
    """Return a row of the table file."""
    row: dict[str, str | float | int] = {
        "key": speed.key,
        "value": speed.value,
        "relative": int(speed.value != 0),
    }
    for name, one in (("speed", speed), ("fitness", fitness)):
        row |= {
            f"{name}_slope": one.slope,
            f"{name}_elasticity": one.elasticity,
            f"{name}_found": one.finite,
            f"{name}_confirmed": int(one.confirmed),
        }
    return row


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    """Return the cells of a row of the table on the terminal."""
    words = []
    for name in ("speed", "fitness"):
        sure = row[f"{name}_confirmed"]
        size = row[f"{name}_elasticity" if sure else f"{name}_found"]
        unit = " %/%" if row["relative"] else " %/unit"
        size = size if row["relative"] else 100 * size
        # A change relative to a measure of 0 is not finite.
        text = f"{size:+.3g}{unit}" if math.isfinite(size) else "\N{EN DASH}"
        words.append(f"{'' if sure else '? '}{text}")
    return row["key"], f"{row['value']:.4g}", *words
