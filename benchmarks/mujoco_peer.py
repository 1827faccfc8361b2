"""MuJoCo's population at our exercises: `mujoco.rollout` with a thread per core.

Animal, motors, commands and step are equal to ours. MuJoCo uses float64 and `implicitfast`. Its
contacts have no restitution. MuJoCo simulates an imported animal from its own file, with the
contacts of the file. Its solver is then MuJoCo's default: Newton with at most 100 iterations. In
water it takes part in three kinds: with each of its two models of a fluid, and without a fluid. The
fluid models have no buoyancy, so gravity is left out.
"""

from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int
from mujoco import rollout

from benchmarks.exercise import Exercise, Torques
from benchmarks.mujoco_model import mujoco_model
from evo_cpg.io.models.mujoco_state import motor_order

_FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS
# MuJoCo's default solver of contacts.
_SOLVER = mujoco.MjOption()
# MuJoCo's number of the root. The world has the number 0.
_ROOT = 1


class Kind(NamedTuple):
    """A kind of MuJoCo model.

    Attributes:
        name: name in the table.
        fluid: "ellipsoid", or "" for the inertia box.
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
    """Return the kinds that suit the world of an exercise."""
    return WET if exercise.experiment.simulation.world.water is not None else DRY


def peer_model(
    exercise: Exercise, kind: Kind, finer: int = 1, integrator: str = "implicitfast"
) -> mujoco.MjModel:
    """Return MuJoCo's model of the animal and its world.

    Args:
        exercise: exercise of the animal.
        kind: kind of fluid.
        finer: number of equal parts into which each step of the config is divided.
        integrator: MuJoCo's name of the integrator.
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


class Peer(NamedTuple):
    """MuJoCo's model of an animal, and its motors.

    Attributes:
        model: the model, whose neutral pose at our start is the initial state.
        order: index of the degree of freedom that each motor drives.
        scale: control of each motor for a command of 1.
    """

    model: mujoco.MjModel
    order: Int[np.ndarray, " motors"]
    scale: Float[np.ndarray, " motors"] | float = 1.0

    @classmethod
    def of(cls, exercise: Exercise, kind: Kind, finer: int = 1) -> "Peer":
        """Return the peer of our animal, or of the file of an imported animal.

        Args:
            exercise: exercise of the animal.
            kind: kind of fluid.
            finer: number of equal parts into which each step of the config is divided.
        """
        if isinstance(exercise, Torques):
            return _original(exercise, finer)
        model = peer_model(exercise, kind, finer)
        return cls(model, motor_order(model, exercise.experiment.simulation.world.tree))


def _original(exercise: Torques, finer: int) -> Peer:
    """Return the model in the file of an imported animal, whose motors are torque motors."""
    model = mujoco.MjModel.from_xml_path(str(exercise.path))
    simulation, imported = exercise.experiment.simulation, exercise.imported
    model.opt.timestep = simulation.step_length / finer
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.solver, model.opt.iterations = _SOLVER.solver, _SOLVER.iterations
    # The file may place the animal elsewhere.
    shift = np.subtract(simulation.situations[0].start_position, imported.place)
    if model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE:
        model.qpos0[:3] += shift
    else:
        model.body_pos[_ROOT] += shift
    tree = simulation.world.tree
    joints = [joint for name in tree.names for joint in imported.joints.get(name, ())]
    order = [joints.index(joint) for joint in model.actuator_trnid[:, 0]]
    return Peer(model, np.array(order), 1.0 / model.actuator_gear[:, 0])


class Motion:
    """A population that MuJoCo moves.

    Args:
        exercise: exercise of the population.
        kind: kind of fluid.
        lanes: differing inputs of individuals (see `Exercise.lanes`).
        threads: number of threads.
        finer: number of equal parts into which each step of the config is divided.
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
        self.model, self.order, self.scale = Peer.of(exercise, kind, finer)
        self.data = [mujoco.MjData(self.model) for _ in range(threads)]

    def rest(self) -> Float[np.ndarray, "n state"]:
        """Return all individuals in the model's initial state."""
        state = np.zeros(mujoco.mj_stateSize(self.model, _FULL))
        mujoco.mj_getState(self.model, self.data[0], state, _FULL)
        return np.tile(state, (self.lanes.shape[1], 1))

    def signals(self, steps: int, first: int = 0) -> Float[np.ndarray, "n steps motors"]:
        """Return the controls of MuJoCo's motors.

        Args:
            steps: number of steps. ``finer`` of them make up one step of the config.
            first: number of the first of these steps, from 0.
        """
        index = (first + np.arange(steps)) // self.finer
        return self.exercise.signals(self.lanes, index)[..., self.order] * self.scale

    def states(
        self, start: Float[np.ndarray, "n state"], signals: Float[np.ndarray, "n steps motors"]
    ) -> Float[np.ndarray, "n steps state"]:
        """Return every individual's state after every step, ``finer`` to a step of the config."""
        return np.asarray(rollout.rollout(self.model, self.data, start, signals)[0])

    def places(self, states: Float[np.ndarray, "n steps state"]) -> Float[np.ndarray, "3 n"]:
        """Return the final places of the roots, m."""
        found, data = [], self.data[0]
        for state in states[:, -1]:
            mujoco.mj_setState(self.model, data, state, _FULL)
            mujoco.mj_kinematics(self.model, data)
            found.append(data.xpos[_ROOT].copy())
        return np.array(found).T


def stopped(states: Float[np.ndarray, "n steps state"], seconds: float) -> Bool[np.ndarray, " n"]:
    """Return a mask of MuJoCo's diverged individuals.

    `mujoco.rollout` stops a diverged individual. It resets the state, time included, and
    repeats it to the end.

    Args:
        states: states of all steps.
        seconds: final time of an individual that did not diverge, s.
    """
    last = states[:, -1]
    return ~(np.isfinite(last).all(-1) & np.isclose(last[:, 0], seconds))
