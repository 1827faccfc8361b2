"""Test of an animal in situations that it did not evolve in."""

import dataclasses
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from evo_cpg.simulation.noise import Noise
from evo_cpg.simulation.recording import Recorder
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.simulation.situation import Situation
from evo_cpg.simulation.tasks import ReachLight
from evo_cpg.training.devices import layout, population_mesh, run_in_blocks, sharded
from evo_cpg.training.experiment import compile_trials

# An animal that keeps at least this fraction of its displacement to the lights when blinded counts
# as not using its eyes. A blinded animal that swims straight ahead keeps 87 % of it to a light 30
# degrees aside, the default. It keeps less than this fraction only if the light is farther aside.
UNSEEING = 0.8


class Probe(NamedTuple):
    """Results of one animal in several situations. Arrays have a row for each situation.

    Attributes:
        situations: initial situations, all with a light.
        start_distance: initial distance from the light, m.
        distance: final distance as a fraction of the initial one, or NaN if the animal diverged.
        light: reading of the eye that sees most, 0 to 1, mean over the trial. NaN if diverged.
        alive: False if the animal diverged.
        paths: positions of the root's centre, m, once per control step.
    """

    situations: tuple[Situation, ...]
    start_distance: Float[np.ndarray, " n"]
    distance: Float[np.ndarray, " n"]
    light: Float[np.ndarray, " n"]
    alive: Bool[np.ndarray, " n"]
    paths: Float[np.ndarray, "n t 3"]

    def reached(self, fraction: float) -> Bool[np.ndarray, " n"]:
        """Return whether at most this fraction of the initial distance was left, by situation."""
        return self.alive & (self.distance <= fraction)

    @property
    def displacement(self) -> float:
        """Sum over all situations of the decrease in distance to the light, m."""
        return float(np.nansum(self.start_distance * (1.0 - self.distance)))


def probe(
    simulation: Simulation, genes: Float[np.ndarray, " g"], situations: tuple[Situation, ...]
) -> Probe:
    """Simulate one animal in several situations at once, without noise.

    The task `ReachLight` measures the distance, even if the animal evolved for another task.

    Args:
        simulation: simulation that the animal evolved in.
        genes: genome of the animal.
        situations: initial situations, each with a light.
    """
    final_steps = simulation.task.final_control_steps(simulation.control_rate)
    task = ReachLight(_light(situations[0]), final_steps=final_steps)
    simulation = dataclasses.replace(simulation, task=task, situations=situations, noise=Noise())
    count, mesh = len(situations), population_mesh()
    alone, trial = genes[:, None], np.arange(count)
    outcome = compile_trials(simulation, mesh)(alone, None, trial, count)

    def follow(genes: Float[Array, "g n"], trial: Int[Array, " n"]) -> Float[Array, "t 3 n"]:
        # Record all individuals. In the recorded positions, body 0 is the root.
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
    """Return the simulation with light sensors that return 0."""
    sensors = simulation.sensors._replace(blind=True)
    return dataclasses.replace(simulation, sensors=sensors)


def around(
    situation: Situation, bearings: Iterable[float], distances: Iterable[float] = ()
) -> tuple[Situation, ...]:
    """Return copies of a situation with the light at other bearings, and at the same elevation.

    Args:
        situation: situation with a light.
        bearings: bearings of the light, to the left of straight ahead, rad.
        distances: distances of the light from the start, m. If empty, the present distance.
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
    """Return the light's distance (m), bearing to the left and elevation (rad) at the start."""
    away = np.subtract(_light(situation), situation.start_position)
    level = float(np.hypot(away[0], away[1]))
    bearing = float(np.arctan2(away[1], away[0])) - situation.start_heading
    turned = float(np.arctan2(np.sin(bearing), np.cos(bearing)))
    return float(np.linalg.norm(away)), turned, float(np.arctan2(away[2], level))


def _light(situation: Situation) -> tuple[float, float, float]:
    assert situation.light is not None
    return situation.light
