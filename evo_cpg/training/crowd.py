"""All animals of one generation: their genomes made anew, and their motion in one tank.

A run folder keeps the last two populations only. Every earlier one follows from the seed, because
evolution draws the same random numbers again. So any generation of any run can be shown, and no run
has to store its populations.
"""

import dataclasses
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from evo_cpg.simulation.recording import Recorder, Recording, light_of
from evo_cpg.training.checkpoint import history_columns
from evo_cpg.training.devices import population_mesh
from evo_cpg.training.evaluate import compile_trials
from evo_cpg.training.experiment import (
    Evaluated,
    ExperimentParts,
    begin,
    situation_numbers,
    trial_keys,
)
from evo_cpg.training.family import read_family
from evo_cpg.training.run_folder import RunFolder, RunFolderError
from evo_cpg.training.train import Running, evaluate_here

# Most animals in a crowd. More of them hide each other, and take memory.
_MOST = 400
# No animal of metre size gets this far from the origin, m. Diverged ones do.
_ASTRAY = 1e3


class CrowdMotion(NamedTuple):
    """Motion of many animals of one body, which start at the same instant.

    Bodies are in the order of ``creature.bodies``.

    Attributes:
        time: time since the start of the trial, s.
        position: centre of every body of every animal, m.
        rotation: rotations from body to world axes.
        goal: place of the light at the start, m, or NaN without a light.
        light: place of each animal's light, m, or None if it rests.
    """

    time: Float[np.ndarray, " t"]
    position: Float[np.ndarray, "t n b 3"]
    rotation: Float[np.ndarray, "t n b 3 3"]
    goal: Float[np.ndarray, "3"]
    light: Float[np.ndarray, "t n 3"] | None = None

    def advance(self, root: int, heading: str) -> Float[np.ndarray, " n"]:
        """Return how far each animal has come at the end, m: towards the light, if there is one.

        If the light moves, this is the sum of all steps towards its place in each step.

        Args:
            root: number of the root body.
            heading: ``forward`` if only displacement along x counts (see `Task.heading`).
        """
        start, end = self.position[0, :, root], self.position[-1, :, root]
        if self.light is not None:
            place, light = self.position[:, :, root], self.light[:-1]
            before, after = (np.linalg.norm(x - light, axis=-1) for x in (place[:-1], place[1:]))
            return (before - after).sum(0)
        if np.isfinite(self.goal).all():
            away = np.linalg.norm(start.mean(0) - self.goal)
            return away - np.linalg.norm(end - self.goal, axis=-1)
        moved = (end - start)[:, :2]
        return moved[:, 0] if heading == "forward" else np.linalg.norm(moved, axis=-1)

    @property
    def count(self) -> int:
        """Number of animals."""
        return self.position.shape[1]

    def of(self, animals: Int[np.ndarray, " n"]) -> "CrowdMotion":
        """Return the motion of some of the animals."""
        light = None if self.light is None else self.light[:, animals]
        position, rotation = self.position[:, animals], self.rotation[:, animals]
        return self._replace(position=position, rotation=rotation, light=light)

    def recording(self, animal: int, root: int) -> Recording:
        """Return the motion of one animal, without joints and commands."""
        position, none = self.position[:, animal].astype(float), np.zeros((len(self.time), 0))
        path, light = position[:, root], np.tile(self.goal, (len(position), 1))
        if self.light is not None:
            light = self.light[:, animal]
        away = path - light if np.isfinite(light).all() else (path - path[0])[:, :2]
        return Recording(
            self.time,
            position,
            self.rotation[:, animal].astype(float),
            none,
            none,
            none,
            none,
            np.linalg.norm(away, axis=-1),
            light,
            (),
        )


def populations_at(
    experiment: ExperimentParts, folder: RunFolder, generations: Sequence[int]
) -> list[Float[np.ndarray, "g all"]]:
    """Return the populations of some generations of all runs, made anew from the seed.

    The generations ascend. Generation 0 is only drawn. The evolution is repeated up to the last of
    the others, so this takes as long as that part of the training. The newest two generations are
    in the folder.

    Raises:
        RunFolderError: the repeated evolution has other results than the folder has.
    """
    if [*generations] == [0] and folder.load_start() is None:
        return [np.asarray(jax.jit(lambda: begin(experiment)[0])())]
    return [
        np.asarray(again.checkpoint.genes)
        for again, _ in _repeated(experiment, folder, generations)
    ]


def evaluated_at(
    experiment: ExperimentParts, folder: RunFolder, generation: int
) -> tuple[Float[np.ndarray, "g all"], Float[np.ndarray, "runs n"]]:
    """Return the population of a generation of all runs, and the fitness of its individuals.

    The fitness is -inf for individuals that diverge or break a rule. A family tree has all results.

    Raises:
        RunFolderError: the repeated evolution has other results than the folder has.
    """
    plans, kept = experiment.simulation.plans, read_family(folder.path)
    if plans and generation < len(kept):
        genome = kept[generation]["genome"]
        genes = plans.layout.from_bytes(genome.reshape(-1, genome.shape[-1]).T)
        return np.asarray(genes, np.float32), kept[generation]["fitness"]
    ((again, evaluate),) = _repeated(experiment, folder, [generation])
    (found,) = evaluate([again])
    return np.asarray(again.checkpoint.genes), np.asarray(found.worth.fitness)


