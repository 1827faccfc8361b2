"""Replays for a live page: the newest champion, and the population around it.

They run with the run's own configuration and on one core.
"""

import contextlib
import functools
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import numpy as np

from evo_cpg.errors import UserError
from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import load_config
from evo_cpg.io.run import Run, class_folders
from evo_cpg.native.machine_constants import LANES
from evo_cpg.simulation.recording import Recording
from evo_cpg.training.checkpoint import Champion, Checkpoint
from evo_cpg.training.devices import use_cores
from evo_cpg.training.evaluate import Replay, compile_population_replay, compile_replay
from evo_cpg.training.experiment import ExperimentParts
from evo_cpg.training.run_folder import RunFolder
from evo_cpg.view.run_page.html import number
from evo_cpg.view.run_page.viewer_data import motion_data, viewer_data
from evo_cpg.view.scene import panel_of

# Least time between two champions, and between two parts of a wall, s.
_SELDOM = 5.0
# Largest number of individuals on the wall, and length, s, and frames per second of their motion.
_TILES, _SECONDS, _RATE = 48, 12.0, 12.0
# Largest fraction of the time that one kind of work takes.
_LARGEST_FRACTION = 0.2

Answer = dict[str, Any]


class Numbered(NamedTuple):
    """Content with a number that grows when other content replaces it.

    Attributes:
        number: the number, 0 before there is content.
        content: the content, as JSON.
    """

    number: int = 0
    content: Mapping[str, Any] = MappingProxyType({})

    def since(self, known: int) -> Answer | None:
        """Return the content with its number, or None if it has the known number."""
        return None if self.number in (0, known) else {**self.content, "number": self.number}


class Pace:
    """Limit on the time that repeated work takes.

    Args:
        seldom: least time between two starts, s.
    """

    def __init__(self, seldom: float):
        self._seldom, self._next = seldom, 0.0

    @property
    def due(self) -> bool:
        """Whether the work may start."""
        return time.monotonic() >= self._next

    @contextlib.contextmanager
    def working(self) -> Iterator[None]:
        """Measure the work of the ``with`` block."""
        began = time.monotonic()
        try:
            yield
        finally:
            took = time.monotonic() - began
            self._next = began + max(self._seldom, took / _LARGEST_FRACTION)


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
        self._run = Run(folder, config, self.experiment)
        self._devices = folder.read_meta().get("devices", 1)

    def of_body(self, champion: Champion) -> ExperimentParts:
        """Return the experiment of a champion's own body."""
        return self._run.of_body(champion).experiment

    def prepare(self, program: Literal["champion", "population"]) -> bool:
        """Compile a program. Return whether it was not compiled before."""
        new = program not in self.__dict__
        getattr(self, program)
        return new

    @functools.cached_property
    def champion(self) -> Callable[[Champion], Replay]:
        """Program that runs a champion in its first trial."""
        # The trainer compiles the same program, and keeps it on disk.
        return compile_replay(self.experiment, self._devices)

    @functools.cached_property
    def population(self) -> Callable[[Checkpoint, int, Sequence[int]], list[Replay]]:
        """Program that runs individuals of the next generation."""
        return compile_population_replay(self.experiment)


class _Rest(NamedTuple):
    """Individuals that are not on the wall yet."""

    checkpoint: Checkpoint
    run: int
    places: list[int]


