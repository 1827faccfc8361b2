"""Error of a motion, relative to a motion with smaller steps.

The error is the median over 16 individuals of a distance, after 1 s in water or 0.25 s on the
ground. It is the distance between the root's place and its place in a *reference*. The reference is
the same program with a sixteenth of the step and the same commands, held over the same times.
Errors are fractions of the body length, so that animals and programs can be compared. The body
length is the largest distance between two bodies' centres of mass in the neutral pose.

Each program has its own reference. So the error measures the accuracy lost by the step, and not
which water or ground is right. Our reference is in float64, so our error contains the rounding of
float32.
"""

import jax
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Float

from benchmarks.exercise import Exercise
from benchmarks.mujoco_peer import Kind, Motion
from benchmarks.ours import compile_motion, full_lanes
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import resting_state

SECONDS = 1.0
# Contacts make neighbouring paths diverge in any program. The quadruped's error after 1 s is a
# third of its body length (MuJoCo: a half). After 0.25 s it is 0.03 (MuJoCo: 0.11).
GROUND_SECONDS = 0.25
FINER = 16
LANES = 16


def our_error(exercise: Exercise, mesh: Mesh) -> float:
    """Return the error of our motion in float32, in body lengths."""
    steps = steps_until_compared(exercise)
    lanes = exercise.lanes(full_lanes(LANES, mesh))
    coarse = compile_motion(exercise, lanes, mesh).run(steps)[:, :LANES]
    exact = our_places(exercise, mesh, steps, FINER)
    return typical_distance(coarse, exact) / body_length(exercise)


def our_places(exercise: Exercise, mesh: Mesh, steps: int, finer: int) -> Float[np.ndarray, "3 n"]:
    """Return the final places of our first individuals' roots, m, in float64.

    Args:
        exercise: exercise of the animals.
        mesh: the devices.
        steps: number of physics steps of the config.
        finer: number of equal parts into which each step of the config is divided.
    """
    lanes = exercise.lanes(full_lanes(LANES, mesh)).astype(float)
    with jax.enable_x64(True):
        return compile_motion(exercise, lanes, mesh, finer).run(steps * finer)[:, :LANES]


def mujoco_error(exercise: Exercise, kind: Kind, threads: int) -> float:
    """Return the error of MuJoCo's motion, in body lengths."""
    steps = steps_until_compared(exercise)
    coarse, fine = (mujoco_places(exercise, kind, threads, steps, finer) for finer in (1, FINER))
    return typical_distance(coarse, fine) / body_length(exercise)


def mujoco_places(
    exercise: Exercise, kind: Kind, threads: int, steps: int, finer: int
) -> Float[np.ndarray, "3 n"]:
    """Return the final places of the roots of MuJoCo's first individuals, m.

    Args:
        exercise: exercise of the animals.
        kind: kind of fluid.
        threads: number of threads.
        steps: number of physics steps of the config.
        finer: number of equal parts into which each step of the config is divided.
    """
    motion = Motion(exercise, kind, exercise.lanes(LANES), threads, finer)
    return motion.places(motion.states(motion.rest(), motion.signals(steps * finer)))


def steps_until_compared(exercise: Exercise) -> int:
    """Return the number of the config's steps until the comparison."""
    simulation = exercise.experiment.simulation
    horizon = SECONDS if simulation.world.ground is None else GROUND_SECONDS
    return round(horizon / simulation.step_length)


def typical_distance(first: Float[np.ndarray, "3 n"], second: Float[np.ndarray, "3 n"]) -> float:
    """Return the median distance over the individuals, m."""
    return float(np.median(np.linalg.norm(first - second, axis=0)))


def body_length(exercise: Exercise) -> float:
    """Return the largest distance between two bodies' centres of mass in the neutral pose, m."""
    tree = exercise.experiment.simulation.world.tree
    pose = kinematics(tree, resting_state(tree))
    centre = np.asarray(pose.origin + (pose.rotation * tree.com[None]).sum(1))
    return float(np.linalg.norm(centre[:, :, None] - centre[:, None], axis=0).max())
