"""Page of a run, as `evo-cpg analyse` makes it: the champion in 3D and its gait in numbers."""

import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from evo_cpg.analysis.chains import joint_rows
from evo_cpg.analysis.gait_numbers import GaitNumbers
from evo_cpg.api.machine import version
from evo_cpg.api.progress import working
from evo_cpg.api.run_start import now
from evo_cpg.api.runs import open_champion, suffix, writing
from evo_cpg.errors import advise
from evo_cpg.files import read_json, write_text
from evo_cpg.io.run import Run
from evo_cpg.io.trust import trusting
from evo_cpg.simulation.recording import Recording
from evo_cpg.system import resolved
from evo_cpg.training.checkpoint import Champion, genes_digest
from evo_cpg.training.run_folder import RunFolder

# Size of the picture for print, pixels, and quality of its JPEG.
_STILL, _QUALITY = (1280, 720), 88


class Analysis(NamedTuple):
    """Files of a page, and the numbers in it.

    Attributes:
        page: path of the HTML file.
        table: path of the JSON file with the numbers.
        numbers: numbers of the champion's motion.
    """

    page: Path
    table: Path
    numbers: GaitNumbers


def analyse(
    run: Path | str,
    trial: int = 0,
    trust: bool = False,
    *,
    number: int | None = None,
    out: Path | str | None = None,
) -> Analysis:
    """Make the page of a run's champion, with the numbers of its gait.

    Earlier files are replaced. If ``config.yaml`` has changed since the champion evolved, the page
    and a warning report the change.

    Args:
        run: a run folder.
        trial: number of the champion's trial, from 0.
        trust: whether to trust the configuration, see `load`.
        number: number of one of several runs side by side, or None for the best.
        out: path of the page, or None for ``analysis.html`` in the run folder. The numbers are
            beside it in a JSON file.

    Raises:
        ConfigError: the configuration of the run is wrong.
        LockedError: another process writes into the folder.
        RunFolderError: there is no run, the run has no champion, or the champion's number of genes
            does not fit its ``config.yaml``.
        UsageError: there is no such trial, run or generation.
    """
    output = None if out is None else Path(out)
    with trusting(trust), writing(Path(run), output):
        opened = open_champion(run, number, trial)
        opened.require_configured()
        if opened.changed:
            advise(f"{opened.folder.path}: {opened.changed}")
        path = output or opened.folder.path / f"analysis{suffix(number, trial)}.html"
        with working("replaying the champion") as work:
            recording, numbers = measure(opened, trial)
            work.doing("drawing")
            write_text(path, page(opened, trial, recording, numbers))
        table, champion = path.with_suffix(".json"), opened.champion
        about = {"run": champion.run, "generation": champion.generation, "trial": trial}
        contents = about | {"made": now()} | numbers.as_dict()
        write_text(table, json.dumps(contents, indent=2, allow_nan=False) + "\n")
    return Analysis(path, table, numbers)


def gait_numbers(run: Path | str, trial: int = 0, trust: bool = False) -> GaitNumbers:
    """Return the numbers of a champion's motion, as in the page of `analyse`.

    Args:
        run: a run folder.
        trial: number of the champion's trial, from 0.
        trust: whether to trust the configuration, see `load`.

    Returns:
        The numbers. ``value("strouhal")`` returns one of them, NaN if it does not exist.
        ``quantities`` has their names, units, definitions and the ranges of animals.

    Raises:
        ConfigError: the configuration of the run is wrong.
        RunFolderError: there is no run, the run has no champion, or the champion's number of genes
            does not fit its ``config.yaml``.
        UsageError: there is no such trial.
    """
    with trusting(trust):
        opened = open_champion(run, trial=trial)
        opened.require_configured()
        with working(f"measuring {run}"):
            return measure(opened, trial)[1]


