"""Questions to an animal without evolution, from Python."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from evo_cpg.analysis.laboratory.ask import Answer, Subject, ask
from evo_cpg.analysis.laboratory.settings import LabError
from evo_cpg.api.progress import working
from evo_cpg.io.load import load_config
from evo_cpg.io.run import class_folders, open_run
from evo_cpg.io.shipped import find_config
from evo_cpg.io.trust import trusting
from evo_cpg.training.devices import use_cores
from evo_cpg.training.run_folder import RunFolder


def lab(
    animal: Path | str,
    knobs: Mapping[str, Sequence[Any]],
    seconds: float | None = None,
    *,
    number: int | None = None,
    trust: bool = False,
) -> Answer:
    """Simulate an animal under all combinations of settings, in one program.

    Args:
        animal: YAML file, name of a shipped configuration, or run folder with a champion.
        knobs: values of each knob (docs/lab.md), or of keys of the configuration.
        seconds: duration of each trial, s, of which the second half is measured. None is the
            duration in the configuration.
        number: number of one of several runs in the folder, or None for the best.
        trust: whether you trust the configuration, see `evo_cpg.load`.

    Raises:
        LabError: a knob or a value does not fit the animal.
        ConfigError: the configuration is wrong.
    """
    with trusting(trust), working("answering"):
        return ask(subject_of(find_config(animal, folders=True), number), knobs, seconds)


def subject_of(animal: Path, number: int | None = None) -> Subject:
    """Return the animal of a question.

    Args:
        animal: file of a configuration, or run folder.
        number: number of one of several runs in the folder, or None for the best.

    Raises:
        LabError: there is no such run, or its champion diverged.
    """
    use_cores()
    if not animal.is_dir():
        if number is not None:
            raise LabError(f"run {number}: {animal} is a configuration, not a run folder")
        return Subject(load_config(animal), animal)
    opened = open_run(animal)
    opened.require_configured()
    genes = opened.with_champion().champion.genes
    if number is not None:
        checkpoint = opened.folder.load()
        champions = checkpoint.champions if checkpoint else ()
        champion = champions[number] if number < len(champions) else None
        if champion is None:
            raise LabError(f"{animal}: run {number} has no champion ({len(champions)} runs)")
        genes = opened.with_champion(champion).champion.genes
    folders = class_folders(RunFolder(animal))
    return Subject(opened.config, opened.folder.config, folders, genes)
