"""A calm camera: it follows the smoothed middle of the animal from behind and above.

Without a light, the camera looks at the animal's side. Other cameras look from a fixed bearing to
the animal's course, from the side or from above. One camera circles the animal once.

The whole recording is known before the first frame. So the path is smoothed with a symmetric
window, which does not lag. The distance is fixed, and so is the viewing direction, except for the
circling camera. So everything that moves in the picture moves in the world.

The distance lets the animal fill two fifths of the frame's width in half of the frames. It then
grows until every body is inside the frame, above the captions.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

# Half-width of the Gaussian window, s: longer than a tail beat, shorter than a turn.
SMOOTHING = 0.8
VIEW_ANGLE = 32.0
# Fraction of the frame's width that the animal fills in half of the frames, or of its height if the
# animal is tall. A frame that is taller than wide is filled more.
_FILL, _FILL_HEIGHT, _FILL_TALL = 0.42, 0.5, 0.6
# Part of the frame for the animal, from -1 to 1 between its edges: sideways, down and up. The
# captions are lower, in the corners.
_ROOM, _BELOW, _ABOVE = 0.95, 0.8, 0.92
# Room around the light, as a factor of its place.
_APART = 1.1
# Least fraction of the width, below which the first frame need not show the light: of a film, and
# of a close view.
_SMALLEST, _SMALLEST_CLOSE = 0.2, 0.35
# Number of frames, or up to twice as many, in which the animal's extent is measured, and rounds of
# improvement.
_MEASURED, _ROUNDS = 120, 5
# Factor of the distance by which the camera steps back from bodies outside of the frame.
_STEP_BACK = 1.05
# The focus lies this fraction of the animal's radius further towards the light, until the animal is
# near the light.
_LEAD = 0.6
# Angles to try between the line of sight and the direction of the goal, on either side. None is
# from right behind the animal. The last ones keep the eye away from a goal that the animal reaches.
_BEARINGS = np.radians([32.0, 47.0, 62.0, 90.0, 130.0, 180.0])
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
# The camera of an overview: angle between the line of sight and the way of the animals.
ACROSS = np.radians(68.0)
# Upper end of the part of the frame for an overview.
_ABOVE = 0.86
# Largest distance of an overview, in lengths of what it shows, and number of halvings of the
# interval in which its least distance lies. Number of shifts that bring the points into the middle.
_FARTHEST, _HALVINGS, _SHIFTS = 12.0, 14, 24
# Two distances are alike if they differ by less than this fraction.
_ALIKE = 0.02
# A camera that comes nearer: half-width of its window, s, and nearest relative distance.
_CALM, _NEAREST = 0.8, 0.5
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


class BodyBoxes(NamedTuple):
    """Boxes around all bodies in every frame.

    Attributes:
        position: centres of the bodies, m.
        rotation: rotations from body to world.
        half_extents: half edges of the box around each body, m.
    """

    position: Float[np.ndarray, "frames b 3"]
    rotation: Float[np.ndarray, "frames b 3 3"]
    half_extents: Float[np.ndarray, "b 3"]

    def corners(self) -> Float[np.ndarray, "frames corners 3"]:
        """Return the corners of the boxes, m."""
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        own = signs * self.half_extents[:, None]
        found = self.position[:, :, None] + np.einsum("fbij,bkj->fbki", self.rotation, own)
        return found.reshape(len(self.position), -1, 3)


def follow(
    bodies: BodyBoxes,
    goal: Float[np.ndarray, "*t 3"],
    rate: float,
    aspect: float,
    elevation: float,
    turn: float | Float[np.ndarray, " frames"] | None = None,
    close: bool = False,
) -> CameraPath:
    """Plan the camera's path over a recording.

    Args:
        bodies: places and sizes of the bodies in every frame.
        goal: place of the light, in every frame if it moves, m, or NaN without a light.
        rate: frames per second of recorded time.
        aspect: width of the picture over its height.
        elevation: height of the eye above the focus as an angle, rad.
        turn: angle between the line of sight and the animal's course, rad, with a value per frame
            if it changes. None for a camera that shows the light or, if there is none, the
            animal's side.
        close: whether the animal shall be large and go to the right, perhaps without the light.
    """
    position = bodies.position
    centre = smooth(position.mean(1), SMOOTHING * rate)
    far = np.linalg.norm(position - centre[:, None], axis=-1)
    radius = float((far + np.linalg.norm(bodies.half_extents, axis=-1)).max())
    lit = bool(np.isfinite(goal).all())
    first_goal = np.atleast_2d(goal)[0]
    bearing = course(centre, first_goal, radius / 10)
    focus = centre
    # A camera that circles the animal keeps it in the middle.
    if lit and not isinstance(turn, np.ndarray):
        ahead = goal - centre
        away = np.linalg.norm(ahead, axis=-1, keepdims=True)
        focus = centre + ahead * (_LEAD * radius / np.maximum(away, 2 * radius))
    focus = smooth(focus, SMOOTHING * rate)
    first, points = radius / np.sin(np.radians(VIEW_ANGLE / 2)), bodies.corners()

    def seen(turned: float | np.ndarray, *more: np.ndarray) -> CameraPath:
        """Return a path at the distance at which the animal fills its part of the frame."""
        sight = _direction(bearing + turned, elevation)
        path = CameraPath(focus - first * sight, focus, VIEW_ANGLE)
        wide, high = _FILL if aspect >= 1 else _FILL_TALL, _FILL_HEIGHT
        # A circling camera does not move across the line of sight.
        moves = not isinstance(turned, np.ndarray)
        for _ in range(_ROUNDS):
            place = _thinly(path, points, aspect)
            at_first = project(path, np.array(more).reshape(1, -1, 3), aspect)[0] * _APART
            every = np.concatenate([place.reshape(-1, 2), at_first])
            if not np.isfinite(every).all():
                # Points behind the camera: step back.
                path = _moved(path, 2.0, np.zeros(2), aspect)
                continue
            low, most = every.min(0), every.max(0)
            off = (low + most) / 2 - [0.0, (_ABOVE - _BELOW) / 2] if moves else np.zeros(2)
            across, upright = np.median(np.ptp(place, axis=1) / 2, axis=0)
            beyond = (most - low) / [2 * _ROOM, _ABOVE + _BELOW]
            if not moves:
                beyond = np.maximum(-low / [_ROOM, _BELOW], most / [_ROOM, _ABOVE])
            path = _moved(path, max(across / wide, upright / high, *beyond), off, aspect)
        return path

    best = None
    if turn is not None or not lit:
        best = seen(_SIDE if turn is None else turn)
    else:
        turns = [sign * angle for angle in _BEARINGS for sign in ((1,) if close else (1, -1))]
        # The first picture shows the light, too, unless the animal would be small in it. Then a
        # close animal goes across the picture, towards the arrow at its edge.
        for tried, more in ((turns, (first_goal,)), ([_SIDEWAYS] if close else turns, ())):
            clear, widths = [], []
            for turned in tried:
                path = seen(turned, *more)
                away = np.linalg.norm(path.focus[0] - path.position[0])
                # The eye keeps away from the goal.
                if np.linalg.norm(path.position - goal, axis=-1).min() > away / 2:
                    clear.append(path)
                    place = _thinly(path, points, aspect)
                    widths.append(np.median(np.ptp(place, axis=1) / 2, axis=0)[0])
            if clear:
                largest = max(range(len(clear)), key=widths.__getitem__)
                best = clear[largest]
                if not widths[largest] < (_SMALLEST_CLOSE if close else _SMALLEST):
                    break
    path = best or seen(_BEARINGS[-1])
    # Step back until every point is inside the frame at every instant.
    while not np.abs(np.nan_to_num(project(path, points, aspect), nan=np.inf)).max() < 1:
        path = _moved(path, _STEP_BACK, np.zeros(2), aspect)
    return path


def overview(
    points: Float[np.ndarray, "n 3"],
    bearing: float,
    elevation: float,
    aspect: float,
    view_angle: float = VIEW_ANGLE,
) -> CameraPath:
    """Return one frame of a camera that is turned to one side and shows some points.

    Args:
        points: the points, m.
        bearing: direction in which the animals go, from the x axis, rad. It runs from the lower
            left to the upper right of the picture.
        elevation: height of the eye above the focus as an angle, rad.
        aspect: width of the picture over its height.
        view_angle: full vertical angle of view, degrees.
    """
    sight = _direction(bearing + ACROSS, elevation)
    middle = (points.min(0) + points.max(0)) / 2
    far = _FARTHEST * float(np.linalg.norm(np.ptp(points, axis=0)))
    near, best = 0.0, None
    for _ in range(_HALVINGS + 1):
        # From the largest distance, all points are in the frame.
        half = far if best is None else (near + far) / 2
        path = CameraPath((middle - half * sight)[None], middle[None], view_angle)
        for _ in range(_SHIFTS):
            place = project(path, points[None], aspect)[0]
            if not np.isfinite(place).all():
                break
            low, most = place.min(0), place.max(0)
            off = (low + most) / 2 - [0.0, (_ABOVE - _BELOW) / 2]
            # A full shift would overshoot for points farther away than the focus.
            path = _moved(path, 1.0, off / 2, aspect)
        place = np.nan_to_num(project(path, points[None], aspect)[0], nan=np.inf)
        if ((place > [-_ROOM, -_BELOW]) & (place < [_ROOM, _ABOVE])).all():
            far, best = half, path
        else:
            near = half
    assert best is not None
    return best


def zoomed(path: CameraPath, bodies: BodyBoxes, rate: float) -> CameraPath:
    """Return a camera that comes as much nearer as the animal is smaller than at its largest.

    Args:
        path: camera that follows the animal.
        bodies: places and sizes of the bodies in every frame.
        rate: frames per second of recorded time.
    """
    away = np.linalg.norm(bodies.corners() - path.focus[:, None], axis=-1).max(1)
    # The camera steps back before the animal grows.
    around = np.pad(away, round(2 * _CALM * rate), "edge")
    away = np.lib.stride_tricks.sliding_window_view(around, len(around) - len(away) + 1).max(-1)
    part = smooth(np.maximum(away / away.max(), _NEAREST)[:, None], _CALM * rate)
    return path._replace(position=path.focus + part * (path.position - path.focus))


def between(
    before: CameraPath, after: CameraPath, weight: Float[np.ndarray, " frames"]
) -> CameraPath:
    """Return a camera that moves from one camera to another one, gently to the eye.

    The distance grows or shrinks by equal factors in equal parts. The focus moves as the distance
    changes, so that the picture is scaled about one of its points. The line of sight turns.

    Args:
        before: camera at weight 0, of one frame or as many as there are weights.
        after: camera at weight 1.
        weight: weight of the second camera in every frame.
    """
    part = weight[:, None]
    back = [path.position - path.focus for path in (before, after)]
    away = [np.linalg.norm(each, axis=-1, keepdims=True) for each in back]
    far = away[0] ** (1 - part) * away[1] ** part
    change = away[1] - away[0]
    alike = np.abs(change) < _ALIKE * away[0]
    moved = np.where(alike, part, (far - away[0]) / np.where(alike, 1.0, change))
    focus = (1 - moved) * before.focus + moved * after.focus
    sight = (1 - part) * back[0] / away[0] + part * back[1] / away[1]
    sight /= np.linalg.norm(sight, axis=-1, keepdims=True)
    return CameraPath(focus + far * sight, focus, before.view_angle)


def _moved(
    path: CameraPath, factor: float, off: Float[np.ndarray, "2"], aspect: float
) -> CameraPath:
    """Return the camera at a multiple of its distance, with another point in the middle.

    Args:
        path: the camera.
        factor: new distance from the focus over the present one.
        off: place in the picture that comes into the middle: right and up, from -1 to 1.
        aspect: width of the picture over its height.
    """
    right, up, _ = _axes(path)
    back = path.position - path.focus
    half = np.tan(np.radians(path.view_angle / 2)) * np.linalg.norm(back, axis=-1, keepdims=True)
    aside = half * (off[0] * aspect * right + off[1] * up)
    return path._replace(position=path.focus + aside + back * factor, focus=path.focus + aside)


def _thinly(path: CameraPath, points: np.ndarray, aspect: float) -> np.ndarray:
    """Return the places of points in the picture, in some of the frames."""
    every = max(len(points) // _MEASURED, 1)
    few = CameraPath(path.position[::every], path.focus[::every], path.view_angle)
    return project(few, points[::every], aspect)


def aspect_of(
    camera: str, frames: int = 1
) -> tuple[float | Float[np.ndarray, " frames"], float] | None:
    """Return turn and elevation of one of `CAMERAS`, rad, or None for the following camera.

    A circling camera has a turn for each frame.

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
        points: observed points, m.
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
    path: CameraPath, points: Float[np.ndarray, "#frames n 3"], aspect: float
) -> Float[np.ndarray, "frames n 2"]:
    """Return the places of points in the picture.

    Args:
        path: the camera of every frame.
        points: points in the world ``(frames, n, 3)``, m, or ``(1, n, 3)`` if they rest.
        aspect: width of the picture over its height.

    Returns:
        ``(frames, n, 2)``: right and up, -1 to 1 between the edges of the frame, or NaN for points
        behind the camera.
    """
    right, up, depth = np.moveaxis(in_camera(path, points), -1, 0)
    scale = np.tan(np.radians(path.view_angle / 2)) * np.where(depth > 0, depth, np.nan)
    return np.stack([right / (scale * aspect), up / scale], -1)