def measure(opened: Run, trial: int) -> tuple[Recording, GaitNumbers]:
    """Replay a champion's trial and return its motion with the numbers."""
    from evo_cpg.analysis import gait_numbers as measuring

    experiment = opened.on_course(trial).experiment
    # Velocities are needed for the power into the water only.
    full = experiment.simulation.world.water is not None
    (replay,) = opened.replay([opened.champion], trial, full)
    numbers = measuring.gait_numbers(
        experiment.simulation, experiment.creature, replay.frames, replay.recording
    )
    return replay.recording, numbers


def page(opened: Run, trial: int, recording: Recording, numbers: GaitNumbers) -> str:
    """Return the HTML text of a champion's page."""
    from evo_cpg.analysis.gait_numbers import chain_places
    from evo_cpg.view.film import Film, picture
    from evo_cpg.view.run_page.document import document
    from evo_cpg.view.run_page.subject import PageSubject, RecordedMotion
    from evo_cpg.view.run_page.viewer_data import RATE, viewer_data
    from evo_cpg.view.scene import panel_of, sample

    folder, config, champion = opened.folder, opened.config, opened.champion
    experiment, meta = opened.on_course(trial).experiment, folder.read_meta()
    simulation = experiment.simulation
    panel, still = panel_of(experiment, recording, experiment.name), io.BytesIO()
    picture([panel], Film(_STILL)).save(still, "JPEG", quality=_QUALITY)
    motion = RecordedMotion(
        recording=recording,
        clip=sample(recording, RATE),
        numbers=numbers,
        scene=viewer_data(panel),
        still=still.getvalue(),
        history=folder.history(),
        chain_places=chain_places(simulation, experiment.creature, numbers.chain),
        root_index=experiment.creature.root_index,
    )
    audit, stale = _audit(folder, champion)
    # `train` may have measured another champion at half the physics step.
    first, half = meta.get("half_step"), None
    if isinstance(first, Mapping) and first.get("genes_sha256") == genes_digest(champion.genes):
        kept = first.get("measured")
        half = float(kept) if isinstance(kept, (int, float)) else None
    places = (
        ("in water", simulation.world.water is not None),
        ("on the ground", simulation.world.contact_model is not None),
    )
    where = " and ".join(words for words, there in places if there) or "in empty space"
    creature = experiment.creature
    bodies = f"{len(creature.bodies)} bodies and {simulation.world.tree.dof_count} joint axes"
    expected = {}
    if champion.expected is not None:
        expected[f"mean fitness in {champion.lives} new draws of the noise"] = champion.expected
    subject = PageSubject(
        name=experiment.name,
        changed=opened.changed,
        folder=resolved(folder.path).name,
        sentence=(
            f"An animal of {bodies} ({float(creature.mass):.3g} kg) {where}, driven by the "
            f"controller {config.controller.type!r} with {simulation.genome.count} genes, that "
            f"evolved for the task {config.task.type!r}."
        ),
        champion={"fitness": champion.fitness, **expected, **champion.terms},
        generation=champion.generation,
        generations=int(motion.history["generation"].max()) + 1,
        run=champion.run if experiment.runs > 1 else None,
        trial=trial if experiment.trials > 1 else None,
        seed=config.seed + champion.run,
        chains=joint_rows(simulation.world.tree),
        signal=simulation.controller.signal_label,
        config=folder.config.read_text(encoding="utf-8"),
        meta=meta,
        audit=audit,
        stale=stale,
        half_step=half,
        program=version().splitlines()[0],
        made=now(),
    )
    return document(subject, motion)


def _audit(folder: RunFolder, champion: Champion) -> tuple[dict[str, Any] | None, bool]:
    """Return the champion's audit or else any of the run, and whether it is of another champion."""
    audits = []
    for name in (f"audit_run{champion.run}.json", "audit.json"):
        try:
            audits.append(read_json(folder.path / name, dict[str, Any]))
        except (OSError, ValueError):
            continue
    for audit in audits:
        if all(
            audit.get(key) == getattr(champion, key) for key in ("run", "generation", "fitness")
        ):
            return audit, False
    return next(iter(audits), None), bool(audits and audits[0])
