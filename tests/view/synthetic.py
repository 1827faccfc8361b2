"""A ten-box swimmer and an invented, exactly known recording of it swimming to a light."""

import numpy as np
from PIL import Image

from evo_cpg.creature.creature import (
    Actuator,
    Body,
    Creature,
    Joint,
    LightSensor,
    Material,
    neutral_pose,
)
from evo_cpg.creature.shapes import Box
from evo_cpg.simulation.recording import Recording

SEGMENTS = 10
FREQUENCY = 1.08
AMPLITUDE = np.radians(24)
LAG = np.radians(36)
GOAL = np.array([6.9, 4.0, 0.0])
_MATERIAL = Material(density=1000.0)
_LIMIT = np.pi / 3


def swimmer() -> Creature:
    """Ten boxes in a row, 2.18 m long, head at +x, three axes in every joint, two eyes."""

    def joint(parent: int) -> Joint:
        return Joint(
            parent=f"b{parent}",
            parent_anchor=(-0.11, 0.0, 0.0),
            child_anchor=(0.11, 0.0, 0.0),
            axes=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
            lower=(-_LIMIT,) * 3,
            upper=(_LIMIT,) * 3,
            actuator=Actuator(gain=20.0),
        )

    bodies = tuple(
        Body(f"b{i}", Box((0.2, 0.1, 0.1)), _MATERIAL, joint(i - 1) if i else None)
        for i in range(SEGMENTS)
    )
    slant = np.sqrt(0.5)
    eyes = tuple(
        LightSensor("b0", (0.1, side * 0.03, 0.02), (slant, side * slant, 0.0), np.pi)
        for side in (1.0, -1.0)
    )
    return Creature("swimmer", bodies, eyes, ("b0", "b9"))


def swim(seconds: float = 33.0, rate: float = 60.0) -> Recording:
    """A travelling wave of sideways bending that carries the swimmer 8 m to the light.

    Joint i bends by ``AMPLITUDE sin(2 pi FREQUENCY t - LAG i)``; the centre of mass follows a
    quadratic Bezier curve from the origin to 0.3 m before the light.
    """
    steps = round(seconds * rate)
    time = np.arange(steps) / rate
    joints = np.arange(1, SEGMENTS)
    phase = 2 * np.pi * FREQUENCY * time[:, None] - LAG * joints
    angle = np.zeros((steps, SEGMENTS - 1, 3))
    angle[..., 0] = np.radians(3) * np.sin(2 * phase)
    angle[..., 1] = np.radians(5) * np.sin(phase + 1)
    angle[..., 2] = AMPLITUDE * np.sin(phase)
    output = np.zeros_like(angle)
    output[..., 2] = 0.8 * np.sin(phase + 0.6)

    s = (time / max(time[-1], 1e-9))[:, None]
    end = GOAL * (1 - 0.3 / np.linalg.norm(GOAL))
    bend = np.array([3.5, 0.0, 0.0])
    path = 2 * s * (1 - s) * bend + s**2 * end
    tangent = 2 * (1 - 2 * s) * bend + 2 * s * end
    course = np.arctan2(tangent[:, 1], tangent[:, 0])

    position, rotation = _chain(angle)
    mean_axis = rotation[..., 0].mean(1)
    turn = _about(2, course - np.arctan2(mean_axis[:, 1], mean_axis[:, 0]))
    rotation = turn[:, None] @ rotation
    position = np.einsum("tij,tbj->tbi", turn, position)
    position += (path - position.mean(1))[:, None]

    flat = angle.reshape(steps, -1)
    return Recording(
        time=time,
        position=position,
        rotation=rotation,
        joint_angle=flat,
        target_rate=np.gradient(flat, 1 / rate, axis=0),
        cpg_output=output.reshape(steps, -1),
        torque=np.zeros_like(flat),
        distance=np.linalg.norm(position[:, 0] - GOAL, axis=-1),
        goal=GOAL,
        dof_names=tuple(f"b{i}.{axis}" for i in joints for axis in "xyz"),
    )


def standing(creature: Creature, seconds: float = 1.0, rate: float = 30.0) -> Recording:
    """The creature in its neutral pose, resting on the ground z = 0 and not moving."""
    steps = round(seconds * rate)
    centres, rotations = neutral_pose(creature)
    lift = max(
        (np.abs(turn[2]) * body.shape.half_extents).sum() - centre[2]
        for body, centre, turn in zip(creature.bodies, centres, rotations, strict=True)
    )
    position = np.repeat((centres + np.array([0, 0, lift]))[None], steps, 0)
    none = np.zeros((steps, 0))
    goal = np.array([3.0, 1.0, lift])
    return Recording(
        time=np.arange(steps) / rate,
        position=position,
        rotation=np.repeat(rotations[None], steps, 0),
        joint_angle=none,
        target_rate=none,
        cpg_output=none,
        torque=none,
        distance=np.linalg.norm(position[:, 0] - goal, axis=-1),
        goal=goal,
        dof_names=(),
    )


def read(path) -> np.ndarray:
    """Pixels ``(height, width, 3)`` of a picture, as integers that may be subtracted."""
    with Image.open(path) as picture:
        return np.array(picture.convert("RGB")).astype(int)


def _chain(angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centres ``(t, b, 3)`` and rotations ``(t, b, 3, 3)`` with the head at the origin."""
    position = [np.zeros((len(angle), 3))]
    rotation = [np.broadcast_to(np.eye(3), (len(angle), 3, 3))]
    arm = np.array([0.11, 0.0, 0.0])
    for i in range(angle.shape[1]):
        turned = rotation[-1]
        for axis in range(3):
            turned = turned @ _about(axis, angle[:, i, axis])
        position.append(position[-1] - rotation[-1] @ arm - turned @ arm)
        rotation.append(turned)
    return np.stack(position, 1), np.stack(rotation, 1)


def _about(axis: int, angle: np.ndarray) -> np.ndarray:
    """Rotation matrices ``(t, 3, 3)`` about a coordinate axis."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.zeros((len(angle), 3, 3))
    matrix[:, axis, axis] = 1
    matrix[:, first, first] = matrix[:, second, second] = np.cos(angle)
    matrix[:, second, first] = np.sin(angle)
    matrix[:, first, second] = -np.sin(angle)
    return matrix
