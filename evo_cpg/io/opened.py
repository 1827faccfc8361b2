"""Run folder with its built experiment and one of its champions, and the digests of a run."""

import dataclasses
import functools
import hashlib
import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from jaxtyping import Array

from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import load_config
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.io.schema.section import CustomConfig
from evo_cpg.io.trust import own_parts
from evo_cpg.simulation.recording import Recording, as_recording
from evo_cpg.training.checkpoint import Champion
from evo_cpg.training.experiment import ExperimentParts
from evo_cpg.training.run_folder import RunFolder, RunFolderError

_SOURCE = "the source of "
# First words of changes that leave every individual's fitness as it is. `changes_of_fitness` lists
# the exceptions.
_HARMLESS = (
    *("name", "seed", "runs", "creature.name", "evolution.", "audit.", "measures", "engine"),
    *("instruction_set", _SOURCE),
)


class Replay(NamedTuple):
    """Results of a replayed trial.

    Attributes:
        fitness: mean fitness over all trials of the individual.
        frames: frames of one individual, see `evo_cpg.simulation.recording.Recorder`.
        recording: motion in the trial.
    """

    fitness: float
    frames: dict[str, Array]
    recording: Recording


@dataclasses.dataclass(frozen=True)
class Opened:
    """Run folder with its configuration and experiment.

    Attributes:
        folder: run folder.
        config: configuration in the folder.
        experiment: experiment built from the configuration.
    """

    folder: RunFolder
    config: ExperimentConfig
    experiment: ExperimentParts

    @property
    def devices(self) -> int:
        """Number of devices that shared the population."""
        return self.folder.read_meta().get("devices", 1)

    @property
    def class_folders(self) -> list[Path]:
        """Folders of a user's own classes."""
        return class_folders(self.folder)

    @functools.cached_property
    def changed(self) -> str | None:
        """Warning that ``config.yaml`` has changed since the champion evolved, or None.

        Raises:
            RunFolderError: there is no champion.
        """
        _, _, digests = self.folder.load_champion()
        if digests["config_sha256"] == self.folder.config_digest():
            return None
        return "config.yaml has changed since the champion evolved"

    def require_configured(self) -> None:
        """Check that the configuration describes the whole run.

        Raises:
            RunFolderError: the run began in Python with a part that only that program has.
        """
        replaced = self.folder.read_meta().get("replaced")
        if replaced:
            raise RunFolderError(
                f"{self.folder.path} began in Python with a {' and '.join(replaced)} or fitness "
                "that its config.yaml does not describe. Commands can film and plot it, but cannot "
                "evaluate its champion or continue it. In Python, `Experiment.evaluate` evaluates "
                "genomes, and `evo.train(..., start=...)` begins a new run with them"
            )

    def load_champion(self) -> "OpenedChampion":
        """Return the run with its champion.

        Raises:
            RunFolderError: there is no champion, or it does not fit the configuration.
        """
        champion, recording, digests = self.folder.load_champion()
        same = digests["config_sha256"] == self.folder.config_digest()
        return self.with_champion(champion, recording if same else None)

    def with_champion(
        self, champion: Champion, recording: Recording | None = None
    ) -> "OpenedChampion":
        """Return the run with one of its individuals.

        Raises:
            RunFolderError: the individual does not fit the configuration.
        """
        wrong = self.experiment.simulation.genome.misfit(champion.genes)
        if wrong:
            raise RunFolderError(f"{self.folder.config} was changed after training: {wrong}")
        return OpenedChampion(self.folder, self.config, self.experiment, champion, recording)

    def replay(self, champions: Sequence[Champion], trial: int, full: bool = False) -> list[Replay]:
        """Replay individuals of the run in turn, with one program.

        Args:
            champions: the individuals.
            trial: number of the recorded trial, from 0.
            full: whether to record all quantities, see `evo_cpg.simulation.recording.Recorder`.
        """
        # This import computes nothing, but takes a second, because it imports JAX.
        from evo_cpg.training.replay import compile_frames

        live = compile_frames(self.experiment, self.devices, trial, full)
        names = [body.name for body in self.experiment.creature.bodies]
        found = []
        for champion in champions:
            fitness, _, frames = live(champion)
            recording = as_recording(self.experiment.simulation, frames, names, trial=trial)
            found.append(Replay(fitness, frames, recording))
        return found


@dataclasses.dataclass(frozen=True)
class OpenedChampion(Opened):
    """Run with one of its champions or elites.

    Attributes:
        champion: the individual.
        recording: motion in its first trial, or None if not kept or of another configuration.
    """

    champion: Champion
    recording: Recording | None


def open_run(run: Path | str, build: Callable[..., ExperimentParts] = build_experiment) -> Opened:
    """Read a run folder and build its experiment.

    Args:
        run: the folder.
        build: `build_experiment`, or a variant that shows its progress.

    Raises:
        RunFolderError: the folder holds no run.
        ConfigError: the run's configuration is wrong.
    """
    folder = RunFolder(run)
    folder.require()
    config = load_config(folder.config)
    return Opened(folder, config, build(config, folder.config, class_folders(folder)))


def class_folders(folder: RunFolder) -> list[Path]:
    """Return the folder of a user's classes: the folder of the run's original config file."""
    origin = folder.read_meta().get("config")
    return [Path(origin).parent] if isinstance(origin, str) else []


def fingerprint(config: ExperimentConfig) -> dict[str, dict[str, str]]:
    """Return SHA-256 digests of a configuration and of the user's own code, after its import.

    Returns:
        ``config``, by keys of one or two parts (``seed``, ``evolution.population``), and ``code``,
        by module.
    """
    parts = {}
    for name, section in config.model_dump(mode="json").items():
        for key, value in (section if isinstance(section, dict) else {"": section}).items():
            digest = hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()
            parts[f"{name}.{key}".rstrip(".")] = digest
    return {"config": parts, "code": _code_digests(own_parts(config).values())}


def changes_of_fitness(before: Any, config: ExperimentConfig) -> list[str]:
    """Return the changes that may change fitness, or an elite's place on its map."""
    parts = [part for key, part in own_parts(config).items() if key != ("evolution",)]
    harmful = ["evolution.axes", *(_SOURCE + module for module in _code_digests(parts))]
    harmful += [f"audit.{name}" for name in ("disqualify", *config.audit.disqualify)]
    if not config.noise.silent:
        # The seed determines the noise with which an individual was evaluated.
        harmful.append("seed")
    found = changes(before, fingerprint(config))
    return [each for each in found if each in harmful or not each.startswith(_HARMLESS)]


def changes(before: Any, now: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Return the differences between two fingerprints: configuration keys, then modules.

    Args:
        before: earlier fingerprint, in which missing kinds are ignored.
        now: current fingerprint.
    """
    found = []
    for kind, prefix in (("config", ""), ("code", _SOURCE)):
        old = before.get(kind) if isinstance(before, dict) else None
        if isinstance(old, dict):
            names = sorted({*old, *now[kind]})
            found += [prefix + name for name in names if old.get(name) != now[kind].get(name)]
    return found


def _code_digests(parts: Iterable[CustomConfig]) -> dict[str, str]:
    """Return SHA-256 digests of the files of the user's own classes, by module."""
    digests = {}
    for part in parts:
        name = part.type.partition(":")[0]
        file = getattr(sys.modules[name], "__file__", None)
        if file and file.endswith(".py") and Path(file).is_file():
            digests[name] = hashlib.sha256(Path(file).read_bytes()).hexdigest()
    return digests
