"""Replays of a run's individuals, with the run's own configuration and on one core."""

import functools
from collections.abc import Callable, Sequence
from typing import Literal

from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import load_config
from evo_cpg.io.run import class_folders
from evo_cpg.simulation.recording import Recording
from evo_cpg.training.checkpoint import Champion, Checkpoint
from evo_cpg.training.devices import use_cores
from evo_cpg.training.evaluate import Replay, compile_population_replay, compile_replay
from evo_cpg.training.experiment import ExperimentParts
from evo_cpg.training.run_folder import RunFolder


class Replays:
    """The built experiment of a run, and programs that compile at their first use.

    Args:
        folder: folder of the run.
        build: `build_experiment`, or a variant that shows its progress.

    Attributes:
        experiment: the experiment.
    """

    def __init__(self, folder: RunFolder, build: Callable[..., ExperimentParts] = build_experiment):
        use_cores(1)
        config = load_config(folder.config)
        self.experiment = build(config, folder.config, class_folders(folder))
        self._devices = folder.read_meta().get("devices", 1)

    def prepare(self, program: Literal["champion", "population"]) -> bool:
        """Compile a program. Return whether it was not compiled before."""
        name = f"_{program}"
        new = name not in self.__dict__
        getattr(self, name)
        return new

    def champion(self, champion: Champion) -> Recording:
        """Return the motion of a champion in its first trial."""
        return self._champion(champion).recording

    def population(self, checkpoint: Checkpoint, run: int, places: Sequence[int]) -> list[Replay]:
        """Run individuals of the next generation (see `compile_population_replay`)."""
        return self._population(checkpoint, run, places)

    @functools.cached_property
    def _champion(self) -> Callable[[Champion], Replay]:
        # The trainer compiles the same program, and keeps it on disk.
        return compile_replay(self.experiment, self._devices)

    @functools.cached_property
    def _population(self) -> Callable[[Checkpoint, int, Sequence[int]], list[Replay]]:
        return compile_population_replay(self.experiment)