def in_camera(
    path: CameraPath, points: Float[np.ndarray, "#frames n 3"]
) -> Float[np.ndarray, "frames n 3"]:
    """Return points in the camera's frame: to the right, up and ahead, m."""
    axes = np.stack(_axes(path), 1)
    return np.einsum("fni,fki->fnk", points - path.position[:, None], axes)


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


def smooth(path: Float[np.ndarray, "frames k"], width: float) -> Float[np.ndarray, "frames k"]:
    """Return the Gaussian average of a path ``(frames, k)`` without lag.

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


def _direction(
    bearing: float | Float[np.ndarray, " frames"], elevation: float
) -> Float[np.ndarray, "*frames 3"]:
    """Return unit vectors that point along bearings and down by an elevation."""
    flat, down = np.cos(elevation), np.full(np.shape(bearing), -np.sin(elevation))
    return np.stack([flat * np.cos(bearing), flat * np.sin(bearing), down], -1)


def _axes(path: CameraPath) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return unit vectors ``(frames, 3)`` to the right, up and ahead in the picture."""
    ahead = path.focus - path.position
    ahead = ahead / np.linalg.norm(ahead, axis=-1, keepdims=True)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right = right / np.linalg.norm(right, axis=-1, keepdims=True)
    return right, np.cross(right, ahead), ahead
