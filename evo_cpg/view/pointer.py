"""An arrow at the edge of the picture that points to a goal outside it."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from evo_cpg.view.camera import CameraPath, in_camera
from evo_cpg.view.legible import lettering, write
from evo_cpg.view.look import Look

# Places of the arrow's tip, from the middle to the edges: sideways, down and up. The captions are
# below.
_SIDEWAYS, _DOWN, _UP = 0.93, 0.6, 0.88
# Length and half width of the arrow, and height of the letters, as fractions of the picture's
# height.
_LENGTH, _HALF_WIDTH, _LETTERS = 0.055, 0.026, 0.032
# Colours of the arrow and of its rim.
_COLOR, _RIM = "#ffd37a", "#4a3a12"


def pointer(
    camera: CameraPath,
    goal: Float[np.ndarray, "3"] | None,
    look: Look,
    size: tuple[int, int],
    name: str = "light",
) -> Callable[[np.ndarray, int], None]:
    """Return a function that draws the arrow into a frame, if the goal is outside of it.

    Args:
        camera: the camera in every frame.
        goal: place of the goal, m, or None without a goal.
        look: look of the world.
        size: width and height of the picture, pixels.
        name: word beside the arrow.

    Returns:
        A function of a picture, bytes ``(height, width, 3)``, bottom row first, and its number.
    """
    if goal is None:
        return lambda picture, number: None
    width, height = size
    tips = edge_places(camera, goal, width / height)

    def draw_into(picture: np.ndarray, number: int) -> None:
        tip = tips[number]
        if not np.isfinite(tip).all():
            return
        outwards = tip * [width / 2, -height / 2]
        place = outwards + np.array([width, height]) / 2
        # A light right behind the camera has no direction, and the arrow points down.
        along = outwards / np.linalg.norm(outwards) if outwards.any() else np.array([0.0, 1.0])
        across = np.array([-along[1], along[0]])
        back, side = place - _LENGTH * height * along, _HALF_WIDTH * height * across
        with lettering(picture) as draw:
            corners = [tuple(map(float, corner)) for corner in (place, back + side, back - side)]
            draw.polygon(corners, fill=_COLOR, outline=_RIM)
            words = back - 0.9 * _LETTERS * height * along
            anchor = ("r" if along[0] > 0.4 else "l" if along[0] < -0.4 else "m") + "m"
            where = float(words[0]), float(words[1])
            # Lines on the floor do not cross the word.
            write(
                draw, name, where, _LETTERS * height, look.text,
                bold=False, anchor=anchor, plate=look.distance,
            )  # fmt: skip

    return draw_into


def edge_places(
    camera: CameraPath, goal: Float[np.ndarray, "3"], aspect: float
) -> Float[np.ndarray, "frames 2"]:
    """Return the places of the arrow's tip, or NaN where the light is in the picture.

    Args:
        camera: the camera in every frame.
        goal: place of the light, m.
        aspect: width of the picture over its height.

    Returns:
        Right and up, from -1 to 1 between the edges of the frame.
    """
    right, up, depth = in_camera(camera, goal[None, None])[:, 0].T
    half = np.tan(np.radians(camera.view_angle / 2))
    # Behind the camera, only the direction counts.
    scale = half * np.where(depth > 0, depth, 1e-9)
    place = np.stack([right / (scale * aspect), up / scale], -1)
    limit = np.where(place[:, 1:] < 0, _DOWN, _UP)
    beyond = np.maximum(np.abs(place[:, :1]) / _SIDEWAYS, np.abs(place[:, 1:]) / limit)
    seen = (np.abs(place) < 1).all(-1, keepdims=True) & (depth > 0)[:, None]
    return np.where(seen, np.nan, place / np.maximum(beyond, 1.0))
