"""Displacements of champions at smaller time steps.

Champions are replayed at their own step, at half of it and at a quarter of it. Another replay at
their own step first turns all joints by 1e-6 rad. Its effect is the chaos of the animal. Only a
larger effect of half the step is due to the step. The displacement is the horizontal
distance of the root from start to end.
"""

import dataclasses
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from evo_cpg.physics.tree.state import State
from evo_cpg.simulation.observers import States
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.training.conditions import finer

# Rotation of each joint at the start, rad.
HAIR = 1e-6


class Displacements(NamedTuple):
    """Displacement of each champion, m.

    Attributes:
        own: displacement at the time step of the evolution.
        half: displacement at half the time step.
        quarter: displacement at a quarter of the time step.
        hair: displacement at the time step of the evolution, with joints turned by `HAIR` first.
    """

    own: Float[np.ndarray, " n"]
    half: Float[np.ndarray, " n"]
    quarter: Float[np.ndarray, " n"]
    hair: Float[np.ndarray, " n"]


def displacements(simulation: Simulation, genes: Float[np.ndarray, "n g"]) -> Displacements:
    """Simulate champions and return their displacements in the first situation, without noise."""

    def displacement(times: int, turned: float = 0.0) -> np.ndarray:

        def begin(state: State) -> State:
            return dataclasses.replace(state, q=state.q + turned)

        trial = finer(simulation, times)
        states = jax.jit(lambda g: rollout(trial, g, observers=States(), begin=begin))(genes.T)
        place = np.asarray(states.position)
        return np.linalg.norm(place[-1, :2] - place[0, :2], axis=0)

    return Displacements(displacement(1), displacement(2), displacement(4), displacement(1, HAIR))


def kept(own: Float[np.ndarray, " n"], other: Float[np.ndarray, " n"]) -> float:
    """Return the median fraction of the displacement that champions keep, each at most 1."""
    return float(np.median(np.minimum(other / own, 1.0)))
