"""Edits that place parts: shift them, turn them, and point new ones away from a surface."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from evo_cpg.io.schema.copies import MirrorAxis, reflected
from evo_cpg.io.schema.section import Vector
from evo_cpg.view.drawing_page.document import Data, DrawingError
from evo_cpg.view.drawing_page.lookup import Posed, bodies, posed, tidy

# Angle within which a direction counts as one of the parent's axes, degrees.
_SNAP_DEG = 4.0
# Distance from a plane of symmetry within which a place is in the plane, in half extents.
_NEAR = 0.15
# A part that points backward by more than this cosine keeps its parent's axes, as in a spine.
_BACKWARD = -0.5


def reflected_if(place: Sequence[float] | np.ndarray, axis: MirrorAxis | None) -> np.ndarray:
    """Return a position or direction as written in the entry of a body that may be mirrored."""
    x, y, z = map(float, place)
    return np.array(reflected((x, y, z), axis) if axis else (x, y, z))


def on_planes(
    place: np.ndarray, normal: np.ndarray, half_extents: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return a place on a surface and its normal, moved into planes of symmetry that are close."""
    near = np.abs(place) < _NEAR * np.asarray(half_extents, float)
    # At a corner the normal may point along the plane's normal alone.
    flat = np.where(near, 0.0, normal)
    return np.where(near, 0.0, place), flat if flat.any() else normal


def facing(normal: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the orientation of a part that points along a direction.

    Its x axis points along the direction. If the direction is backward, its x axis points against
    the direction, so that the bodies of a spine all face forward.

    Args:
        normal: direction in the parent's frame.
        reach: distance from the part's centre to its end, m.

    Returns:
        Roll, pitch and yaw in degrees, and the position of the joint in the part's frame, m.
    """
    x, y, z = _snapped(normal / np.linalg.norm(normal))
    sign = -1.0 if x < _BACKWARD else 1.0
    x, y, z = sign * x, sign * y, sign * z
    yaw = np.degrees(np.arctan2(y, x)) if np.hypot(x, y) > 1e-9 else 0.0
    pitch = np.degrees(-np.arcsin(np.clip(z, -1, 1)))
    return np.array([0.0, pitch, yaw]), np.array([-sign * reach, 0.0, 0.0])


def _snapped(direction: np.ndarray) -> np.ndarray:
    largest = np.abs(direction).argmax()
    if abs(direction[largest]) > np.cos(np.radians(_SNAP_DEG)):
        return np.sign(direction[largest]) * np.eye(3)[largest]
    return direction


def shift(data: Data, source: Path, part: str, by: Vector) -> None:
    """Move a part along its parent's surface or away from it, with everything that it carries.

    Args:
        data: data of the document.
        source: file of the document.
        part: name of the body that is moved. Copies of its entry move alike.
        by: displacement in the axes of the root at rest, m.
    """
    here, joint = posed(data, source), None
    index = here.index(part)
    joint, parent = _joint(data, here, index)
    at = _at(here, index, joint) + here.rotations[parent].T @ np.asarray(by, float)
    joint["at"] = tidy(_written(here, index, at))


def turn(data: Data, source: Path, part: str, rotation: tuple[Vector, Vector, Vector]) -> None:
    """Turn a part about its joint.

    Args:
        data: data of the document.
        source: file of the document.
        part: name of the body that is turned. Copies of its entry turn alike.
        rotation: rotation matrix from its axes to the axes of the root at rest.
    """
    here = posed(data, source)
    index = here.index(part)
    joint, parent = _joint(data, here, index)
    turned = np.asarray(rotation, float)
    if not np.allclose(turned @ turned.T, np.eye(3), atol=1e-3):
        raise DrawingError("a turn needs a rotation matrix")
    body = here.copies[index]
    between = here.rotations[parent].T @ turned
    between = Rotation.from_euler("z", -body.turn_deg, degrees=True).as_matrix() @ between
    if body.mirror:
        mirror = np.diag(reflected_if(np.ones(3), body.mirror))
        between = mirror @ between @ mirror
    joint["rotation_deg"] = tidy(np.round(_angles(between), 2) + 0.0)


def _angles(rotation: np.ndarray) -> np.ndarray:
    """Return roll, pitch and yaw of a rotation about the parent's x, then y, then z, degrees.

    At a pitch of 90 degrees only their sum or difference counts, and roll is 0.
    """
    pitch = np.arcsin(np.clip(-rotation[2, 0], -1, 1))
    if np.hypot(rotation[0, 0], rotation[1, 0]) < 1e-6:
        roll, yaw = 0.0, np.arctan2(-rotation[0, 1], rotation[1, 1])
    else:
        roll = np.arctan2(rotation[2, 1], rotation[2, 2])
        yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
    return np.degrees([roll, pitch, yaw])


def _joint(data: Data, here: Posed, index: int) -> tuple[Data, int]:
    """Return the joint of a body, and the index of its parent."""
    body = here.copies[index]
    if body.parent is None:
        raise DrawingError(f"{body.name} is the root, to which all other places are relative")
    names = [each.name for each in here.copies]
    return bodies(data)[body.entry]["joint"], names.index(body.parent)


def _at(here: Posed, index: int, joint: Data) -> np.ndarray:
    """Return the place of a joint in the frame of the body's own parent."""
    body = here.copies[index]
    about = Rotation.from_euler("z", body.turn_deg, degrees=True).as_matrix()
    return reflected_if(about @ np.array(joint["at"], float), body.mirror)


def _written(here: Posed, index: int, at: np.ndarray) -> np.ndarray:
    """Return the place of a joint as written in the entry, the inverse of `_at`."""
    body = here.copies[index]
    about = Rotation.from_euler("z", -body.turn_deg, degrees=True).as_matrix()
    return about @ reflected_if(at, body.mirror)