class Replaying:
    """The newest champion and the wall of the population, a piece of work at a time.

    Args:
        folder: folder of the run.

    Attributes:
        motion: the champion's motion.
        wall: motions of individuals of the population.
    """

    def __init__(self, folder: RunFolder):
        self._folder = folder
        self.motion, self.wall = Numbered(), Numbered()
        self._replays: Replays | None = None
        self._champions, self._walls = Pace(_SELDOM), Pace(_SELDOM)
        self._forget()

    def work(self, checkpoint: Checkpoint, finished: bool) -> None:
        """Do what is due: replay the champion, or the next individuals of the wall."""
        champion = checkpoint.champion
        if champion is None:
            return
        which = champion.run, champion.generation, champion.index, champion.worth
        if which == self._failed:
            return
        generation = champion.run, checkpoint.generation
        new = which != self._shown and (finished or self._champions.due)
        more = self._rest is not None or generation != self._filled
        if not (new or (more and (finished or self._walls.due))):
            return
        try:
            replays = self._replays_now()
            if new:
                kept = self._kept(champion)
                if kept is None and replays.prepare("champion"):
                    # By now there may be a newer champion.
                    return
                self._shown = which
                with self._champions.working():
                    recording = kept or replays.champion(champion).recording
                    words = (
                        f"Champion of generation {champion.generation} (the first is 0), "
                        f"fitness {number(champion.worth)}"
                    )
                    made = replays.of_body(champion)
                    scene = viewer_data(panel_of(made, recording, made.name))
                    shown = {"words": words, "scene": scene}
                    self.motion = Numbered(self.motion.number + 1, shown)
                return
            if replays.prepare("population"):
                return
            if self._rest is None:
                self._filled = generation
                size = replays.experiment.strategy.population
                places = np.linspace(0, size - 1, min(size, _TILES)).round().astype(int)
                some = "all" if len(places) == size else f"{len(places)} of {size}"
                words = f"Generation {checkpoint.generation}: {some} individuals, and their fitness"
                empty = {"words": words, "count": len(places), "tiles": []}
                self.wall = Numbered(self.wall.number + 1, empty)
                self._rest = _Rest(checkpoint, champion.run, places.tolist())
            with self._walls.working():
                self._rest = self._fill(replays, self._rest)
        except (UserError, OSError, ValueError) as error:
            self._forget()
            # Nothing is tried again before there is another champion.
            self._failed = which
            if self._folder.config.is_file():
                words = f"The animals cannot be replayed: {error}"
                self.motion = Numbered(self.motion.number + 1, {"words": words, "scene": None})

    def _forget(self) -> None:
        self._settings: Answer | None = None
        self._shown: tuple | None = None
        self._failed: tuple | None = None
        self._filled: tuple | None = None
        self._rest: _Rest | None = None

    def _replays_now(self) -> Replays:
        """Return the replays, built again if the configuration has changed."""
        config = load_config(self._folder.config)
        settings = config.model_dump(mode="json")
        # `resume` changes only this.
        settings["evolution"].pop("generations")
        if self._replays is None or settings != self._settings:
            self._forget()
            self._replays = Replays(self._folder)
            Run(self._folder, config, self._replays.experiment).require_configured()
            self._settings = settings
        return self._replays

    def _kept(self, champion: Champion) -> Recording | None:
        """Return the motion in champion.npz, which the trainer records at the end."""
        with contextlib.suppress(UserError):
            found, recording, digests = self._folder.load_champion()
            same = digests["config_sha256"] == self._folder.config_digest()
            if same and np.array_equal(found.genes, champion.genes):
                return recording
        return None

    def _fill(self, replays: Replays, rest: _Rest) -> _Rest | None:
        """Add individuals to the wall, and return the rest."""
        own = rest.places[:LANES]
        found = replays.population(rest.checkpoint, rest.run, own)
        tiles = []
        for place, replay in zip(own, found, strict=True):
            recording, motion = replay.recording, None
            # An individual that diverged has no motion.
            if np.isfinite(recording.position).all() and np.isfinite(recording.rotation).all():
                motion = motion_data(recording, _RATE, _SECONDS)
            value, words = replay.fitness, number(replay.fitness)
            tiles.append({"place": place, "value": value, "fitness": words, "motion": motion})
        shown = self.wall.content
        self.wall = self.wall._replace(content={**shown, "tiles": shown["tiles"] + tiles})
        return rest._replace(places=rest.places[LANES:]) if rest.places[LANES:] else None
