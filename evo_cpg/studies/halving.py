"""How far champions go at smaller steps.

They are replayed at the step that they evolved at, at half and at a quarter of it, and once more at
their own with all joints turned by a hair (1e-6 rad) at first. What a hair changes is the animal's
own chaos; only what half a step changes beyond that is the step's. The way is that of the root from
start to end, over the ground or through the water.
"""

import dataclasses
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from evo_cpg.physics.state import State
from evo_cpg.simulation.observer import States
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.training.variations import finer

# How much each joint is turned, rad.
HAIR = 1e-6


class Displacements(NamedTuple):
    """How far each of some champions gets, m.

    Attributes:
        own: at the step that it evolved at.
        half: at half of it.
        quarter: at a quarter.
        hair: at its own, with joints turned by `HAIR` at the start.
    """

    own: Float[np.ndarray, " n"]
    half: Float[np.ndarray, " n"]
    quarter: Float[np.ndarray, " n"]
    hair: Float[np.ndarray, " n"]


def displacements(simulation: Simulation, genes: Float[np.ndarray, "n g"]) -> Displacements:
    """How far champions get, without noise, in the first of their situations."""

    def displacement(times: int, turned: float = 0.0) -> np.ndarray:

        def begin(state: State) -> State:
            return dataclasses.replace(state, q=state.q + turned)

        trial = finer(simulation, times)
        states = jax.jit(lambda g: rollout(trial, g, observers=States(), begin=begin))(genes.T)
        place = np.asarray(states.position)
        return np.linalg.norm(place[-1, :2] - place[0, :2], axis=0)

    return Displacements(displacement(1), displacement(2), displacement(4), displacement(1, HAIR))


def kept(own: Float[np.ndarray, " n"], other: Float[np.ndarray, " n"]) -> float:
    """The median share of its way that a champion keeps, at most all of it."""
    return float(np.median(np.minimum(other / own, 1.0)))
