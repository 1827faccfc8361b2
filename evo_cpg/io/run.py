"""Run folder with its built experiment, and with one of its champions or elites."""

import dataclasses
import functools
import hashlib
import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from evo_cpg.evolution.strategy import Archive, Axis
from evo_cpg.io.body_genes import config_of
from evo_cpg.io.build import build_experiment
from evo_cpg.io.courses import config_of_course
from evo_cpg.io.load import load_config
from evo_cpg.io.plans import EvolvedPlans
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.io.schema.section import CustomConfig
from evo_cpg.io.trust import own_parts
from evo_cpg.simulation.recording import Recording
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.training.checkpoint import Champion, Checkpoint, StrategyError, state_from
from evo_cpg.training.evaluate import Replay, compile_replay
from evo_cpg.training.experiment import ExperimentParts, begin, champion_keys
from evo_cpg.training.run_folder import RunFolder, RunFolderError

_SOURCE = "the source of "
# First words of changes that leave every individual's fitness as it is. `changes_of_fitness` lists
# the exceptions.
_HARMLESS = (
    *("name", "seed", "runs", "creature.name", "evolution.", "audit.", "measures", "engine"),
    *("instruction_set", _SOURCE),
)


def own_body(
    config: ExperimentConfig,
    simulation: Simulation,
    genes: Float[np.ndarray, " g"],
    source: Path | str,
) -> tuple[ExperimentConfig, Float[np.ndarray, " c"]]:
    """Return the configuration of an individual's own body, and the genes of its controller.

    Raises:
        ConfigError: the body is not allowed.
    """
    if isinstance(simulation.plans, EvolvedPlans):
        return simulation.plans.alone(genes)
    own = config_of(config, simulation, genes, source)
    return own, genes[: simulation.controller.gene_count]


@dataclasses.dataclass(frozen=True)
class Run:
    """Run folder with its configuration and experiment, and perhaps one of its individuals.

    Attributes:
        folder: run folder.
        config: configuration in the folder.
        experiment: experiment built from the configuration.
        individual: champion or elite, from `with_champion`.
        recording: motion of the individual in its first trial, or None if not kept or of another
            configuration.
    """

    folder: RunFolder
    config: ExperimentConfig
    experiment: ExperimentParts
    individual: Champion | None = dataclasses.field(default=None, kw_only=True)
    recording: Recording | None = dataclasses.field(default=None, kw_only=True)

    @property
    def champion(self) -> Champion:
        """The individual, of a run `with_champion`."""
        assert self.individual is not None
        return self.individual

    @property
    def devices(self) -> int:
        """Number of devices that shared the population."""
        return self.folder.read_meta().get("devices", 1)

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

    def with_champion(self, champion: Champion | None = None) -> "Run":
        """Return the run with one of its individuals, by default the champion in the folder.

        Raises:
            RunFolderError: there is no champion, or it does not fit the configuration.
        """
        recording = None
        if champion is None:
            champion, recording, digests = self.folder.load_champion()
            if digests["config_sha256"] != self.folder.config_digest():
                recording = None
        wrong = self.experiment.simulation.genome.misfit(champion.genes)
        if wrong:
            raise RunFolderError(f"{self.folder.config} was changed after training: {wrong}")
        return Run(
            self.folder, self.config, self.experiment, individual=champion, recording=recording
        )

    @functools.cached_property
    def own(self) -> "Run":
        """The run of the individual's own body, which does not evolve any more.

        Its configuration has the body's numbers, and its individual has the controller's genes
        alone. Replays still come from the run itself: in their program the numbers are no
        constants, so it rounds as in training.
        """
        return self if self.individual is None else self.of_body(self.individual)

    def of_body(self, champion: Champion) -> "Run":
        """Return `own` of one of the run's individuals.

        Raises:
            ConfigError: the body is not allowed.
        """
        simulation, source = self.experiment.simulation, self.folder.config
        if not simulation.has_own_bodies:
            return self
        config, genes = own_body(self.config, simulation, champion.genes, source)
        experiment = build_experiment(config, source, class_folders(self.folder))
        one, recording = champion._replace(genes=genes), self.recording
        return Run(self.folder, config, experiment, individual=one, recording=recording)

    def on_course(self, trial: int = 0) -> "Run":
        """Return `own` with the numbers that one of the individual's trials had drawn.

        Pictures show this world, and an audit takes place in it.
        """
        own, simulation = self.own, self.experiment.simulation
        if simulation.draws is None:
            return own
        keys = champion_keys(self.experiment, self.champion)
        assert keys is not None
        source = self.folder.config
        config = config_of_course(own.config, simulation, np.asarray(keys)[:, trial], source)
        experiment = build_experiment(config, source, class_folders(self.folder))
        return dataclasses.replace(own, config=config, experiment=experiment)

    def replay(self, champions: Sequence[Champion], trial: int, full: bool = False) -> list[Replay]:
        """Replay individuals of the run in turn, with one program. Trials count from 0.

        ``full`` records all quantities (see `evo_cpg.simulation.recording.Recorder`).
        """
        return list(map(compile_replay(self.experiment, self.devices, trial, full), champions))


