"""The command that polishes a champion along the slope of its fitness: refine."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from evo_cpg.cli.errors import UsageError
from evo_cpg.cli.progress import progress
from evo_cpg.cli.training import champion_of, misfit, now, open_run, use_cores_of
from evo_cpg.config.build import build_experiment
from evo_cpg.config.load import dump_config
from evo_cpg.config.parameters import parametrise
from evo_cpg.training.run_folder import RunFolderError

if TYPE_CHECKING:
    from evo_cpg.training.refine import Round


def refine_run(
    run: Path,
    keys: Sequence[str],
    rounds: int,
    steps: int,
    number: int | None,
    seed: int,
    cores: int | None,
) -> None:
    """`evo-cpg refine`."""
    use_cores_of(run, cores)
    folder, config, experiment = open_run(run)
    champion, _, _ = folder.load_champion()
    if number is not None and number != champion.run:
        champion = champion_of(folder, number)
    wrong = misfit(experiment, champion)
    if wrong:
        raise RunFolderError(f"{folder.config} was changed after training: {wrong}")
    if not getattr(config.controller, "graded", True):
        controller = config.controller.model_copy(update={"graded": True})
        config = config.model_copy(update={"controller": controller})
        experiment = build_experiment(config, folder.config)
        print("the genes are graded from now on: bits have no slopes", file=sys.stderr)
    parameters = parametrise(config, folder.config, keys) if keys else None
    if keys and experiment.runs > 1:
        raise UsageError(
            f"{keys[0]}: {run} holds {experiment.runs} runs, whose champions share one "
            "configuration; free numbers take a run of its own"
        )
    from evo_cpg.training.ascent import Free
    from evo_cpg.training.loop import replay_champion
    from evo_cpg.training.refine import Refinement, Round, compile_refinement

    free = parameters and Free(
        parameters.values,
        parameters.simulation,
        lambda values: build_experiment(parameters.config_at(values), folder.config),
    )
    devices = folder.read_meta().get("devices", 1)
    rows: list[dict[str, float]] = []

    def keep(done: Round) -> None:
        if done.gain > 0:
            if not any(row["gain"] > 0 for row in rows):
                folder.keep_champion()
            found = parameters.config_at(done.values) if parameters else config
            folder.reopen(dump_config(found))
            folder.replace_champion(done.champion)
        rows.append(
            {
                "round": done.number,
                "fitness": done.champion.fitness,
                "gain": done.gain,
                "slopes": done.slopes,
                "finite_slopes": done.finite,
                "seconds": done.seconds,
                **done.champion.terms,
                **dict(zip(keys, done.values.tolist(), strict=True)),
            }
        )
        folder.write_table("refine.csv", rows)

    before = champion.fitness
    try:
        with progress("refine", "round", rounds) as show:

            def tell(done: Round) -> None:
                keep(done)
                gained = f"gained {done.champion.fitness - before:+.4f}"
                state = f"fitness {done.champion.fitness:8.4f}  {gained}  {_slopes(done)}"
                show(done.number, state, done.seconds)

            refine = compile_refinement(
                experiment, Refinement(rounds, steps, seed=seed), devices=devices, free=free
            )
            champion = refine(champion, tell)
    except KeyboardInterrupt:
        print(f"interrupted; what was gained is in {folder.path}", file=sys.stderr)
        raise
    if not any(row["finite_slopes"] for row in rows):
        print("no slope was finite: the fitness has none here to climb along", file=sys.stderr)
    if not any(row["gain"] > 0 for row in rows):
        print(
            f"no better individual found in {rounds * steps} steps; try another --seed",
            file=sys.stderr,
        )
        print(folder.path)
        return
    best, _, _ = folder.load_champion()
    _, _, experiment = open_run(run)
    folder.save_champion(best, replay_champion(experiment, best, devices)[2])
    folder.update_meta(refined=now())
    terms = ", ".join(f"{name} {value:.3g}" for name, value in champion.terms.items())
    for key, value in zip(keys, (rows[-1][key] for key in keys), strict=True):
        print(f"{key}: {value:.6g}", file=sys.stderr)
    print(f"fitness {before:.4f} -> {champion.fitness:.4f} ({terms})", file=sys.stderr)
    print(folder.path)


def _slopes(done: "Round") -> str:
    lost = done.slopes - done.finite
    return f"{done.slopes} slopes" + (f", {lost} not finite" if lost else "")
