"""A page of a run, as `evo-cpg analyse` makes it: the champion in 3D, its gait in numbers."""

import io
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from evo_cpg.analysis.chains import joint_rows
from evo_cpg.api.departures import departures
from evo_cpg.api.load import changed_config, load
from evo_cpg.api.progress import working
from evo_cpg.api.record import lives_again
from evo_cpg.api.training import now, require_configured
from evo_cpg.api.version import version
from evo_cpg.config.load import load_config
from evo_cpg.config.schema.experiment import ExperimentConfig
from evo_cpg.files import read_json, write_text
from evo_cpg.system import resolved
from evo_cpg.training.checkpoint import Champion, genes_digest
from evo_cpg.training.experiment import Experiment
from evo_cpg.training.run_folder import RunFolder, RunFolderError

if TYPE_CHECKING:
    from PIL import Image

# Of the picture for paper, pixels, and the quality of its JPEG.
_STILL, _QUALITY = (1280, 720), 88


def analyse(run: Path | str, trial: int = 0, trust: bool = False) -> Path:
    """Make the page of a run's champion, as `evo-cpg analyse` does.

    Args:
        run: a run folder.
        trial: in which of its trials, from 0.
        trust: see `load`.

    Returns:
        The page in the run folder, ``analysis.html``; one that was there is replaced. Where
        ``config.yaml`` is not what the champion evolved in, the page says so, and a warning does.

    Raises:
        ConfigError: the configuration of the run is wrong.
        LockedError: another process writes into the folder.
        RunFolderError: there is no run, or it has no champion, or one with another number of genes
            than its ``config.yaml`` asks for.
        ValueError: there is no such trial.
    """
    folder = RunFolder(run)
    with folder.locked():
        folder.require()
        require_configured(folder)
        experiment = load(run, trust=trust).parts
        champion, _, _ = folder.load_champion()
        wrong = experiment.simulation.genome.misfit(champion.genes)
        if wrong:
            raise RunFolderError(f"{folder.config} was changed after training: {wrong}")
        if not 0 <= trial < experiment.trials:
            raise ValueError(f"trial must be 0 to {experiment.trials - 1}, got {trial}")
        changed = changed_config(folder)
        if changed:
            warnings.warn(f"{folder.path}: {changed}", stacklevel=2)
        path = page_path(folder, trial)
        with working(f"making the page of {folder.path}"):
            text = page(experiment, champion, folder, trial)
        write_text(path, text)
    return path


def page_path(folder: RunFolder, trial: int = 0, number: int | None = None) -> Path:
    """Where a page goes; see `page`."""
    which = "" if number is None else f"_run{number}"
    return folder.path / f"analysis{which}{f'_trial{trial}' if trial else ''}.html"


def page(
    experiment: Experiment,
    champion: Champion,
    folder: RunFolder,
    trial: int = 0,
    number: int | None = None,
    doing: Callable[[str], object] = lambda what: None,
) -> str:
    """The text of a page.

    Args:
        experiment: that the champion evolved in.
        champion: whose page it is.
        folder: of its run.
        trial: which of its trials, from 0.
        number: of several runs the one that was asked for; None where it is the best.
        doing: is told what is being done, once the champion has lived again.
    """
    from evo_cpg.analysis.gait_numbers import chain_places, gait_numbers
    from evo_cpg.view.clip import sample
    from evo_cpg.view.film import picture
    from evo_cpg.view.frames import Film
    from evo_cpg.view.page.document import document
    from evo_cpg.view.page.subject import Motion, Subject
    from evo_cpg.view.page.viewer_data import RATE, viewer_data
    from evo_cpg.view.scene import panel_of

    config, simulation = load_config(folder.config), experiment.simulation
    ((_, frames, recording),) = lives_again(experiment, [champion], folder, trial)
    doing("measuring the gait")
    numbers = gait_numbers(simulation, experiment.creature, frames, recording)
    doing("drawing")
    panel = panel_of(experiment, recording, experiment.name)
    motion = Motion(
        recording=recording,
        clip=sample(recording, RATE),
        numbers=numbers,
        scene=viewer_data(panel),
        still=_jpeg(picture([panel], Film(_STILL))),
        history=folder.history(),
        chain_places=chain_places(simulation, experiment.creature, numbers.chain),
    )
    audit = _audit(folder, champion)
    subject = Subject(
        name=experiment.name,
        changed=changed_config(folder),
        folder=resolved(folder.path).name,
        sentence=_sentence(experiment, config),
        champion={"fitness": champion.fitness, **_expected(champion), **champion.terms},
        generation=champion.generation,
        generations=int(motion.history["generation"].max()) + 1,
        run=champion.run if experiment.runs > 1 else None,
        trial=trial if experiment.trials > 1 else None,
        seed=config.seed + champion.run,
        chains=joint_rows(simulation),
        signal=simulation.controller.signal_label,
        config=folder.config.read_text(encoding="utf-8"),
        meta=folder.read_meta(),
        audit=audit,
        stale=bool(audit) and not _is_of(audit, champion),
        half_step=_kept_at_half_the_step(folder.read_meta(), champion),
        departures=departures(config),
        program=version().splitlines()[0],
        made=now(),
    )
    return document(subject, motion)


def _kept_at_half_the_step(meta: Mapping[str, Any], champion: Champion) -> float | None:
    """What `train` noted of this champion, and not of another one."""
    first = meta.get("half_step")
    if not isinstance(first, Mapping) or first.get("genes_sha256") != genes_digest(champion.genes):
        return None
    kept = first.get("measured")
    return float(kept) if isinstance(kept, (int, float)) else None


def _expected(champion: Champion) -> dict[str, float]:
    """What it came to in fresh draws of chance, if there were any."""
    if champion.expected is None:
        return {}
    return {f"mean fitness in {champion.lives} fresh draws": champion.expected}


def _jpeg(picture: "Image.Image") -> bytes:
    written = io.BytesIO()
    picture.save(written, "JPEG", quality=_QUALITY)
    return written.getvalue()


def _sentence(experiment: Experiment, config: ExperimentConfig) -> str:
    simulation, creature = experiment.simulation, experiment.creature
    surroundings = (
        ("in water", simulation.world.water is not None),
        ("on the ground", simulation.world.footing is not None),
    )
    where = " and ".join(words for words, there in surroundings if there) or "in empty space"
    bodies = f"{len(creature.bodies)} bodies and {simulation.world.tree.dof_count} joint axes"
    return (
        f"An animal of {bodies} ({float(creature.mass):.3g} kg) {where}, driven by the controller "
        f"{config.controller.type!r} with {simulation.genome.count} genes, that evolved "
        f"for the task {config.task.type!r}."
    )


def _audit(folder: RunFolder, champion: Champion) -> dict[str, Any] | None:
    """What `evo-cpg audit` found, of this run's champion where it looked at that."""
    found = []
    for name in (f"audit_run{champion.run}.json", "audit.json"):
        try:
            found.append(read_json(folder.path / name, dict[str, Any]))
        except (OSError, ValueError):
            continue
    return next((told for told in found if _is_of(told, champion)), found[0] if found else None)


def _is_of(audit: dict[str, Any] | None, champion: Champion) -> bool:
    keys = "run", "generation", "fitness"
    return audit is not None and all(audit.get(key) == getattr(champion, key) for key in keys)
