"""Rank the parameters that the speed and fitness of a champion depend on."""

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from evo_cpg.analysis.sensitivity import (
    Sensitivity,
    changed,
    differentiate,
    measured,
    sensitivities,
)
from evo_cpg.api.progress import Work, working
from evo_cpg.api.runs import open_champion, suffix
from evo_cpg.errors import UsageError
from evo_cpg.files import make_folder, write_table
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.parameters import Parameters, all_parameters, parametrise
from evo_cpg.io.run import class_folders
from evo_cpg.io.trust import trusting
from evo_cpg.training.checkpoint import Champion
from evo_cpg.training.experiment import champion_keys

# Pseudo-key for a factor of all genes. It is not a key of the configuration.
GENES = "genes"

# Largest number of bars in the picture.
_BARS = 25


class Sensitivities(NamedTuple):
    """Result of `sensitivity`.

    Attributes:
        name: name of the experiment.
        seconds: simulated time, s.
        speed: sensitivity of the speed to each parameter, the most important first.
        fitness: sensitivity of the fitness, in an order of its own.
        trials: number of trials of an individual, of which the first is used.
        number: number of the run among several, as requested.
    """

    name: str
    seconds: float
    speed: tuple[Sensitivity, ...]
    fitness: tuple[Sensitivity, ...]
    trials: int = 1
    number: int | None = None

    @property
    def rows(self) -> list[dict[str, str | float | int]]:
        """Rows of sensitivity.csv, one for each parameter."""
        fitness = {one.key: one for one in self.fitness}
        rows = []
        for speed in self.speed:
            row = {"key": speed.key, "value": speed.value, "relative": int(speed.value != 0)}
            for name, one in (("speed", speed), ("fitness", fitness[speed.key])):
                row |= {
                    f"{name}_slope": one.slope,
                    f"{name}_elasticity": one.elasticity,
                    f"{name}_found": one.finite,
                    f"{name}_confirmed": int(one.confirmed),
                }
            rows.append(row)
        return rows

    def save(self, folder: Path | str) -> list[Path]:
        """Write sensitivity.csv and sensitivity.png into a folder, and return their paths.

        Raises:
            OutputError: the files cannot be written.
        """
        from evo_cpg.view.answer_plots import sensitivity_figure
        from evo_cpg.view.figure import save_figure

        table = make_folder(Path(folder)) / f"sensitivity{suffix(self.number)}.csv"
        write_table(table, self.rows)
        measure = self.speed[0].measure
        title = f"{self.name}: speed {measure:.3g} m/s over {self.seconds:.3g} s"
        figure = sensitivity_figure(self.speed, "speed", title, _BARS)
        return [table, save_figure(figure, table.with_suffix(".png"))]


def sensitivity(
    run: Path | str,
    keys: Sequence[str] = (),
    seconds: float | None = None,
    shapes: bool = False,
    number: int | None = None,
    trust: bool = False,
) -> Sensitivities:
    """Rank the parameters that speed and fitness of a champion depend on, in its first trial.

    Derivatives are compared with trials in which each parameter is 1 % larger and smaller.

    Args:
        run: run folder.
        keys: numbers of the configuration, or ``genes`` for a factor of all genes. Empty for all
            except shapes in water.
        seconds: time to simulate from the start of the trial, s, or None for the whole trial.
        shapes: include numbers that change surfaces in water, which takes long.
        number: number of one of several runs side by side, or None for the best.
        trust: whether to trust the configuration, see `load`.

    Raises:
        ConfigError: a key is not a number of the configuration.
        RunFolderError: there is no run, or it has no champion.
        UsageError: the time does not fit the trial, or the genes are bits.
    """
    with trusting(trust):
        opened = open_champion(run, number).on_course()
        # The first trial alone, and of another duration if given.
        config, simulation = opened.config, opened.experiment.simulation
        rate, steps = simulation.control_rate, simulation.steps
        if seconds is not None:
            # A displacement needs two steps. The comparison also rejects infinity and NaN.
            if not 1.5 < seconds * rate < steps + 0.5:
                raise UsageError(
                    f"seconds: {seconds:g} s is not allowed. Allowed: {2 / rate:.3g} to "
                    f"{steps / rate:g} s, the length of a trial of {opened.folder.path}"
                )
            steps = round(seconds * rate)
        trial = config.simulation.model_copy(update={"seconds": steps / rate})
        if isinstance(trial.trials, list):
            trial = trial.model_copy(update={"trials": trial.trials[:1]})
        config = config.model_copy(update={"simulation": trial})
        bits = not getattr(config.controller, "graded", True)
        if bits and GENES in keys:
            raise UsageError(
                f"{GENES}: bits are 0 or 1 and cannot change by 1 %. Allowed: keys of numbers, or "
                "controller.graded: true"
            )
        source, beside = opened.folder.config, class_folders(opened.folder)
        chosen = tuple(key for key in keys if key != GENES)
        if not keys:
            with working("finding the numbers that can change"):
                chosen = all_parameters(config, source, beside, shapes)
        with working("finding the effects of each number"):
            parameters = parametrise(config, source, chosen, beside)
        scaled = not bits and (not keys or GENES in keys)
        with working("compiling and differentiating the trial") as work:
            speed, fitness = _measure(parameters, opened.champion, scaled, work)
    return Sensitivities(
        name=opened.experiment.name,
        seconds=config.simulation.seconds,
        speed=speed,
        fitness=fitness,
        trials=len(simulation.situations),
        number=number,
    )


def _measure(
    parameters: Parameters, champion: Champion, scaled: bool, work: Work
) -> tuple[tuple[Sensitivity, ...], ...]:
    """Compute the sensitivities of speed and fitness, in float64."""
    count = len(parameters.keys)
    keys = (*parameters.keys, GENES) if scaled else parameters.keys
    values = np.append(parameters.values, 1.0) if scaled else parameters.values
    noise = champion_keys(parameters.experiment, champion)
    tried = itertools.count(1)

    def allowed(place: np.ndarray) -> bool:
        work.reached(next(tried), 2 * len(values))
        try:
            parameters.require(place[:count])
        except ConfigError:
            return False
        return True

    with jax.enable_x64(True):
        genes = jnp.asarray(champion.genes, jnp.float64)
        own = None if noise is None else noise[:, 0]

        def outcome(values: Any) -> Any:
            strength = values[-1] if scaled else 1.0
            simulation = parameters.simulation(values[:count])
            return measured(simulation, strength * genes, champion.scales, own)

        program = jax.jit(lambda values: differentiate(outcome, values))
        measures, slopes = jax.device_get(program(jnp.asarray(values)))
        work.doing("changing each number")
        places = changed(values, allowed)
        steps = np.diagonal(places[1] - places[0])
        work.doing("compiling and simulating the trial with each number changed")
        run_all = jax.jit(jax.vmap(outcome, out_axes=1))
        after = jax.device_get(run_all(jnp.asarray(places.reshape(-1, len(values)))))
    return sensitivities(keys, values, measures, slopes, after.reshape(len(measures), 2, -1), steps)
