"""A scene in front of a camera: shared data for drawing every part of a picture."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pyvista as pv
from jaxtyping import Float

from evo_cpg.view.camera import BodyBoxes, CameraPath, aspect_of, follow, hidden
from evo_cpg.view.look import Look, sun_direction
from evo_cpg.view.scene import Clip, Scene
from evo_cpg.view.terrain import Level, Terrain, heights, obstacle_top

# Elevations of the camera to try in turn if something hides the animal, rad. Least height above the
# ground, in radii of the animal. Fraction of all bodies and instants that may be hidden, because
# stones that pass in front show their distance.
_ELEVATIONS, _CLEARANCE, _HIDDEN = np.radians([16.0, 22.0, 28.0, 35.0, 45.0]), 0.3, 0.03
# Elevation for a swimmer that bends sideways, rad: more sideways than upwards by this factor.
_FROM_ABOVE, _SIDEWAYS = np.radians(38.0), 2.0
# Height of a camera under water, from 0 at the ground to 1 at the surface. Rounds of improvement.
_DEPTH, _ROUNDS = 0.7, 2
# The mesh of the ground ends this many visibilities from the path, where it has faded to nothing.
_HORIZON = 2.4
# A camera far away from a crowd sees at least this many of its distances.
_IN_VIEW = 0.9
# Things on the ground are lifted by this fraction of the animal's radius.
_LIFT = 0.008


class Shot(NamedTuple):
    """One frame: the pose of the animal, and the camera.

    Attributes:
        position: centres of the bodies, m.
        rotation: rotations from bodies to world.
        number: number of the frame.
        time: time of the recording, s.
        focus: point at which the camera looks, m.
        eye: place of the camera, m.
        turned: turn of the camera about the vertical since the first frame, rad.
    """

    position: Float[np.ndarray, "b 3"]
    rotation: Float[np.ndarray, "b 3 3"]
    number: int
    time: float
    focus: Float[np.ndarray, "3"]
    eye: Float[np.ndarray, "3"]
    turned: float


# Function that updates a part of the picture.
Update = Callable[[Shot], None]


class Stage:
    """A scene and its camera, ready for drawing.

    Args:
        plotter: plotter of the picture.
        scene: the animal and its world.
        camera: camera in every frame.
        oversampling: pixels rendered per pixel of the film, along a side.
        wide: whether the camera stands far away from a crowd, so that the ground reaches farther.

    Attributes:
        look: look of the world.
        radius: radius of the animal, m.
        lift: height of things that lie on the ground, m.
        away: largest distance of the camera from its focus, m.
        visible: distance at which the ground has faded to a third, m.
        ground: ground for drawing: level, or a mesh of heights up to the horizon.
        measured: whether a moving animal's path is measured on the ground that carries it.
        sight: direction of view in the first frame.
        sun: unit vector towards the sun.
    """

    def __init__(
        self,
        plotter: pv.Plotter,
        scene: Scene,
        camera: CameraPath,
        oversampling: float = 1.0,
        wide: bool = False,
    ):
        self.plotter, self.scene, self.camera = plotter, scene, camera
        self.oversampling, self.wide = oversampling, wide
        self.look: Look = scene.look
        self.radius, self.lift = scene.radius, _LIFT * scene.radius
        sights = camera.focus - camera.position
        self.away = float(np.linalg.norm(sights, axis=-1).max())
        near = self.look.visibility * self.radius
        self.visible = max(near, _IN_VIEW * self.away) if wide else near
        far, level = _HORIZON * self.visible, scene.level
        self.ground: Level | Terrain = scene.terrain(far) if level is None else Level(level)
        self.measured = scene.stands and len(scene.clip.time) > 1
        self.sight: Float[np.ndarray, 3] = sights[0] / np.linalg.norm(sights[0])
        self.sun = sun_direction(self.look, self.sight)
        turned = np.arctan2(sights[:, 1], sights[:, 0]) - np.arctan2(self.sight[1], self.sight[0])
        self._turned = np.where(np.abs(np.sin(turned / 2)) < 1e-9, 0.0, turned)

    def shot(self, number: int) -> Shot:
        """Return the animal's pose and the camera in a frame."""
        clip, camera = self.scene.clip, self.camera
        return Shot(
            clip.position[number],
            clip.rotation[number],
            number,
            float(clip.time[number]),
            camera.focus[number],
            camera.position[number],
            float(self._turned[number]),
        )


def camera_path(scene: Scene, camera: str, aspect: float, close: bool = False) -> CameraPath:
    """Plan a camera that sees the animal in all frames, above things that would hide it.

    Args:
        scene: the animal and its world.
        camera: one of `evo_cpg.view.camera.CAMERAS`.
        aspect: width of the picture over its height.
        close: whether the animal shall be large, go to the right and show how it bends, perhaps
            without the light.
    """
    look, clip, ground, surface = scene.look, scene.clip, scene.ground, scene.surface
    first, turn = look.side_elevation if scene.goal is None else look.elevation, None
    if (given := aspect_of(camera, len(clip.time))) is not None:
        turn, first = given
    if close and not scene.stands and bends_sideways(clip):
        first = max(first, _FROM_ABOVE)
    goal = np.full(3, np.nan) if scene.goal is None else scene.goal
    bodies = BodyBoxes(clip.position, clip.rotation, scene.half_extents)

    def at(elevation: float) -> CameraPath:
        return follow(bodies, goal, clip.rate, aspect, elevation, turn, close)

    if look.under_water and surface is not None:
        # The camera is between the ground and the surface.
        path = at(0.0)
        for _ in range(_ROUNDS):
            eye, focus = path.position, path.focus
            low = heights(ground.floor, eye[:, :2])
            middle = low + _DEPTH * (surface - low)
            away = np.linalg.norm(eye - focus, axis=-1)
            path = at(float(np.arcsin(np.clip((middle - focus[:, 2]) / away, -0.5, 0.5)).mean()))
        return path
    path = at(first)
    if scene.level is not None:
        return path
    margin = _CLEARANCE * scene.radius

    def top(place: np.ndarray) -> np.ndarray:
        tops = [obstacle_top(obstacle, place) for obstacle in ground.obstacles]
        return np.maximum.reduce([heights(ground.floor, place), *tops])

    for elevation in _ELEVATIONS[first < _ELEVATIONS]:
        free = surface is None or (path.position[:, 2] > surface + margin).all()
        if isinstance(turn, np.ndarray):
            # A circling camera must stay above the ground all around.
            free = free and (path.position[:, 2] > top(path.position[:, :2]) + margin).all()
        if free and hidden(path, clip.position, top, margin) <= _HIDDEN:
            break
        path = at(elevation)
    return path


def bends_sideways(clip: Clip) -> bool:
    """Return whether bodies move sideways much more than up and down, about their middle."""
    middle = clip.position.mean(1)
    about = clip.position - middle[:, None]
    about = about - about.mean(0)
    course = middle[-1] - middle[0]
    across = np.array([-course[1], course[0]]) / max(float(np.hypot(*course[:2])), 1e-9)
    return bool((about[..., :2] @ across).std() > _SIDEWAYS * about[..., 2].std())
