"""`evo-cpg refine`: improve a champion along the gradient of its fitness."""

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from evo_cpg.cli.errors import UsageError
from evo_cpg.cli.options import CoresOfRun, Number, Run

if TYPE_CHECKING:
    import numpy as np

    from evo_cpg.io.parameters import Parameters
    from evo_cpg.training.ascent import Free
    from evo_cpg.training.experiment import ExperimentParts
    from evo_cpg.training.refine import Round


def refine(
    run: Run,
    keys: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="KEY",
            help="Numbers of the configuration to refine together with the genes, such as "
            "controller.cpg.time_scale.",
        ),
    ] = None,
    rounds: Annotated[int, typer.Option(min=1, help="Rounds of ascent and selection.")] = 5,
    steps: Annotated[
        int, typer.Option(min=1, help="Gradient steps of each individual in a round.")
    ] = 20,
    number: Number = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random starts and step sizes.")] = 0,
    cores: CoresOfRun = None,
) -> None:
    """Improve the champion along the gradient of its fitness."""
    from evo_cpg.cli.champions import use_cores_of
    from evo_cpg.training.run_folder import RunFolder

    use_cores_of(run, cores)
    with RunFolder(run).locked():
        _refine(run, keys or [], rounds, steps, number, seed)


def _refine(
    run: Path, keys: Sequence[str], rounds: int, steps: int, number: int | None, seed: int
) -> None:
    from evo_cpg.api.display import progress
    from evo_cpg.api.training import now
    from evo_cpg.cli.building import build
    from evo_cpg.cli.champions import REPLAY_TOLERANCE, champion_of, open_and_build, replayed
    from evo_cpg.io.fingerprint import fingerprint
    from evo_cpg.io.load import dump_config
    from evo_cpg.io.parameters import parametrise
    from evo_cpg.io.run import class_folders
    from evo_cpg.training.refine import Refinement, Round, compile_refinement
    from evo_cpg.training.run_folder import refinements

    opened = open_and_build(run)
    opened.require_configured()
    folder, config, experiment = opened.folder, opened.config, opened.experiment
    champion, motion, _ = folder.load_champion()
    if number is not None and number != champion.run:
        champion, motion = champion_of(folder, number), None
    opened.with_champion(champion)
    beside = class_folders(opened.folder)
    if not getattr(config.controller, "graded", True):
        controller = config.controller.model_copy(update={"graded": True})
        config = config.model_copy(update={"controller": controller})
        experiment = build(config, folder.config, beside)
        print(
            "bits have no derivative, so the genes count as graded. After a gain in fitness, the "
            "configuration in RUN has controller.graded: true",
            file=sys.stderr,
        )
    if keys and experiment.runs > 1:
        raise UsageError(
            f"{keys[0]}: cannot be refined, because the {experiment.runs} runs of {run} share one "
            "configuration. Leave the keys out, or use a folder with a single run"
        )
    parameters = parametrise(config, folder.config, keys, beside) if keys else None
    history: list[Round] = []

    def keep(done: Round) -> None:
        if done.gain > 0:
            if not any(before.gain > 0 for before in history):
                folder.keep_before(champion, motion)
            found = parameters.config_at(done.values) if parameters else config
            folder.replace_champion(done.champion, dump_config(found))
        history.append(done)
        folder.write_table("refine.csv", [_row(one, keys) for one in history])

    recorded = champion.fitness
    try:
        with progress("rounds", rounds) as show:

            def tell(done: Round) -> None:
                keep(done)
                gained = f"gained {done.champion.fitness - done.initial_fitness:+.4f}"
                state = f"fitness {done.champion.fitness:8.4f}  {gained}  {_derivatives(done)}"
                show(state, done.seconds)

            refine = compile_refinement(
                experiment,
                Refinement(rounds, steps, seed=seed),
                devices=opened.devices,
                free=parameters and _free(parameters),
            )
            refine(champion, tell)
    except KeyboardInterrupt:
        print(f"interrupted. The gain so far is in {folder.path}", file=sys.stderr)
        raise
    last = history[-1]
    if not math.isclose(
        last.initial_fitness, recorded, rel_tol=REPLAY_TOLERANCE, abs_tol=REPLAY_TOLERANCE
    ):
        print(
            f"the champion's fitness is {last.initial_fitness:.4f} here, not {recorded:.4f} as "
            f"recorded. {folder.config} or the program has changed since the evolution",
            file=sys.stderr,
        )
    if not any(done.finite for done in history):
        print("no gradient was finite, so there was no direction to climb", file=sys.stderr)
    if not any(done.gain > 0 for done in history):
        print(
            f"no better individual found in {rounds * steps} steps. Try another --seed",
            file=sys.stderr,
        )
        print(folder.path)
        return
    best, _, _ = folder.load_champion()
    opened = open_and_build(run)
    folder.save_champion(best, replayed(opened, best).recording)
    done = {"finished": now(), "command": sys.argv[1:], "from": last.initial_fitness}
    done["to"] = last.champion.fitness
    before = refinements(folder.read_meta())
    folder.update_meta(refined=[*before, done], fingerprint=fingerprint(opened.config))
    terms = ", ".join(f"{name} {value:.3g}" for name, value in last.champion.terms.items())
    for key, value in zip(keys, last.values, strict=True):
        print(f"{key}: {value:.6g}", file=sys.stderr)
    print(
        f"fitness {last.initial_fitness:.4f} -> {last.champion.fitness:.4f} ({terms})",
        file=sys.stderr,
    )
    print(folder.path)


def _free(parameters: "Parameters") -> "Free":
    from evo_cpg.io.build import build_experiment
    from evo_cpg.io.errors import ConfigError
    from evo_cpg.training.ascent import Free

    def rebuild(values: "np.ndarray") -> "ExperimentParts | None":
        try:
            config = parameters.config_at(values)
            experiment = build_experiment(config, parameters.source, parameters.folders)
            parameters.require(values)
            return experiment
        except ConfigError:
            # The values are not allowed, or they change the layout of the simulation.
            return None

    return Free(parameters.values, parameters.simulation, rebuild)


def _row(done: "Round", keys: Sequence[str]) -> dict[str, float]:
    """Return a row of refine.csv."""
    own = {
        "round": done.number,
        "fitness": done.champion.fitness,
        "gain": done.gain,
        "slopes": done.gradients,
        "finite_slopes": done.finite,
        "seconds": done.seconds,
    }
    # These columns replace a term of equal name, which a user's own task may have.
    return own | done.champion.terms | dict(zip(keys, done.values.tolist(), strict=True)) | own


def _derivatives(done: "Round") -> str:
    lost = done.gradients - done.finite
    return f"{done.gradients} gradients" + (f", {lost} not finite" if lost else "")
