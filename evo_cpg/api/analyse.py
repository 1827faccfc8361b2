"""Page of a run, as `evo-cpg analyse` makes it: the champion in 3D and its gait in numbers."""

import io
import json
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from evo_cpg.analysis.chains import joint_rows
from evo_cpg.analysis.gait_numbers import GaitNumbers
from evo_cpg.api.paper_differences import paper_differences
from evo_cpg.api.progress import working
from evo_cpg.api.training import now
from evo_cpg.api.version import version
from evo_cpg.files import read_json, write_text
from evo_cpg.io.opened import OpenedChampion, open_run
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.io.trust import trusting
from evo_cpg.simulation.recording import Recording
from evo_cpg.system import resolved
from evo_cpg.training.checkpoint import Champion, genes_digest
from evo_cpg.training.devices import use_cores
from evo_cpg.training.experiment import ExperimentParts
from evo_cpg.training.run_folder import RunFolder

if TYPE_CHECKING:
    from PIL import Image

    from evo_cpg.view.run_page.subject import Crowd
    from evo_cpg.view.scene import Panel

# Size of the picture for print, pixels, and quality of its JPEG.
_STILL, _QUALITY = (1280, 720), 88


def analyse(run: Path | str, trial: int = 0, trust: bool = False) -> Path:
    """Make the page of a run's champion, as `evo-cpg analyse` does.

    Args:
        run: a run folder.
        trial: number of the champion's trial, from 0.
        trust: whether to trust the configuration, see `load`.

    Returns:
        The page in the run folder, ``analysis.html``. Its numbers are beside it in
        ``analysis.json``. Earlier files are replaced. If
        ``config.yaml`` has changed since the champion evolved, the page and a warning report
        the change.

    Raises:
        ConfigError: the configuration of the run is wrong.
        LockedError: another process writes into the folder.
        RunFolderError: there is no run, the run has no champion, or the champion's number of genes
            does not fit its ``config.yaml``.
        ValueError: there is no such trial.
    """
    folder = RunFolder(run)
    with trusting(trust), folder.locked():
        use_cores(None)
        with working(f"building {folder.path}"):
            opened = open_run(run).load_champion()
        _require_trial(opened, trial)

        def warn(words: str) -> None:
            warnings.warn(words, stacklevel=4)

        with working(f"making the page of {folder.path}"):
            return write_page(opened, trial, warn=warn).page


