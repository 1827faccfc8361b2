"""How an animal does in situations that it did not evolve in."""

import dataclasses
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from evo_cpg.simulation.noise import Noise
from evo_cpg.simulation.reach_light import ReachLight
from evo_cpg.simulation.recording import Recorder
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.simulation.situation import Situation
from evo_cpg.training.devices import layout, population_mesh, run_in_blocks, sharded
from evo_cpg.training.experiment import compile_trials

# An animal that keeps this share of its displacement without eyes does not steer by them: one that
# swims straight ahead, wherever the light is, keeps 87 % towards a light 30 degrees aside, where it
# is by default, and loses more only where it has to turn farther.
UNSEEING = 0.8


class Probe(NamedTuple):
    """What became of one animal in several situations; arrays have a row for each.

    Attributes:
        situations: what each began with; all have a light.
        start_distance: from the light at the start, m.
        distance: left at the end, as a share of that; NaN where the animal diverged.
        light: seen by the best eye, mean over the trial, 0 to 1; NaN where the animal diverged.
        alive: False where the animal diverged.
        paths: of the root's centre, m, once per control step.
    """

    situations: tuple[Situation, ...]
    start_distance: Float[np.ndarray, " n"]
    distance: Float[np.ndarray, " n"]
    light: Float[np.ndarray, " n"]
    alive: Bool[np.ndarray, " n"]
    paths: Float[np.ndarray, "n t 3"]

    def reached(self, fraction: float) -> Bool[np.ndarray, " n"]:
        """Where no more than this share of the distance was left."""
        return self.alive & (self.distance <= fraction)

    @property
    def displacement(self) -> float:
        """How much nearer the animal came to its lights, all of them together, m."""
        return float(np.nansum(self.start_distance * (1.0 - self.distance)))


def probe(
    simulation: Simulation, genes: Float[np.ndarray, " g"], situations: tuple[Situation, ...]
) -> Probe:
    """Let one animal live in several situations at once, without noise.

    The distance is measured as by the task `ReachLight`, whatever the animal evolved for.

    Args:
        simulation: that it evolved in.
        genes: of the animal.
        situations: to put it into; each with a light.
    """
    final_steps = simulation.task.final_control_steps(simulation.control_rate)
    task = ReachLight(_light(situations[0]), final_steps=final_steps)
    simulation = dataclasses.replace(simulation, task=task, situations=situations, noise=Noise())
    count, mesh = len(situations), population_mesh()
    alone, trial = genes[:, None], np.arange(count)
    outcome = compile_trials(simulation, mesh)(alone, None, trial, count)

    def follow(genes: Float[Array, "g n"], trial: Int[Array, " n"]) -> Float[Array, "t 3 n"]:
        # The root is the first body of the tree.
        recorder = Recorder(len(trial))
        frames = rollout(simulation, genes, None, trial, recorder)
        return frames["position"][:, :, 0]

    spread = layout(count, mesh)
    paths = run_in_blocks(
        sharded(follow, spread.mesh, (2, 1), 3),
        spread,
        count,
        lambda numbers: (alone[:, 0 * numbers], trial[numbers]),
    )
    starts = np.array([situation.start_position for situation in situations])
    lights = np.array([_light(situation) for situation in situations])
    terms = {name: np.where(outcome.alive, x, np.nan) for name, x in outcome.terms.items()}
    return Probe(
        situations,
        np.linalg.norm(lights - starts, axis=1),
        terms["distance"],
        terms["light"],
        np.asarray(outcome.alive),
        np.moveaxis(paths, -1, 0),
    )


def blinded(simulation: Simulation) -> Simulation:
    """The same, but that light sensors give 0."""
    sensors = simulation.sensors._replace(blind=True)
    return dataclasses.replace(simulation, sensors=sensors)


def around(
    situation: Situation, bearings: Iterable[float], distances: Iterable[float] = ()
) -> tuple[Situation, ...]:
    """The situation with its light elsewhere, as high above the horizon as it is.

    Args:
        situation: with a light.
        bearings: of the light, to the left of straight ahead, rad.
        distances: of the light from the start, m; where it is if there are none.
    """
    x, y, z = situation.start_position
    distance, _, elevation = seen_from_start(situation)
    return tuple(
        situation._replace(
            light=(
                x + away * float(np.cos(elevation) * np.cos(situation.start_heading + bearing)),
                y + away * float(np.cos(elevation) * np.sin(situation.start_heading + bearing)),
                z + away * float(np.sin(elevation)),
            )
        )
        for away in (tuple(distances) or (distance,))
        for bearing in bearings
    )


def seen_from_start(situation: Situation) -> tuple[float, float, float]:
    """Distance of the light (m), bearing to the left and elevation above the horizon (rad)."""
    away = np.subtract(_light(situation), situation.start_position)
    level = float(np.hypot(away[0], away[1]))
    bearing = float(np.arctan2(away[1], away[0])) - situation.start_heading
    turned = float(np.arctan2(np.sin(bearing), np.cos(bearing)))
    return float(np.linalg.norm(away)), turned, float(np.arctan2(away[2], level))


def _light(situation: Situation) -> tuple[float, float, float]:
    assert situation.light is not None
    return situation.light
