"""Run folder with its built experiment, and with one of its champions or elites."""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from jaxtyping import Array

from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import load_config
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.simulation.recording import Recording, as_recording
from evo_cpg.training.checkpoint import Champion
from evo_cpg.training.experiment import ExperimentParts
from evo_cpg.training.run_folder import RunFolder, RunFolderError


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
