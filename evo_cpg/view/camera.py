"""A calm camera: it follows the smoothed middle of the animal from behind and above.

Without a light, the camera looks at the animal's side. Other cameras look from a fixed bearing to
the animal's course, from the side or from above. One camera circles the animal once.

The whole recording is known before the first frame. So the path is smoothed with a symmetric
window, which does not lag. The distance is fixed, and so is the viewing direction, except for the
circling camera. So everything that moves in the picture moves in the world.

The distance is the smallest at which a sphere around the focus fits the width of the frame, and is
at most 1.5 times as high as the frame. The sphere holds every body: at every instant if there is a
light, and in half of the instants without one. The distance then grows until every body is inside
the frame.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

# Half-width of the Gaussian window, s: longer than a tail beat, shorter than a turn.
SMOOTHING = 0.8
VIEW_ANGLE = 32.0
# Largest angle at which the camera sees the sphere around the animal, in angles of view. The sphere
# may exceed the frame, because the animal is flatter. The camera is therefore closer.
_FILL = 1.5
# The focus lies this fraction of the animal's radius further towards the goal. Without a goal the
# focus lies further along the path.
_LEAD, _LEAD_UNLIT = 0.6, 0.4
# Angles to try between the line of sight and the direction of the goal, best first, on either side.
# The first ones show the goal, but not from right behind the animal. The last ones keep the eye
# away from a goal that the animal reaches.
_BEARINGS = np.radians([32.0, 62.0, 90.0, 130.0, 180.0])
# The same angle without a goal. The animal crosses the picture to the right, and shows its side and
# a little of its front.
_SIDE = np.radians(112.0)
# Cameras with a fixed side: angle between the line of sight and the course, and elevation of the
# eye. The animal crosses the picture to the right. The side camera is low, but not along the
# ground. The top camera is a little less than upright, so that the picture has an upper edge.
_SIDEWAYS = np.radians(90.0)
_ASPECTS = {"side": np.radians(4.0), "top": np.radians(88.0)}
# Elevation of the circling camera, which shows the ground behind the animal and the horizon.
_AROUND = np.radians(14.0)
CAMERAS = ("follow", *_ASPECTS, "orbit")
# Points along a line of sight that are tested against obstacles, and number of frames tested.
_SAMPLES, _VIEWPOINTS = 24, 60


class CameraPath(NamedTuple):
    """Place and direction of the camera in every frame.

    Attributes:
        position: position of the eye ``(frames, 3)``, m.
        focus: point at which the camera looks ``(frames, 3)``, m.
        view_angle: full vertical angle of view, degrees.
    """

    position: Float[np.ndarray, "frames 3"]
    focus: Float[np.ndarray, "frames 3"]
    view_angle: float


def follow(
    position: Float[np.ndarray, "frames bodies 3"],
    goal: Float[np.ndarray, "3"],
    reach: float,
    rate: float,
    aspect: float,
    elevation: float,
    turn: float | Float[np.ndarray, " frames"] | None = None,
) -> CameraPath:
    """Plan the camera's path over a recording.

    Args:
        position: centres of the bodies ``(frames, bodies, 3)``, m.
        goal: place of the light ``(3,)``, m, or NaN without a light.
        reach: largest distance from a body's centre to its surface, m.
        rate: frames per second of recorded time.
        aspect: width of the picture over its height.
        elevation: height of the eye above the focus as an angle, rad.
        turn: angle between the line of sight and the animal's course, rad, with a value per frame
            if it changes. None for a camera that shows the light, or the animal's side if there is
            no light.
    """
    centre = smooth(position.mean(1), SMOOTHING * rate)
    radius = np.linalg.norm(position - centre[:, None], axis=-1).max() + reach
    lit = bool(np.isfinite(goal).all())
    bearing = course(centre, goal, radius / 10)
    if not lit:
        # Place a goal so far ahead that the animal never reaches it.
        goal = centre.mean(0) + 1e3 * (radius + np.ptp(centre)) * _direction(bearing, 0.0)
    ahead = goal - centre
    away = np.linalg.norm(ahead, axis=-1, keepdims=True)
    # A camera that circles the animal keeps it in the middle.
    reached = 0.0 if isinstance(turn, np.ndarray) else _LEAD if lit else _LEAD_UNLIT
    lead = ahead * (reached * radius / np.maximum(away, 2 * radius))
    focus = smooth(centre + lead, SMOOTHING * rate)
    # An animal that leaps may come near the edge of the frame, so that it is not always small.
    spread = np.linalg.norm(position - focus[:, None], axis=-1).max(1)
    radius = (spread.max() if lit else np.median(spread)) + reach

    half = np.radians(VIEW_ANGLE / 2)
    distance = radius / np.sin(min(half * _FILL, np.arctan(aspect * np.tan(half))))
    if turn is not None:
        sight = _direction(bearing + turn, elevation)
    elif lit:
        sight = _sight_of_goal(position, focus, goal, distance, bearing, elevation)
    else:
        sight = _direction(bearing + _SIDE, elevation)
    path = CameraPath(focus - distance * sight, focus, VIEW_ANGLE)
    # Perspective enlarges near bodies. Step back until every body is inside the frame.
    while (overshoot := _overshoot(path, position, reach, aspect)) > 1:
        path = path._replace(position=focus + (path.position - focus) * min(overshoot, 1.5) * 1.02)
    return path


def aspect_of(
    camera: str, frames: int = 1
) -> tuple[float | Float[np.ndarray, " frames"], float] | None:
    """Return turn and elevation of a camera, rad, or None for the following camera.

    Args:
        camera: one of `CAMERAS`.
        frames: number of frames of the film. A circling camera has a turn for each frame.

    Raises:
        ValueError: no camera has this name.
    """
    if camera not in CAMERAS:
        raise ValueError(f"camera is {camera!r}. Allowed: {', '.join(CAMERAS)}")
    if camera == "orbit":
        return _SIDE + 2 * np.pi * np.arange(frames) / frames, _AROUND
    return (_SIDEWAYS, _ASPECTS[camera]) if camera in _ASPECTS else None


def hidden(
    path: CameraPath,
    points: Float[np.ndarray, "frames n 3"],
    height: Callable[[np.ndarray], np.ndarray],
    margin: float,
) -> float:
    """Return the fraction of points, over all frames, that something solid hides.

    Args:
        path: the camera of every frame.
        points: observed points ``(frames, n, 3)``, m.
        height: function that returns the height of solid things, m, at x and y ``(..., 2)``.
        margin: least height of a line of sight above solid things at the camera, m. The margin
            falls to 0 at the points.
    """
    every = max(len(points) // _VIEWPOINTS, 1)
    points, eye = points[::every], path.position[::every, None]
    # Leave out the start of the line: a point may itself be within a stone or the ground.
    along = np.linspace(0.1, 1.0, _SAMPLES)[:, None, None]
    line = points + along[..., None] * (eye - points)
    free = line[..., 2] - height(line[..., :2]) >= margin * along
    return float((~free.all(0)).mean())


def course(
    centre: Float[np.ndarray, "frames 3"], goal: Float[np.ndarray, "3"], least: float
) -> float:
    """Return the bearing of the goal, or of the final position, from the initial position, rad.

    The bearing is the angle from the x axis, positive to the left.

    Args:
        centre: centre of the animal ``(frames, 3)``, m.
        goal: place of the light ``(3,)``, m, or NaN without a light.
        least: shortest distance with a bearing, m. If the distance is not longer, 0 is returned.
    """
    east, north, _ = (goal if np.isfinite(goal).all() else centre[-1]) - centre[0]
    return float(np.arctan2(north, east)) if np.hypot(east, north) > least else 0.0


def project(
    path: CameraPath, points: Float[np.ndarray, "frames n 3"], aspect: float
) -> Float[np.ndarray, "frames n 2"]:
    """Return the places of points in the picture.

    Args:
        path: the camera of every frame.
        points: points in the world ``(frames, n, 3)``, m.
        aspect: width of the picture over its height.

    Returns:
        ``(frames, n, 2)``: right and up, -1 to 1 between the edges of the frame, or NaN for points
        behind the camera.
    """
    right, up, ahead = _axes(path)
    offset = points - path.position[:, None]
    depth = np.einsum("fni,fi->fn", offset, ahead)
    scale = np.tan(np.radians(path.view_angle / 2)) * np.where(depth > 0, depth, np.nan)
    x = np.einsum("fni,fi->fn", offset, right) / (scale * aspect)
    y = np.einsum("fni,fi->fn", offset, up) / scale
    return np.stack([x, y], -1)


def turned_about_vertical(vector: Float[np.ndarray, "3"], angle: float) -> Float[np.ndarray, "3"]:
    """Return a vector, turned to the left as seen from above.

    Args:
        vector: vector before the turn.
        angle: angle of the turn, rad.
    """
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1], vector[2]])


def level_axes(sight: Float[np.ndarray, "3"]) -> tuple[np.ndarray, np.ndarray]:
    """Return level unit vectors to the right and ahead in the picture ``(3,)``."""
    ahead = np.array([sight[0], sight[1], 0.0]) / np.hypot(*sight[:2])
    return np.cross(ahead, [0.0, 0.0, 1.0]), ahead


def smooth(path: Float[np.ndarray, "frames 3"], width: float) -> Float[np.ndarray, "frames 3"]:
    """Return the Gaussian average of a path ``(frames, 3)`` without lag.

    Args:
        path: one point for each frame.
        width: standard deviation of the window, frames.

    The ends are continued by point reflection, so a steady motion stays steady there.
    """
    reach = min(int(3 * width), len(path) - 1)
    if reach < 1:
        return path.copy()
    window = np.exp(-0.5 * (np.arange(-reach, reach + 1) / width) ** 2)
    window /= window.sum()
    extended = np.pad(path, ((reach, reach), (0, 0)), "reflect", reflect_type="odd")
    return np.column_stack([np.convolve(column, window, "valid") for column in extended.T])


def _sight_of_goal(
    position: np.ndarray,
    focus: np.ndarray,
    goal: np.ndarray,
    distance: float,
    bearing: float,
    elevation: float,
) -> np.ndarray:
    """Return a line of sight that shows the goal but keeps the eye away from it."""
    sights = [
        _direction(bearing + sign * turn, elevation) for turn in _BEARINGS for sign in (1, -1)
    ]
    clearance = [np.linalg.norm(focus - distance * s - goal, axis=-1).min() for s in sights]
    # Choose the first pair in which one sight keeps the eye well clear of the light, else the
    # clearest sight. From a pair, choose the sight that shows more of the animal's side.
    free = [i for i, gap in enumerate(clearance) if gap > distance / 2]
    first = free[0] // 2 * 2 if free else int(np.argmax(clearance))
    pair = [i for i in (first, first + 1) if i in free] or [first]
    return max((sights[i] for i in pair), key=lambda s: _apparent_width(position, s))


def _direction(
    bearing: float | Float[np.ndarray, " frames"], elevation: float
) -> Float[np.ndarray, "*frames 3"]:
    """Return unit vectors that point along bearings and down by an elevation."""
    flat, down = np.cos(elevation), np.full(np.shape(bearing), -np.sin(elevation))
    return np.stack([flat * np.cos(bearing), flat * np.sin(bearing), down], -1)


def _apparent_width(position: np.ndarray, sight: np.ndarray) -> float:
    """Return the mean extent of the animal across a line of sight, m."""
    across = np.cross(sight, [0.0, 0.0, 1.0])
    return float(np.ptp(position @ across, axis=1).mean())


def _axes(path: CameraPath) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return unit vectors ``(frames, 3)`` to the right, up and ahead in the picture."""
    ahead = path.focus - path.position
    ahead = ahead / np.linalg.norm(ahead, axis=-1, keepdims=True)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right = right / np.linalg.norm(right, axis=-1, keepdims=True)
    return right, np.cross(right, ahead), ahead


def _overshoot(path: CameraPath, position: np.ndarray, reach: float, aspect: float) -> float:
    """Return the bodies' largest picture coordinate, which exceeds 1 outside the frame."""
    # Cubes around the bodies, aligned with the line of sight, for any heading of the animal.
    corners = reach * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    offset = corners @ np.stack(_axes(path), 1)
    points = (position[:, :, None] + offset[:, None]).reshape(len(position), -1, 3)
    place = np.abs(project(path, points, aspect))
    return float(np.nan_to_num(place, nan=np.inf).max())