class Measured(NamedTuple):
    """Recorded trial of a champion, and the numbers of its motion.

    Attributes:
        recording: motion in the trial.
        numbers: numbers of the motion.
    """

    recording: Recording
    numbers: GaitNumbers


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
        ValueError: there is no such trial.
    """
    with trusting(trust):
        use_cores(None)
        with working(f"measuring {run}"):
            opened = open_run(run).load_champion()
            _require_trial(opened, trial)
            opened.require_configured()
            return measure(opened, trial).numbers


def measure(opened: OpenedChampion, trial: int) -> Measured:
    """Replay a champion's trial and return its motion with the numbers.

    Args:
        opened: the run and the champion.
        trial: number of the champion's trial, from 0.
    """
    from evo_cpg.analysis import gait_numbers as measuring

    experiment = opened.experiment
    # Velocities are needed for the power into the water only.
    full = experiment.simulation.world.water is not None
    ((_, frames, recording),) = opened.replay([opened.champion], trial, full)
    numbers = measuring.gait_numbers(experiment.simulation, experiment.creature, frames, recording)
    return Measured(recording, numbers)


def _require_trial(opened: OpenedChampion, trial: int) -> None:
    trials = opened.experiment.trials
    if not 0 <= trial < trials:
        raise ValueError(f"trial must be 0 to {trials - 1}, got {trial}")


class Written(NamedTuple):
    """Files of a page.

    Attributes:
        page: path of the HTML file.
        numbers: path of the JSON file with the numbers.
        measured: the numbers.
    """

    page: Path
    numbers: Path
    measured: GaitNumbers


def write_page(
    opened: OpenedChampion,
    trial: int = 0,
    number: int | None = None,
    output: Path | None = None,
    doing: Callable[[str], object] = lambda what: None,
    warn: Callable[[str], object] = lambda words: None,
    crowd: "Panel | None" = None,
) -> Written:
    """Write the page of a champion and the JSON file of its numbers.

    Args:
        opened: the run and the champion.
        trial: number of the champion's trial, from 0.
        number: number of the chosen run, or None for the run of the best champion.
        output: path of the page, or None for one in the run folder.
        doing: called with the name of each step after the replay.
        warn: called with a sentence if ``config.yaml`` has changed since the run.
        crowd: a generation that the page also shows, or None.

    Raises:
        RunFolderError: the run began in Python with a part that only that program has.
    """
    opened.require_configured()
    changed = opened.changed
    if changed:
        warn(f"{opened.folder.path}: {changed}")
    which = "" if number is None else f"_run{number}"
    name = f"analysis{which}{f'_trial{trial}' if trial else ''}.html"
    path = output or opened.folder.path / name
    measured = measure(opened, trial)
    write_text(path, page(opened, trial, measured, doing, crowd))
    beside = numbers_path(path)
    champion = opened.champion
    about = {"run": champion.run, "generation": champion.generation, "trial": trial, "made": now()}
    contents = about | measured.numbers.as_dict()
    write_text(beside, json.dumps(contents, indent=2, allow_nan=False) + "\n")
    return Written(path, beside, measured.numbers)


def numbers_path(page: Path) -> Path:
    """Return the path of the JSON file with the numbers of a page."""
    return page.with_suffix(".json")


def page(
    opened: OpenedChampion,
    trial: int,
    measured: Measured,
    doing: Callable[[str], object],
    crowd: "Panel | None" = None,
) -> str:
    """Return the HTML text of a champion's page.

    Args:
        opened: the run and the champion.
        trial: number of the champion's trial, from 0.
        measured: its recorded trial.
        doing: called with the name of each step.
        crowd: a generation that the page also shows, or None.
    """
    from evo_cpg.analysis.gait_numbers import chain_places
    from evo_cpg.view.film import Film, picture
    from evo_cpg.view.run_page.document import document
    from evo_cpg.view.run_page.subject import RecordedMotion, Subject
    from evo_cpg.view.run_page.viewer_data import RATE, viewer_data
    from evo_cpg.view.scene import panel_of, sample

    folder, config, champion = opened.folder, opened.config, opened.champion
    experiment, meta = opened.experiment, folder.read_meta()
    simulation = experiment.simulation
    recording, numbers = measured
    doing("drawing")
    panel = panel_of(experiment, recording, experiment.name)
    motion = RecordedMotion(
        recording=recording,
        clip=sample(recording, RATE),
        numbers=numbers,
        scene=viewer_data(panel),
        still=_jpeg(picture([panel], Film(_STILL))),
        history=folder.history(),
        chain_places=chain_places(simulation, experiment.creature, numbers.chain),
        root_index=experiment.creature.root_index,
        crowd=None if crowd is None else _together(crowd),
    )
    audit = _audit(folder, champion)
    subject = Subject(
        name=experiment.name,
        changed=opened.changed,
        folder=resolved(folder.path).name,
        sentence=_sentence(experiment, config),
        champion={"fitness": champion.fitness, **_expected(champion), **champion.terms},
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
        stale=bool(audit) and not _is_of(audit, champion),
        half_step=_kept_at_half_the_step(meta, champion),
        differences=paper_differences(config),
        program=version().splitlines()[0],
        made=now(),
    )
    return document(subject, motion)


def _together(panel: "Panel") -> "Crowd":
    """Return a generation for the page, with words about animals for which there is no room."""
    from evo_cpg.view.run_page.subject import Crowd
    from evo_cpg.view.run_page.viewer_data import viewer_data

    scene, title = viewer_data(panel), (panel.title or "").capitalize()
    shown = scene["crowd"]["count"]
    left_out = panel.crowd is not None and shown < panel.crowd.count
    return Crowd(f"{title}, {shown + 1} of them shown" if left_out else title, scene)


def _kept_at_half_the_step(meta: Mapping[str, Any], champion: Champion) -> float | None:
    """Return the fraction of the displacement that is kept at half the physics step, or None.

    `train` has measured it. None if it has not, or if it measured another champion.
    """
    first = meta.get("half_step")
    if not isinstance(first, Mapping) or first.get("genes_sha256") != genes_digest(champion.genes):
        return None
    kept = first.get("measured")
    return float(kept) if isinstance(kept, (int, float)) else None


def _expected(champion: Champion) -> dict[str, float]:
    """Return the mean fitness in new draws of the noise, or {} without new draws."""
    if champion.expected is None:
        return {}
    return {f"mean fitness in {champion.lives} new draws of the noise": champion.expected}


def _jpeg(picture: "Image.Image") -> bytes:
    written = io.BytesIO()
    picture.save(written, "JPEG", quality=_QUALITY)
    return written.getvalue()


def _sentence(experiment: ExperimentParts, config: ExperimentConfig) -> str:
    simulation, creature = experiment.simulation, experiment.creature
    places = (
        ("in water", simulation.world.water is not None),
        ("on the ground", simulation.world.contact_model is not None),
    )
    where = " and ".join(words for words, there in places if there) or "in empty space"
    bodies = f"{len(creature.bodies)} bodies and {simulation.world.tree.dof_count} joint axes"
    return (
        f"An animal of {bodies} ({float(creature.mass):.3g} kg) {where}, driven by the controller "
        f"{config.controller.type!r} with {simulation.genome.count} genes, that evolved "
        f"for the task {config.task.type!r}."
    )


def _audit(folder: RunFolder, champion: Champion) -> dict[str, Any] | None:
    """Return the audit of the champion, else any audit of the run, else None."""
    audits = []
    for name in (f"audit_run{champion.run}.json", "audit.json"):
        try:
            audits.append(read_json(folder.path / name, dict[str, Any]))
        except (OSError, ValueError):
            continue
    return next((each for each in audits if _is_of(each, champion)), next(iter(audits), None))


def _is_of(audit: dict[str, Any] | None, champion: Champion) -> bool:
    keys = "run", "generation", "fitness"
    return audit is not None and all(audit.get(key) == getattr(champion, key) for key in keys)