def _repeated(
    experiment: ExperimentParts, folder: RunFolder, generations: Sequence[int]
) -> Iterator[tuple[Running, Callable[[Sequence[Running]], list[Evaluated]]]]:
    """Yield the repeated evolution at some generations, and the function that evaluates it.

    It begins at a checkpoint of the run if one is early enough.
    """
    with tempfile.TemporaryDirectory(prefix="evo_cpg_crowd_") as scratch:
        copy = RunFolder(Path(scratch) / "run")
        copy.create(folder.config.read_text(), {}, folder.load_start())
        known = folder.load(generations[0])
        if known is not None:
            copy.save(known)
        mesh = population_mesh()
        running, evaluate = Running(experiment, copy, mesh), evaluate_here(experiment, mesh)
        for generation in generations:
            while running.checkpoint.generation < generation:
                began = time.perf_counter()
                (evaluated,) = evaluate([running])
                running.tell(evaluated, began)
            _require_equal(running, folder)
            yield running, evaluate


def _require_equal(running: Running, folder: RunFolder) -> None:
    """Check the fitness of a repeated evolution.

    Raises:
        RunFolderError: the folder has other results.
    """
    if not running.checkpoint.history:
        return
    best, before = history_columns(running.checkpoint.history)["best"], folder.history()["best"]
    if not np.allclose(best, before[: len(best)], rtol=1e-3, atol=1e-6, equal_nan=True):
        raise RunFolderError(
            f"{folder.path}: the first generations cannot be made anew. The configuration, the "
            "machine or the version has changed since the evolution"
        )


def compile_motions(
    experiment: ExperimentParts, seconds: float, rate: float
) -> Callable[..., tuple[Float[np.ndarray, " t"], dict[str, np.ndarray]]]:
    """Return a function that records individuals of one generation, with one program.

    Args:
        experiment: experiment in which the individuals evolved.
        seconds: length of the motion from the start of the trial, s, at most the trial's.
        rate: instants per second, rounded to a divisor of the control rate.

    Returns:
        A function of genomes, the number of the generation, the number of the run, the places of
        the individuals in its population, and the number of the trial. It compiles at its first
        call. It returns instants (s), and the arrays ``position`` and ``rotation`` of a `Recorder`.
        Those of plans have the layout of the common program.
    """
    simulation = experiment.simulation
    steps = min(max(round(seconds * simulation.control_rate), 1), simulation.steps)
    every = max(round(simulation.control_rate / rate), 1)
    short = dataclasses.replace(simulation, steps=steps)
    names = ("position", "rotation", *["light"] * simulation.task.moves_light)
    recorder = Recorder(count=None, names=names, every=every)
    live = compile_trials(short, population_mesh(), observers=recorder)
    several = situation_numbers(experiment) is not None

    def of(
        genes: Float[np.ndarray, "g n"],
        generation: int,
        run: int,
        individuals: Int[np.ndarray, " n"],
        trial: int,
    ) -> tuple[Float[np.ndarray, " t"], dict[str, np.ndarray]]:
        runs, trials = (np.full(len(individuals), number) for number in (run, trial))
        keys = trial_keys(experiment, generation, runs, individuals, trials)
        own = np.asarray(genes, np.float32)
        found = live(own, jax.device_get(keys), trials if several else None)
        return np.arange(len(found["position"])) * every / simulation.control_rate, found

    return of


def compile_crowd_motion(
    experiment: ExperimentParts, seconds: float, rate: float, run: int = 0, trial: int = 0
) -> Callable[[Float[np.ndarray, "g n"], int], CrowdMotion]:
    """Return a function that computes the motion of populations, with one program.

    Args:
        experiment: experiment in which the populations evolved.
        seconds: length of the motion from the start of the trial, s, at most the trial's.
        rate: instants per second, rounded to a divisor of the control rate.
        run: number of the run.
        trial: number of the trial.

    Returns:
        A function of the genomes of the run's population, and the number of the generation whose
        courses and noise they get. It compiles at its first call. Animals that diverge are left
        out.
    """
    simulation, record = experiment.simulation, compile_motions(experiment, seconds, rate)
    individuals = np.arange(min(experiment.strategy.population, _MOST))
    several = situation_numbers(experiment) is not None
    names = simulation.world.tree.names
    order = [names.index(body.name) for body in experiment.creature.bodies]

    def of(genes: Float[np.ndarray, "g n"], generation: int) -> CrowdMotion:
        own = np.asarray(genes)[:, : len(individuals)]
        instants, found = record(own, generation, run, individuals, trial)
        position = np.moveaxis(found["position"], (3, 2), (1, 2))[:, :, order]
        rotation = np.moveaxis(found["rotation"], (4, 3), (1, 2))[:, :, order]
        sane = (np.abs(position) < _ASTRAY).all((0, 2, 3)) & np.isfinite(rotation).all((0, 2, 3, 4))
        # All animals of a generation have equal courses, but reach their lights at other times.
        first = {name: values[..., 0] for name, values in found.items()}
        goal = light_of(simulation, first, trial if several else 0)[0]
        light = np.moveaxis(found["light"], 2, 1)[:, sane] if "light" in found else None
        return CrowdMotion(instants, position[:, sane], rotation[:, sane], goal, light)

    return of
