"""Observers. `evo_cpg.simulation.rollout.rollout` returns the result of each.

| observer | in | result | of |
|---|---|---|---|
| `Judge` | `evo_cpg.simulation.judge` | terms of the task, survivors | the whole trial |
| `Recorder` | `evo_cpg.simulation.recording` | poses, commands, forces | every control step |
| `States` | here | states of the body | every control step |
| `EachPhysicsStep` | `evo_cpg.simulation.physics_steps` | states, forces | every physics step |
"""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, PyTree

from evo_cpg.physics.tree.state import State
from evo_cpg.simulation.control_step import AnimalState, Effects, EpisodeConstants
from evo_cpg.simulation.simulation import Simulation


class Seen(NamedTuple):
    """View of one control step for an observer.

    Attributes:
        simulation: the trial.
        constants: constants of the trial.
        index: number of the control step, from 0.
        animal: the animal at the end of the step.
        effects: result of the step.
    """

    simulation: Simulation
    constants: EpisodeConstants
    index: Array
    animal: AnimalState
    effects: Effects


@dataclasses.dataclass(frozen=True)
class Observer:
    """Follows a trial and returns a result. Subclasses override some of the methods.

    All methods are pure JAX functions of arrays whose trailing axes are individuals.

    Attributes:
        every_step: True if `of_step` returns anything. If it is False for all observers, a whole
            trial can be one native program.
        physics: True if `Effects.physics` is needed. Physics steps are then separate programs.
    """

    every_step = False
    physics = False

    def begin(self, simulation: Simulation, animal: AnimalState) -> PyTree[Array]:
        """Return the tally before the first control step."""
        del simulation, animal
        return ()

    def update(self, tally: PyTree[Array], seen: Seen) -> PyTree[Array]:
        """Return the tally after a control step: same structure, shapes and types."""
        del seen
        return tally

    def of_step(self, seen: Seen) -> PyTree[Array]:
        """Return the arrays to keep of a control step."""
        del seen
        return ()

    def finish(self, simulation: Simulation, tally: PyTree[Array], steps: PyTree[Array]) -> Any:
        """Return the result. The default is ``steps``, the results of `of_step` stacked in time."""
        del simulation, tally
        return steps


@dataclasses.dataclass(frozen=True)
class States(Observer):
    """Keeps the states of the body: at the start and after every control step, stacked."""

    every_step = True

    def begin(self, simulation: Simulation, animal: AnimalState) -> State:
        """Return the state at the start."""
        del simulation
        return animal.state

    def of_step(self, seen: Seen) -> State:
        """Return the state after the step."""
        return seen.animal.state

    def finish(self, simulation: Simulation, tally: State, steps: State) -> State:
        """Return the states of all steps, after the initial state."""
        del simulation
        return jax.tree.map(lambda first, rest: jnp.concatenate([first[None], rest]), tally, steps)
