"""The command that makes a page of a run: analyse."""

import io
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from evo_cpg.analysis.chains import chains
from evo_cpg.api.departures import departures
from evo_cpg.api.training import now, require_configured
from evo_cpg.cli.errors import UsageError, require_free
from evo_cpg.cli.pictures import rhythm_of
from evo_cpg.cli.progress import working
from evo_cpg.cli.training import frames_again, open_champion, require_trial
from evo_cpg.cli.version import version
from evo_cpg.config.load import load_config
from evo_cpg.config.schema.experiment import ExperimentConfig
from evo_cpg.training.checkpoint import Champion
from evo_cpg.training.experiment import Experiment
from evo_cpg.training.run_folder import RunFolder, write_whole

if TYPE_CHECKING:
    from PIL import Image

# Of the picture for paper, pixels, and the quality of its JPEG.
_STILL, _QUALITY = (1280, 720), 88
_SUFFIXES = (".html", ".htm")


def analyse_run(
    run: Path, output: Path | None, number: int | None, trial: int, overwrite: bool
) -> None:
    """`evo-cpg analyse`.

    Args:
        run: the run folder.
        output: the page; in the run folder if None.
        number: whose champion, where the folder holds several runs; None for the best.
        trial: in which of its trials, from 0.
        overwrite: replace a page that was asked for by name.

    Raises:
        UsageError: the page cannot be written there, or there is no such trial.
    """
    path = output or run / "analysis.html"
    if output is not None:
        _require_place(output, overwrite)
    experiment, champion, _, folder = open_champion(run, number)
    require_configured(folder)
    require_trial(experiment, folder, trial)
    if output is None and (number is not None or trial):
        which = f"_run{champion.run}" if number is not None else ""
        path = path.with_stem(path.stem + which + (f"_trial{trial}" if trial else ""))
    page = _page(experiment, champion, folder, trial, number)
    write_whole(path, lambda file: file.write(page.encode()))
    print(path)


def _page(
    experiment: Experiment, champion: Champion, folder: RunFolder, trial: int, number: int | None
) -> str:
    config, simulation = load_config(folder.config), experiment.simulation
    with working("replaying the champion: compiling takes some seconds, a trial less") as work:
        from evo_cpg.analysis.gait_numbers import chain_places, gait_numbers

        frames, recording = frames_again(experiment, champion, folder, trial)
        work.doing("measuring the gait")
        numbers = gait_numbers(simulation, experiment.creature, frames, recording)
        work.doing("drawing")
        from evo_cpg.view.film import sample
        from evo_cpg.view.page import document, scene
        from evo_cpg.view.watch_picture import still

        water = simulation.world.water
        motion = document.Motion(
            recording=recording,
            clip=sample(recording, scene.RATE),
            numbers=numbers,
            scene=scene.scene(
                experiment.creature,
                recording,
                simulation.world.ground,
                None if water is None else water.surface,
                water is not None,
            ),
            still=_jpeg(still(experiment, recording, _STILL, experiment.name)),
            history=folder.history(),
            chain_places=chain_places(simulation, experiment.creature, numbers.chain),
        )
        settings, signal = rhythm_of(simulation.controller)
        audit = _audit(folder, champion, number)
        subject = document.Subject(
            name=experiment.name,
            folder=folder.path.resolve().name,
            sentence=_sentence(experiment, config),
            champion={"fitness": champion.fitness, **champion.terms},
            generation=champion.generation,
            generations=int(motion.history["generation"].max()) + 1,
            run=champion.run if experiment.runs > 1 else None,
            trial=trial if experiment.trials > 1 else None,
            seed=config.seed + champion.run,
            chains=[chain.oscillators for chain in chains(simulation.world.tree, settings)],
            signal=signal,
            config=folder.config.read_text(encoding="utf-8"),
            meta=folder.read_meta(),
            audit=audit,
            stale=bool(audit) and not _is_of(audit, champion),
            departures=departures(config),
            program=version().splitlines()[0],
            made=now(),
        )
        return document.document(subject, motion)


def _jpeg(picture: "Image.Image") -> bytes:
    written = io.BytesIO()
    picture.save(written, "JPEG", quality=_QUALITY)
    return written.getvalue()


def _sentence(experiment: Experiment, config: ExperimentConfig) -> str:
    simulation, creature = experiment.simulation, experiment.creature
    where = "in water" if simulation.world.water is not None else "on land"
    if simulation.world.water is not None and simulation.world.footing is not None:
        where = "in water and on the ground"
    bodies = f"{len(creature.bodies)} bodies and {simulation.world.tree.dof_count} joint axes"
    return (
        f"An animal of {bodies} ({float(creature.mass):.3g} kg) {where}, driven by the controller "
        f"{config.controller.type!r} with {simulation.controller.gene_count} genes, that evolved "
        f"for the task {config.task.type!r}."
    )


def _audit(folder: RunFolder, champion: Champion, number: int | None) -> dict[str, Any] | None:
    """What `evo-cpg audit` found, of this run's champion where it looked at that."""
    names = ["audit.json"] if number is None else []
    for name in [*names, f"audit_run{champion.run}.json", "audit.json"]:
        try:
            told = json.loads((folder.path / name).read_text(encoding="utf-8"))
        except (OSError, RecursionError, ValueError):
            continue
        if isinstance(told, dict):
            return told
    return None


def _is_of(audit: dict[str, Any] | None, champion: Champion) -> bool:
    keys = "run", "generation", "fitness"
    return audit is not None and all(audit.get(key) == getattr(champion, key) for key in keys)


def _require_place(output: Path, overwrite: bool) -> None:
    if output.suffix.lower() not in _SUFFIXES:
        raise UsageError(f"--out: {output} is not the name of a page; let it end in .html")
    if not output.parent.is_dir():
        raise UsageError(f"--out: there is no folder {output.parent}; create it first")
    if output.is_dir():
        raise UsageError(f"--out: {output} is a folder; give the name of a file")
    require_free(output, overwrite)
