"""Improve a run's champion along the gradient of its fitness."""

import functools
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from evo_cpg.api.progress import progress
from evo_cpg.api.run_start import now
from evo_cpg.api.runs import REPLAY_TOLERANCE, build, champion_of, open_and_build, replayed
from evo_cpg.errors import UsageError, advise
from evo_cpg.files import write_table
from evo_cpg.io.build import build_experiment
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.load import dump_config
from evo_cpg.io.parameters import Parameters, parametrise
from evo_cpg.io.run import class_folders, fingerprint
from evo_cpg.io.trust import trusting
from evo_cpg.training.ascent import Free
from evo_cpg.training.experiment import ExperimentParts
from evo_cpg.training.refine import Refinement, Round, compile_refinement
from evo_cpg.training.run_folder import RunFolder, refinements


class Refined(NamedTuple):
    """Result of `refine`.

    Attributes:
        folder: the run folder. Its champion is replaced if there was a gain.
        before: fitness of the champion before the first round.
        fitness: fitness of the best individual.
        terms: task's terms of the best individual.
        numbers: refined numbers of the configuration, by key.
        gained: whether a better individual was found.
        rounds: results of all rounds, as in refine.csv.
    """

    folder: Path
    before: float
    fitness: float
    terms: dict[str, float]
    numbers: dict[str, float]
    gained: bool
    rounds: list[Round]


def refine(
    run: Path | str,
    keys: Sequence[str] = (),
    rounds: int = 5,
    steps: int = 20,
    number: int | None = None,
    seed: int = 0,
    cores: int | None = None,
    trust: bool = False,
) -> Refined:
    """Improve a run's champion along the gradient of its fitness.

    A better individual replaces the champion after each round. The first one is kept in the folder.

    Args:
        run: run folder.
        keys: numbers of the configuration to refine together with the genes.
        rounds: rounds of ascent and selection.
        steps: gradient steps of each individual in a round.
        number: number of one of several runs side by side, or None for the best.
        seed: seed of the random starts and step sizes.
        cores: number of cores, or None for those that trained the run.
        trust: whether to trust the configuration, see `load`.

    Raises:
        ConfigError: a key is not a number of the configuration.
        LockedError: another process writes into the folder.
        RunFolderError: there is no run, or it has no champion.
        UsageError: keys are given for several runs, or there is no such run.
    """
    folder = RunFolder(run)
    with trusting(trust), folder.locked():
        opened = open_and_build(run, cores)
        opened.require_configured()
        config, experiment, beside = opened.config, opened.experiment, class_folders(opened.folder)
        champion, motion, _ = folder.load_champion()
        if number is not None and number != champion.run:
            champion, motion = champion_of(folder, number), None
        opened.with_champion(champion)
        if not getattr(config.controller, "graded", True):
            controller = config.controller.model_copy(update={"graded": True})
            config = config.model_copy(update={"controller": controller})
            experiment = build(config, folder.config, beside)
            advise(
                "bits have no derivative, so the genes count as graded. After a gain in fitness, "
                "the configuration in RUN has controller.graded: true"
            )
        if experiment.simulation.plans is not None:
            raise UsageError(
                f"{run}: genes of body plans have steps, so refine the exported animal: "
                f"evo-cpg export {run} animal.yaml, then train animal.yaml --from {run}"
            )
        if experiment.simulation.genome.misfit(champion.genes):
            raise UsageError(f"{run}: the body's genes are bits, which have no derivative")
        if keys and experiment.simulation.has_own_bodies:
            raise UsageError(
                f"{keys[0]}: cannot be refined in a run whose bodies evolve. Leave the keys out, "
                f"or refine a run of the exported body: evo-cpg export {run} animal.yaml"
            )
        if keys and experiment.simulation.draws is not None:
            raise UsageError(
                f"{keys[0]}: cannot be refined in a run that draws numbers (courses.draw). Leave "
                "the keys out"
            )
        if keys and experiment.runs > 1:
            raise UsageError(
                f"{keys[0]}: cannot be refined, because the {experiment.runs} runs of {run} share "
                "one configuration. Leave the keys out, or use a folder with a single run"
            )
        parameters = parametrise(config, folder.config, keys, beside) if keys else None
        done: list[Round] = []

        settings = Refinement(rounds, steps, seed=seed)
        free = None
        if parameters is not None:
            rebuild = functools.partial(_rebuilt, parameters)
            free = Free(parameters.values, parameters.simulation, rebuild)
        with progress("rounds", rounds) as show:

            def report(latest: Round) -> None:
                if latest.gain > 0:
                    if not any(before.gain > 0 for before in done):
                        folder.keep_before(champion, motion)
                    found = parameters.config_at(latest.values) if parameters else config
                    folder.replace_champion(latest.champion, dump_config(found))
                done.append(latest)
                write_table(folder.path / "refine.csv", [_row(one, keys) for one in done])
                lost = latest.gradients - latest.finite
                show(
                    f"fitness {latest.champion.fitness:8.4f}  "
                    f"gained {latest.champion.fitness - latest.initial_fitness:+.4f}  "
                    f"{latest.gradients} gradients" + (f", {lost} not finite" if lost else ""),
                    latest.seconds,
                )

            compile_refinement(experiment, settings, devices=opened.devices, free=free)(
                champion, report
            )
        last, gained = done[-1], any(one.gain > 0 for one in done)
        found, recorded = last.initial_fitness, champion.fitness
        if not math.isclose(found, recorded, rel_tol=REPLAY_TOLERANCE, abs_tol=REPLAY_TOLERANCE):
            advise(
                f"the champion's fitness is {found:.4f} here, not {recorded:.4f} as recorded. "
                f"{folder.config} or the program has changed since the evolution"
            )
        if not any(one.finite for one in done):
            advise("no gradient was finite, so there was no direction to climb")
        if not gained:
            advise(f"no better individual found in {rounds * steps} steps. Try another seed")
        if gained:
            best, _, _ = folder.load_champion()
            opened = open_and_build(run, cores)
            folder.save_champion(best, replayed(opened, best).recording)
            note = {"finished": now(), "command": sys.argv[1:], "from": last.initial_fitness}
            note["to"] = last.champion.fitness
            before = refinements(folder.read_meta())
            folder.update_meta(refined=[*before, note], fingerprint=fingerprint(opened.config))
    return Refined(
        folder=folder.path,
        before=last.initial_fitness,
        fitness=last.champion.fitness,
        terms=last.champion.terms,
        numbers=dict(zip(keys, last.values.tolist(), strict=True)),
        gained=gained,
        rounds=done,
    )


def _rebuilt(parameters: Parameters, values: np.ndarray) -> ExperimentParts | None:
    """Return the experiment with other values of the free numbers, or None.

    None means that the values are not allowed, or that they change the layout of the simulation.
    """
    try:
        config = parameters.config_at(values)
        experiment = build_experiment(config, parameters.source, parameters.folders)
        parameters.require(values)
        return experiment
    except ConfigError:
        return None


def _row(one: Round, keys: Sequence[str]) -> dict[str, float]:
    """Return a row of refine.csv."""
    own = {
        "round": one.number,
        "fitness": one.champion.fitness,
        "gain": one.gain,
        "slopes": one.gradients,
        "finite_slopes": one.finite,
        "seconds": one.seconds,
    }
    # These columns replace a term of equal name, which a user's own task may have.
    return own | one.champion.terms | dict(zip(keys, one.values.tolist(), strict=True)) | own
