"""All animals of one generation: their genomes made anew, and their motion in one tank.

A run folder keeps the last two populations only. Every earlier one follows from the seed, because
evolution draws the same random numbers again. So any generation of any run can be shown, and no run
has to store its populations.
"""

import dataclasses
import tempfile
import time
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from evo_cpg.simulation.recording import Recorder, Recording
from evo_cpg.simulation.rollout import rollout
from evo_cpg.training.checkpoint import history_columns
from evo_cpg.training.devices import layout, population_mesh, run_in_blocks, sharded
from evo_cpg.training.experiment import (
    ExperimentParts,
    compile_trials,
    first_population,
    situation_numbers,
    trial_keys,
)
from evo_cpg.training.run_folder import RunFolder, RunFolderError
from evo_cpg.training.running import Running

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
        goal: place of the light in the world, m, or NaN without a light.
    """

    time: Float[np.ndarray, " t"]
    position: Float[np.ndarray, "t n b 3"]
    rotation: Float[np.ndarray, "t n b 3 3"]
    goal: Float[np.ndarray, "3"]

    def leader(self, root: int, heading: str) -> int:
        """Return the animal that is ahead at the end.

        Args:
            root: number of the root body.
            heading: ``forward`` if only displacement along x counts (see `Task.heading`). With a
                light, the nearest animal leads.
        """
        end = self.position[-1, :, root]
        if np.isfinite(self.goal).all():
            return int(np.linalg.norm(end - self.goal, axis=-1).argmin())
        moved = (end - self.position[0, :, root])[:, :2]
        ahead = moved[:, 0] if heading == "forward" else np.linalg.norm(moved, axis=-1)
        return int(ahead.argmax())

    @property
    def count(self) -> int:
        """Number of animals."""
        return self.position.shape[1]

    def of(self, animals: Int[np.ndarray, " n"]) -> "CrowdMotion":
        """Return the motion of some of the animals."""
        return self._replace(position=self.position[:, animals], rotation=self.rotation[:, animals])

    def led(self, root: int, heading: str) -> tuple[Recording, "CrowdMotion"]:
        """Return the motion of the leader, and of the others, see `leader`."""
        leader = self.leader(root, heading)
        return self.recording(leader, root), self.of(np.delete(np.arange(self.count), leader))

    def recording(self, animal: int, root: int) -> Recording:
        """Return the motion of one animal, without joints and commands."""
        position, none = self.position[:, animal].astype(float), np.zeros((len(self.time), 0))
        path, goal = position[:, root], self.goal
        lit = np.isfinite(goal).all()
        away = path - goal if lit else (path - path[0])[:, :2]
        return Recording(
            self.time,
            position,
            self.rotation[:, animal].astype(float),
            none,
            none,
            none,
            none,
            np.linalg.norm(away, axis=-1),
            goal,
            (),
        )


def population_at(
    experiment: ExperimentParts, folder: RunFolder, generation: int
) -> Float[np.ndarray, "g all"]:
    """Return the populations of a generation of all runs, made anew from the seed.

    Generation 0 is only drawn. The evolution is repeated up to a later one, so this takes as long
    as that part of the training. The last populations are read from the folder.

    Args:
        experiment: experiment of the folder.
        folder: run folder.
        generation: number of the generation, from 0, at most the number of finished ones.

    Raises:
        RunFolderError: the repeated evolution has other results than the folder has.
    """
    kept = folder.load()
    if kept is not None and kept.generation == generation:
        return kept.genes
    start = folder.load_start()
    if generation == 0 and start is None:
        return np.asarray(jax.jit(lambda: first_population(experiment))())
    mesh = population_mesh()
    with tempfile.TemporaryDirectory(prefix="evo_cpg_crowd_") as scratch:
        again = RunFolder(scratch)
        if start is not None:
            np.savez(again.start, genes=start)
        running = Running(experiment, again, mesh)
        run_trials = compile_trials(experiment.simulation, mesh)
        while running.checkpoint.generation < generation:
            began = time.perf_counter()
            running.tell(run_trials(*running.trials(), experiment.trials), began)
    found = running.checkpoint
    if found.history:
        best, before = history_columns(found.history)["best"], folder.history()["best"]
        if not np.allclose(best, before[: len(best)], rtol=1e-3, atol=1e-6, equal_nan=True):
            raise RunFolderError(
                f"{folder.path}: the first generations cannot be made anew. The configuration, the "
                "machine or the version has changed since the evolution"
            )
    return found.genes


def crowd_of(
    experiment: ExperimentParts,
    genes: Float[np.ndarray, "g n"],
    generation: int,
    seconds: float,
    rate: float,
    run: int = 0,
    trial: int = 0,
) -> CrowdMotion:
    """Return the motion of a population, computed by one program.

    Animals that diverge are left out.

    Args:
        experiment: experiment in which the population evolved.
        genes: genomes of one run's population.
        generation: number of the generation, which selects the noise.
        seconds: length of the motion from the start of the trial, s, at most the trial's.
        rate: instants per second, rounded to a divisor of the control rate.
        run: number of the run.
        trial: number of the trial.
    """
    simulation = experiment.simulation
    steps = min(max(round(seconds * simulation.control_rate), 1), simulation.steps)
    every = max(round(simulation.control_rate / rate), 1)
    short = dataclasses.replace(simulation, steps=steps)
    genes = np.asarray(genes, np.float32)[:, :_MOST]
    count = genes.shape[1]
    individuals = np.arange(count)
    keys = trial_keys(
        experiment, generation, np.full(count, run), individuals, np.full(count, trial)
    )
    keys = None if keys is None else np.asarray(keys)
    several = situation_numbers(experiment)
    numbers = None if several is None else np.full(count, trial)

    def poses(genes: Array, keys: Array | None, trial: Array | None) -> dict[str, Array]:
        frames = rollout(short, genes, keys, trial, Recorder(count=None))
        return {name: frames[name][::every] for name in ("position", "rotation")}

    spread = layout(count, population_mesh())
    program = sharded(poses, spread.mesh, (2, 2, 1), {"position": 4, "rotation": 5})

    def pick(chosen: np.ndarray) -> tuple:
        return jax.tree.map(lambda x: x[..., chosen], (genes, keys, numbers))

    found = run_in_blocks(program, spread, count, pick)
    names = simulation.world.tree.names
    order = [names.index(body.name) for body in experiment.creature.bodies]
    position = np.moveaxis(found["position"], (3, 2), (1, 2))[:, :, order]
    rotation = np.moveaxis(found["rotation"], (4, 3), (1, 2))[:, :, order]
    sane = (np.abs(position) < _ASTRAY).all((0, 2, 3)) & np.isfinite(rotation).all((0, 2, 3, 4))
    light = simulation.lights[trial if several is not None else 0]
    return CrowdMotion(
        np.arange(len(position)) * every / simulation.control_rate,
        position[:, sane],
        rotation[:, sane],
        np.array(light, float) if light else np.full(3, np.nan),
    )