def open_run(run: Path | str, build: Callable[..., ExperimentParts] = build_experiment) -> Run:
    """Read a run folder and build its experiment, by `build_experiment` or a variant of it.

    Raises:
        RunFolderError: the folder holds no run.
        ConfigError: the run's configuration is wrong.
    """
    folder = RunFolder(run)
    folder.require()
    config = load_config(folder.config)
    return Run(folder, config, build(config, folder.config, class_folders(folder)))


def class_folders(folder: RunFolder) -> list[Path]:
    """Return the folder of a user's classes: the folder of the run's original config file."""
    origin = folder.read_meta().get("config")
    return [Path(origin).parent] if isinstance(origin, str) else []


class GaitMap(NamedTuple):
    """Map of behaviour of one run.

    Attributes:
        axes: axes of the map.
        fitness: fitness of the elites, with an array axis for each map axis. NaN in empty cells.
        archive: the elites, with cells along the last axis.
    """

    axes: tuple[Axis, ...]
    fitness: Float[np.ndarray, "..."]
    archive: Archive


def gait_map(experiment: ExperimentParts, checkpoint: Checkpoint, run: int) -> GaitMap | None:
    """Return the map of a run, or None if its strategy has none.

    Raises:
        StrategyError: the checkpoint comes from another strategy.
    """
    strategy = experiment.strategy
    axes = strategy.map_axes
    if not axes or not checkpoint.state:
        return None
    like = jax.eval_shape(lambda: begin(experiment))[1]
    state = jax.tree.map(lambda x: x[run], state_from(checkpoint.state, like))
    archive = strategy.map_of(state)
    assert archive is not None
    fitness = np.where(np.isfinite(archive.fitness), archive.fitness, np.nan)
    return GaitMap(axes, fitness.reshape([axis.cells for axis in axes]), archive)


def elite(
    experiment: ExperimentParts, checkpoint: Checkpoint, cell: tuple[int, ...], run: int
) -> Champion:
    """Return the individual of a cell, ready to be replayed.

    Args:
        experiment: experiment in which the individual evolved.
        checkpoint: checkpoint of the run.
        cell: index of the cell on each axis of the map, from 0.
        run: number of the run.

    Raises:
        StrategyError: there is no map, no such cell, or the cell is empty.
    """
    found = gait_map(experiment, checkpoint, run)
    if found is None:
        raise StrategyError("there is no map: the search of this run fills no cells")
    axes, shape = found.axes, found.fitness.shape
    if len(cell) != len(shape) or not all(0 <= i < n for i, n in zip(cell, shape, strict=True)):
        allowed = ", ".join(f"{axis.name} 0 to {axis.cells - 1}" for axis in axes)
        raise StrategyError(f"there is no cell {','.join(map(str, cell))}. Allowed: {allowed}")
    number = int(np.ravel_multi_index(cell, shape))
    archive = found.archive
    if not np.isfinite(archive.fitness[number]):
        filled = np.argwhere(np.isfinite(found.fitness))
        near = filled[np.abs(filled - np.array(cell)).sum(1).argmin()] if len(filled) else None
        hint = "" if near is None else f". The nearest filled cell is {','.join(map(str, near))}"
        raise StrategyError(f"cell {','.join(map(str, cell))} is empty{hint}")
    terms = archive.descriptors[:, number]
    return Champion(
        np.ascontiguousarray(archive.genes[:, number]),
        float(archive.fitness[number]),
        int(archive.generation[number]),
        {axis.name: float(value) for axis, value in zip(axes, terms, strict=True)},
        {name: values[run] for name, values in checkpoint.scales.items()},
        run,
        int(archive.index[number]),
    )


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
    harmful = [
        "evolution.axes",
        "evolution.body",
        *(_SOURCE + module for module in _code_digests(parts)),
    ]
    harmful += [f"audit.{name}" for name in ("disqualify", *config.audit.disqualify)]
    if not config.silent:
        # The seed determines the noise with which an individual was evaluated.
        harmful.append("seed")
    found = changes(before, fingerprint(config))
    return [each for each in found if each in harmful or not each.startswith(_HARMLESS)]


def changes(before: Any, now: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Return the differences between two fingerprints: configuration keys, then modules.

    Kinds that are missing in the earlier fingerprint are ignored.
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
