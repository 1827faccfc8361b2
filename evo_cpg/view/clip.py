"""A recording sampled at the frames of a film, and its rotations as quaternions."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from evo_cpg.simulation.recording import Recording

# Window of the displayed speed, s: long enough to average a tail beat.
_SPEED_WINDOW = 1.0


class Clip(NamedTuple):
    """A recording sampled at the film's frames.

    Attributes:
        time: time of each frame, s.
        position: centre of every body, m.
        rotation: rotation from body to world.
        distance: distance from the root to the goal or, without a goal, horizontal distance of the
            root from its start, m.
        speed: speed of the mean of the bodies' centres, averaged over the last second, m/s.
        rate: frames per second of recorded time.
    """

    time: Float[np.ndarray, " frames"]
    position: Float[np.ndarray, "frames b 3"]
    rotation: Float[np.ndarray, "frames b 3 3"]
    distance: Float[np.ndarray, " frames"]
    speed: Float[np.ndarray, " frames"]
    rate: float


def sample(
    recording: Recording, fps: float, speed: float = 1.0, seconds: float | None = None
) -> Clip:
    """Sample a recording at the frames of a film, with interpolation between steps.

    Args:
        recording: the motion.
        fps: frames per second of the film.
        speed: recorded seconds per second of film.
        seconds: recorded time to show, s, or None for the whole recording.
    """
    start, end = recording.time[0], recording.time[-1]
    if seconds is not None:
        end = min(end, start + seconds)
    # A hundredth of a frame keeps rounding from dropping the last frame.
    time = start + np.arange(int((end - start) * fps / speed + 1.01)) * (speed / fps)
    return sample_at(recording, time, fps / speed)


def sample_at(recording: Recording, time: Float[np.ndarray, " frames"], rate: float) -> Clip:
    """Sample a recording at some instants, with interpolation between steps.

    Args:
        recording: the motion.
        time: the instants, s.
        rate: frames per second of recorded time.
    """
    after = np.clip(np.searchsorted(recording.time, time), 1, max(len(recording.time) - 1, 1))
    after = np.minimum(after, len(recording.time) - 1)
    before = np.maximum(after - 1, 0)
    step = recording.time[after] - recording.time[before]
    weight = np.clip((time - recording.time[before]) / np.where(step > 0, step, 1), 0, 1)

    def between(values: np.ndarray) -> np.ndarray:
        part = weight.reshape(-1, *(1,) * (values.ndim - 1))
        return (1 - part) * values[before] + part * values[after]

    # The nearest rotation to a mean of two near rotations: its polar factor.
    left, _, right = np.linalg.svd(between(recording.rotation))
    position = between(recording.position)
    return Clip(
        time,
        position,
        left @ right,
        between(recording.distance),
        mean_speed(position.mean(1), rate),
        rate,
    )


def mean_speed(path: Float[np.ndarray, "frames 3"], rate: float) -> Float[np.ndarray, " frames"]:
    """Return the speed along a path at every frame, m/s: the mean velocity of the last second.

    In the first second it is the mean velocity since the start. So the first frame shows no speed.

    Args:
        path: the places, m.
        rate: frames per second.
    """
    frames = np.arange(len(path))
    first = np.maximum(frames - max(round(_SPEED_WINDOW * rate), 1), 0)
    moved = np.linalg.norm(path - path[first], axis=-1)
    return moved * rate / np.maximum(frames - first, 1)


def quaternions(rotation: Float[np.ndarray, "t *b 3 3"]) -> Float[np.ndarray, "t *b 4"]:
    """Return unit quaternions x, y, z, w of rotation matrices.

    Signs are chosen so that no quaternion jumps to its negative from one instant to the next.
    """
    # SciPy takes long to import.
    from scipy.spatial.transform import Rotation

    found = Rotation.from_matrix(rotation.reshape(-1, 3, 3)).as_quat()
    found = found.reshape(*rotation.shape[:-2], 4)
    flips = np.where((found[1:] * found[:-1]).sum(-1) < 0, -1.0, 1.0)
    found[1:] *= np.cumprod(flips, axis=0)[..., None]
    return found
