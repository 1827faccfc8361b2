"""MuJoCo's population at an exercise of ours: `mujoco.rollout` with a thread per core.

Same animal, motors, commands and step; float64 and `implicitfast`. Its contacts have no
restitution. In water there are three kinds of it: its own two models of a fluid, neither of which
has buoyancy (so gravity is left out), and none.
"""

from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Bool, Float
from mujoco import rollout

from benchmarks.exercise import Exercise
from benchmarks.mujoco_model import mujoco_model
from evo_cpg.exchange.mujoco_state import motor_order

_FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS
# The clock comes first in a state, then the root's place.
_PLACE = slice(1, 4)


class Kind(NamedTuple):
    """A way to let MuJoCo do the same.

    Attributes:
        name: for the table.
        fluid: "ellipsoid", "" for the inertia box.
        dense: whether there is water at all.
    """

    name: str
    fluid: str = ""
    dense: bool = True


WET = (
    Kind("MuJoCo, ellipsoids", "ellipsoid"),
    Kind("MuJoCo, inertia box"),
    Kind("MuJoCo, no fluid", dense=False),
)
DRY = (Kind("MuJoCo", dense=False),)


def kinds(exercise: Exercise) -> tuple[Kind, ...]:
    """Those that suit the world of an exercise."""
    return WET if exercise.experiment.simulation.world.water is not None else DRY


def peer_model(
    exercise: Exercise, kind: Kind, finer: int = 1, integrator: str = "implicitfast"
) -> mujoco.MjModel:
    """The animal and its world for MuJoCo.

    Args:
        exercise: what it is to do.
        kind: of fluid.
        finer: in how many steps each step is divided.
        integrator: MuJoCo's name of it.
    """
    experiment = exercise.experiment
    simulation = experiment.simulation
    world, water = simulation.world, simulation.world.water
    options: dict[str, float | str] = {
        "timestep": simulation.step_length / finer,
        "integrator": integrator,
        "gravity": "0 0 0" if water is not None else f"0 0 {-world.gravity}",
    }
    if water is not None and kind.dense:
        options["density"] = water.density
    return mujoco_model(
        experiment.creature,
        options=options,
        fluid=kind.fluid,
        motors=True,
        limits=world.ground is not None,
        ground=world.ground,
        start=simulation.situations[0].start_position,
        pairs=world.pair_names,
    )


class Motion:
    """A population that MuJoCo moves.

    Args:
        exercise: what it does.
        kind: of fluid.
        lanes: what individuals do differently (see `Exercise.lanes`).
        threads: that move it.
        finer: in how many steps each step is divided.
    """

    def __init__(
        self,
        exercise: Exercise,
        kind: Kind,
        lanes: Float[np.ndarray, "k n"],
        threads: int,
        finer: int = 1,
    ):
        self.exercise, self.lanes, self.finer = exercise, lanes, finer
        self.model = peer_model(exercise, kind, finer)
        self.data = [mujoco.MjData(self.model) for _ in range(threads)]
        self.order = motor_order(self.model, exercise.experiment.simulation.world.tree)

    def rest(self) -> Float[np.ndarray, "n state"]:
        """All individuals as the model has them."""
        state = np.zeros(mujoco.mj_stateSize(self.model, _FULL))
        mujoco.mj_getState(self.model, self.data[0], state, _FULL)
        return np.tile(state, (self.lanes.shape[1], 1))

    def signals(self, steps: int, first: int = 0) -> Float[np.ndarray, "n steps motors"]:
        """What the motors are told, from a step on."""
        index = (first + np.arange(steps)) // self.finer
        return self.exercise.signals(self.lanes, index)[..., self.order]

    def states(
        self, start: Float[np.ndarray, "n state"], signals: Float[np.ndarray, "n steps motors"]
    ) -> Float[np.ndarray, "n steps state"]:
        """Every individual's state after every step."""
        return np.asarray(rollout.rollout(self.model, self.data, start, signals)[0])


def places(states: Float[np.ndarray, "n steps state"]) -> Float[np.ndarray, "3 n"]:
    """Of the roots at the end, m."""
    return states[:, -1, _PLACE].T


def stopped(states: Float[np.ndarray, "n steps state"], seconds: float) -> Bool[np.ndarray, " n"]:
    """Which of MuJoCo's individuals diverged.

    `mujoco.rollout` gives up one that does: it resets it, time included, and repeats that state
    to the end.

    Args:
        states: of all steps.
        seconds: what the clock shows where all is well, s.
    """
    last = states[:, -1]
    return ~(np.isfinite(last).all(-1) & np.isclose(last[:, 0], seconds))
