"""A ten-box swimmer, a four-legged walker, and recordings of them from closed formulas."""

import numpy as np
from PIL import Image

from creatures import box_chain, hinge
from evo_cpg.creature.creature import Actuator, Body, Creature, LightSensor, Material
from evo_cpg.creature.shapes import Box
from evo_cpg.simulation.recording import Recording

SEGMENTS = 10
FREQUENCY = 1.08
AMPLITUDE = np.radians(24)
LAG = np.radians(36)
GOAL = np.array([6.9, 4.0, 0.0])
# The walker: length of the upper or lower half of a leg, and half the side of its square section.
# Positions of the hips, speed, and steps per second of one foot.
LEG, FOOT = 0.24, 0.04
HIPS = {
    "front_left": (0.22, 0.13),
    "front_right": (0.22, -0.13),
    "hind_left": (-0.22, 0.13),
    "hind_right": (-0.22, -0.13),
}
PACE, STEP_RATE = 0.5, 1.4
_MATERIAL = Material(density=1000.0)


def swimmer() -> Creature:
    """Ten boxes in a row, 2.18 m long, head at +x, three axes in every joint, two eyes."""

    chain = box_chain(SEGMENTS, "xyz", Actuator(gain=20.0))
    slant = np.sqrt(0.5)
    eyes = tuple(
        LightSensor("b0", (0.1, side * 0.03, 0.02), (slant, side * slant, 0.0), np.pi)
        for side in (1.0, -1.0)
    )
    return Creature("swimmer", chain.bodies, eyes, ("b0", "b9"))


def swim(seconds: float = 33.0, rate: float = 60.0) -> Recording:
    """A travelling wave of sideways bending that carries the swimmer 8 m to the light.

    Joint i bends by ``AMPLITUDE sin(2 pi FREQUENCY t - LAG i)``. The centre of mass follows a
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
        light=np.tile(GOAL, (steps, 1)),
        dof_names=tuple(f"b{i}.{axis}" for i in joints for axis in "xyz"),
    )


def with_light(recording: Recording, goal: np.ndarray) -> Recording:
    """Return the recording with a light that rests."""
    return recording._replace(light=np.tile(goal, (len(recording.time), 1)))


def walker() -> Creature:
    """A trunk with four legs of two boxes each, all joints about y, without eyes or colours."""

    def leg(name: str, parent: str, anchor: tuple[float, float, float]) -> Body:
        top, motor = (0.0, 0.0, LEG / 2), Actuator(gain=20.0)
        joint = hinge(parent, anchor, top, "y", np.pi / 2, actuator=motor)
        return Body(name, Box((2 * FOOT, 2 * FOOT, LEG)), _MATERIAL, joint)

    legs = [
        body
        for name, (x, y) in HIPS.items()
        for body in (
            leg(f"{name}_thigh", "trunk", (x, y, -0.08)),
            leg(f"{name}_shin", f"{name}_thigh", (0.0, 0.0, -LEG / 2)),
        )
    ]
    return Creature("walker", (Body("trunk", Box((0.6, 0.3, 0.16)), _MATERIAL), *legs))


def walk(seconds: float = 20.0, rate: float = 60.0, course: float = 0.0) -> Recording:
    """A trot at ``PACE`` on the ground z = 0, along a bearing from the x axis (rad).

    Every foot rests on one spot during the first 60 % of its step, and then swings forward in an
    arc. Its lowest corner is at z = 0 exactly while it rests, and never below.
    """
    time = np.arange(round(seconds * rate)) / rate
    trunk = np.column_stack(
        [PACE * time, 0 * time, 0.5 + 0.008 * np.sin(4 * np.pi * STEP_RATE * time)]
    )
    position, rotation = [trunk], [np.broadcast_to(np.eye(3), (len(time), 3, 3))]
    angles = []
    for i, (x, y) in enumerate(HIPS.values()):
        phase = STEP_RATE * time + 0.5 * (i in (1, 2))
        swing = np.clip((phase % 1 - 0.6) / 0.4, 0, 1)
        eased = swing - np.sin(2 * np.pi * swing) / (2 * np.pi)
        foot = x + PACE / STEP_RATE * (np.floor(phase) + 0.3 - 0.5 * (i in (1, 2)) + eased)
        forward = foot - PACE * time - x
        hip = trunk[:, 2] - 0.08
        tilt = np.zeros_like(time)
        # The corner of a leaning shin is lower than the middle of its sole.
        for _ in range(60):
            down = hip - 0.09 * np.sin(np.pi * swing) ** 2 - FOOT * np.abs(np.sin(tilt))
            reach = np.minimum(np.hypot(forward, down), 2 * LEG - 1e-6)
            bend = np.arccos(reach / (2 * LEG))
            thigh = np.arctan2(-forward, down) - bend
            tilt = thigh + 2 * bend
        upper, lower = _about(1, thigh), _about(1, tilt)
        joint = trunk + np.array([x, y, -0.08])
        knee = joint - LEG * upper[..., 2]
        position += [joint - LEG / 2 * upper[..., 2], knee - LEG / 2 * lower[..., 2]]
        rotation += [upper, lower]
        angles += [thigh, 2 * bend]
    turn = _about(2, np.array([course]))[0]
    angle = np.column_stack(angles)
    place = np.stack(position, 1) @ turn.T
    return Recording(
        time=time,
        position=place,
        rotation=turn @ np.stack(rotation, 1),
        joint_angle=angle,
        target_rate=np.gradient(angle, 1 / rate, axis=0),
        cpg_output=np.sin(angle),
        torque=np.zeros_like(angle),
        distance=PACE * time,
        light=np.full((len(time), 3), np.nan),
        dof_names=tuple(f"{body.name}.y" for body in walker().bodies[1:]),
    )


def over(recording: Recording, height, ahead: float = 0.3) -> Recording:
    """Carry a motion on the ground z = 0 over hills.

    At every instant the whole animal is lifted to the height below its middle. It is then tilted
    about the point there, by the mean slope within ``ahead`` (m).

    Args:
        recording: motion on level ground.
        height: height of the ground as a function of x and y ``(n, 2)``, m.
        ahead: half of the animal's length.
    """
    middle = recording.position.mean(1)[:, :2]
    east, north = np.array([ahead, 0.0]), np.array([0.0, ahead])
    slope = [(height(middle + d) - height(middle - d)) / (2 * ahead) for d in (east, north)]
    up = np.column_stack([-slope[0], -slope[1], np.ones(len(middle))])
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    right = np.cross(up, [1.0, 0.0, 0.0])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    tilt = np.stack([np.cross(right, up), right, up], -1)
    foot = np.column_stack([middle, np.zeros(len(middle))])
    position = np.einsum("tij,tbj->tbi", tilt, recording.position - foot[:, None])
    foot[:, 2] = height(middle)
    return recording._replace(
        position=position + foot[:, None], rotation=tilt[:, None] @ recording.rotation
    )


def lowest_points(creature: Creature, recording: Recording) -> np.ndarray:
    """Height of the lowest corner of every body's bounding box ``(t, b)``, m."""
    half = np.array([body.shape.half_extents for body in creature.bodies])
    drop = (np.abs(recording.rotation[..., 2, :]) * half).sum(-1)
    return recording.position[..., 2] - drop


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
