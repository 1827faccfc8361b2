"""Words that stand above animals, and at the lines of a race, in the same size everywhere."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from PIL import ImageDraw

from evo_cpg.view.camera import CameraPath, project
from evo_cpg.view.legible import font, lettering, write
from evo_cpg.view.look import Look
from evo_cpg.view.scene import Scene

# Height of the letters and their distance from an animal, as fractions of the shorter side.
_LETTERS, _ABOVE = 0.034, 0.02
# Part of the picture for words, from -1 to 1 between its edges: sideways, down and up. The captions
# are lower.
_SIDEWAYS, _DOWN, _UP = 0.97, 0.62, 0.95
# Distance of the words at the lines from the lanes, in radii of the animal.
_BESIDE = 0.15


def name_tags(
    camera: CameraPath, scene: Scene, size: tuple[int, int]
) -> Callable[[np.ndarray, int], None]:
    """Return a function that writes names and distances of a race into a frame.

    Args:
        camera: the camera in every frame.
        scene: the animals and the lanes.
        size: width and height of the picture, pixels.

    Returns:
        A function of a picture, bytes ``(height, width, 3)``, bottom row first, and its number.
    """
    staging = scene.staging
    if staging is None:
        return lambda picture, number: None
    names, places = [*staging.names], _above_animals(camera, scene, len(staging.names), size)
    if (track := staging.track) is not None:
        beside, level = -track.right - _BESIDE * scene.radius, scene.level or 0.0
        lines = track.spacing * np.arange(1, track.lines + 1)
        spots = np.array([track.at(along, beside) for along in lines])
        spots[:, 2] = level
        names += [f"{along:g} m" for along in lines]
        seen = project(camera, spots[None].repeat(len(places), 0), size[0] / size[1])
        places = np.concatenate([places, seen], 1)

    def draw_into(picture: np.ndarray, number: int) -> None:
        opacity = np.ones(len(names))
        if staging.appear is not None:
            part = np.interp(number, staging.appear, (0.0, 1.0))
            opacity[: len(staging.names)] = part
        with lettering(picture) as draw:
            for name, place, shown in zip(names, places[number], opacity, strict=True):
                if name and shown > 0:
                    _write(draw, name, place, size, scene.look, float(shown))

    return draw_into


def _above_animals(
    camera: CameraPath, scene: Scene, count: int, size: tuple[int, int]
) -> Float[np.ndarray, "frames n 2"]:
    """Return the places above the first animals: right and up, from -1 to 1 between the edges."""
    bodies = scene.clip.position[:, None]
    if scene.ghosts is not None:
        bodies = np.concatenate([bodies, scene.ghosts.position], 1)
    bodies = bodies[:, :count]
    shape = bodies.shape[:3]
    seen = project(camera, bodies.reshape(shape[0], -1, 3), size[0] / size[1])
    seen = seen.reshape(*shape, 2)
    # The surface of a body is above its centre.
    away = np.linalg.norm(camera.position - camera.focus, axis=-1)
    thick = scene.half_extents.min(1).max()
    rise = thick / (np.tan(np.radians(camera.view_angle / 2)) * away)
    gap = 2 * _ABOVE * min(size) / size[1]
    return np.stack([seen[..., 0].mean(-1), seen[..., 1].max(-1) + rise[:, None] + gap], -1)


def _write(
    draw: ImageDraw.ImageDraw,
    name: str,
    place: Float[np.ndarray, "2"],
    size: tuple[int, int],
    look: Look,
    opacity: float,
) -> None:
    """Write a word on a plate, if it is in the part of the picture for words."""
    letters = _LETTERS * min(size)
    right, up = (place + 1) / 2 * size
    half = font(letters).getlength(name) / 2
    inside = half < right < size[0] - half and abs(place[0]) < _SIDEWAYS
    if np.isfinite(place).all() and inside and -_DOWN < place[1] < _UP:
        where = float(right), float(size[1] - up)
        write(
            draw, name, where, letters, look.text,
            opacity=opacity, anchor="ms", plate=look.distance,
        )  # fmt: skip
