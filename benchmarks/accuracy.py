"""How far a motion is from the one that smaller steps give.

The error of a motion is the median over 16 individuals of the distance, after 1 s in water or
0.25 s on the ground, between where the root is and where it is in a *reference*: the same program
with a sixteenth of the step and the same commands, held over the same times. It is given as a share
of the body length, the largest distance between two bodies' centres in the neutral pose, so that
animals and programs can be compared. Each program is held against a reference of its own: what is
measured is what the step costs in accuracy, not whose water or ground is the right one. Our
reference is in float64, so our error contains the rounding of float32.
"""

import jax
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Float

from benchmarks.exercise import Exercise
from benchmarks.mujoco_peer import Kind, Motion, places
from benchmarks.ours import Program, compile_motion, full_lanes
from evo_cpg.physics.kinematics import kinematics
from evo_cpg.physics.state import resting_state

SECONDS = 1.0
# Contacts make neighbouring paths part, whatever the program: after 1 s the quadruped is a third of
# its length from its reference (MuJoCo's a half), after 0.25 s 0.03 of it (0.11).
GROUND_SECONDS = 0.25
FINER = 16
LANES = 16


def our_error(exercise: Exercise, program: Program, mesh: Mesh) -> float:
    """Of a compiled motion with at least `LANES` lanes, in body lengths."""
    steps = steps_until_compared(exercise)
    exact = our_places(exercise, mesh, steps, FINER)
    return typical_distance(program.run(steps)[:, :LANES], exact) / body_length(exercise)


def our_places(exercise: Exercise, mesh: Mesh, steps: int, finer: int) -> Float[np.ndarray, "3 n"]:
    """Of the first individuals after so many steps, each divided, in float64; m."""
    lanes = exercise.lanes(full_lanes(LANES, mesh)).astype(float)
    with jax.enable_x64(True):
        return compile_motion(exercise, lanes, mesh, finer).run(steps * finer)[:, :LANES]


def mujoco_error(exercise: Exercise, kind: Kind, threads: int) -> float:
    """Of MuJoCo's motion, in body lengths."""
    steps = steps_until_compared(exercise)
    coarse, fine = (mujoco_places(exercise, kind, threads, steps, finer) for finer in (1, FINER))
    return typical_distance(coarse, fine) / body_length(exercise)


def mujoco_places(
    exercise: Exercise, kind: Kind, threads: int, steps: int, finer: int
) -> Float[np.ndarray, "3 n"]:
    """Of MuJoCo's first individuals after so many steps, each divided; m."""
    motion = Motion(exercise, kind, exercise.lanes(LANES), threads, finer)
    return places(motion.states(motion.rest(), motion.signals(steps * finer)))


def steps_until_compared(exercise: Exercise) -> int:
    """Of the config's length."""
    simulation = exercise.experiment.simulation
    horizon = SECONDS if simulation.world.ground is None else GROUND_SECONDS
    return round(horizon / simulation.step_length)


def typical_distance(first: Float[np.ndarray, "3 n"], second: Float[np.ndarray, "3 n"]) -> float:
    """Median over the individuals, m."""
    return float(np.median(np.linalg.norm(first - second, axis=0)))


def body_length(exercise: Exercise) -> float:
    """Largest distance between two bodies' centres in the neutral pose, m."""
    tree = exercise.experiment.simulation.world.tree
    pose = kinematics(tree, resting_state(tree))
    centre = np.asarray(pose.origin + (pose.rotation * tree.com[None]).sum(1))
    return float(np.linalg.norm(centre[:, :, None] - centre[:, None], axis=0).max())
