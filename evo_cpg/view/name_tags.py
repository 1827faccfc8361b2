"""Words beside animals, and at the lines of a race, in the same size everywhere.

A word stands above, below, behind or ahead of its animal. For each take, the place is chosen that
has the fewest other words and animals in it. A word fades out while it would cross another one.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from evo_cpg.view.camera import CameraPath, project, smooth
from evo_cpg.view.legible import font, lettering, write
from evo_cpg.view.scene import Scene

# Height of the letters and their distance from an animal, as fractions of the shorter side.
_LETTERS, _GAP = 0.034, 0.012
# Half height of a word and its margin sideways, in the height of its letters.
_HIGH, _MARGIN = 0.7, 0.4
# Part of the picture for words, from -1 to 1 between its edges: sideways, down and up. The captions
# are lower.
_SIDEWAYS, _DOWN, _UP = 0.97, 0.62, 0.95
# Half width of the window over which the place of a word is averaged, and time in which it fades,
# in frames.
_STEADY, _FADE = 5.0, 6.0
# Costs of a place in a frame: outside of the picture, across another word, and on each body. Each
# place costs this much more than the one before.
_OUTSIDE, _CROSSED, _ON_BODY, _LATER = 2.0, 4.0, 1.0, 0.02
# Distance of the words at the lines from the lanes, in radii of the animal.
_BESIDE = 0.15


class Tag(NamedTuple):
    """A word at its place in every frame.

    Attributes:
        name: the word.
        middle: middle of the word, pixels to the right and up.
        half: half width and half height, pixels.
        opacity: opacity in every frame, 0 to 1.
    """

    name: str
    middle: Float[np.ndarray, "frames 2"]
    half: Float[np.ndarray, "2"]
    opacity: Float[np.ndarray, " frames"]


def name_tags(
    camera: CameraPath, scene: Scene, size: tuple[int, int], shared: tuple[int, int] = (0, 0)
) -> Callable[[np.ndarray, int], None]:
    """Return a function that writes names and distances of a race into a frame.

    Args:
        camera: the camera in every frame.
        scene: the animals and the lanes.
        size: width and height of the picture, pixels.
        shared: numbers of first and last frames without words, because other takes share them.

    Returns:
        A function of a picture, bytes ``(height, width, 3)``, bottom row first, and its number.
    """
    tags = placed_tags(camera, scene, size)
    letters, look = _LETTERS * min(size), scene.look
    begin, end = shared[0], len(scene.clip.time) - 1 - shared[1]

    def draw_into(picture: np.ndarray, number: int) -> None:
        part = min(1.0, (number - begin + 1) / _FADE, (end - number + 1) / _FADE)
        shown = [tag for tag in tags if part * tag.opacity[number] > 0]
        if not shown:
            return
        with lettering(picture) as draw:
            for tag in shown:
                right, up = tag.middle[number]
                write(
                    draw, tag.name, (float(right), float(size[1] - up)), letters, look.text,
                    opacity=float(part * tag.opacity[number]), anchor="mm", plate=look.distance,
                )  # fmt: skip

    return draw_into


def placed_tags(camera: CameraPath, scene: Scene, size: tuple[int, int]) -> list[Tag]:
    """Return the names of animals, and then the distances at the lines, at their places.

    Args:
        camera: the camera in every frame.
        scene: the animals and the lanes.
        size: width and height of the picture, pixels.
    """
    staging = scene.staging
    if staging is None:
        return []
    bodies, thick = _bodies(camera, scene, size)
    count = len(bodies)
    things = bodies.reshape(count, -1, 2)
    if scene.goal is not None:
        light = _pixels(camera, scene.goal[None, None].repeat(count, 0), size)
        things = np.concatenate([things, light], 1)
    appear = np.ones(count)
    if staging.appear is not None:
        appear = np.interp(np.arange(count), staging.appear, (0.0, 1.0))
    tags: list[Tag] = []
    for animal, name in enumerate(staging.names):
        half = _half(name, size)
        places = _around(bodies[:, animal], thick, half, size)
        # Nothing stands between the viewer and the first animal, so its word is below it.
        ranks = (0, 1, 2, 3) if animal else (1, 0, 2, 3)
        costs = [
            (_cost(place, half, tags, things, thick, size) * (appear > 0)).mean() + _LATER * rank
            for rank, place in zip(ranks, places, strict=True)
        ]
        place = places[int(np.argmin(costs))]
        tags.append(_tag(name, place, half, appear, tags, size))
    if (track := staging.track) is not None:
        along = track.spacing * np.arange(1, track.lines + 1)
        beside = -track.right - _BESIDE * scene.radius
        spots = np.array([track.at(each, beside) for each in along])
        spots[:, 2] = scene.level or 0.0
        seen = _pixels(camera, spots[None].repeat(count, 0), size)
        for number, each in enumerate(along):
            name = f"{each:g} m"
            # A distance gives way to the name of an animal.
            tags.append(_tag(name, seen[:, number], _half(name, size), np.ones(count), tags, size))
    return tags


def _bodies(
    camera: CameraPath, scene: Scene, size: tuple[int, int]
) -> tuple[Float[np.ndarray, "frames n b 2"], Float[np.ndarray, " frames"]]:
    """Return the centres of all bodies of all animals, and half of their thickness, in pixels."""
    bodies = scene.clip.position[:, None]
    if scene.ghosts is not None:
        bodies = np.concatenate([bodies, scene.ghosts.position], 1)
    seen = _pixels(camera, bodies.reshape(len(bodies), -1, 3), size)
    away = np.linalg.norm(camera.position - camera.focus, axis=-1)
    thick = scene.half_extents.min(1).max()
    pixels = size[1] / 2 * thick / (np.tan(np.radians(camera.view_angle / 2)) * away)
    return seen.reshape(*bodies.shape[:3], 2), pixels


def _pixels(
    camera: CameraPath, points: Float[np.ndarray, "frames n 3"], size: tuple[int, int]
) -> Float[np.ndarray, "frames n 2"]:
    return (project(camera, points, size[0] / size[1]) + 1) / 2 * size


def _half(name: str, size: tuple[int, int]) -> Float[np.ndarray, "2"]:
    """Return half width and half height of a word with its plate, pixels."""
    letters = _LETTERS * min(size)
    return np.array([font(letters).getlength(name) / 2 + _MARGIN * letters, _HIGH * letters])


def _around(
    bodies: Float[np.ndarray, "frames b 2"],
    thick: Float[np.ndarray, " frames"],
    half: Float[np.ndarray, "2"],
    size: tuple[int, int],
) -> list[Float[np.ndarray, "frames 2"]]:
    """Return places for a word above, below, to the left and to the right of an animal."""
    low, high, middle = bodies.min(1), bodies.max(1), bodies.mean(1)
    out = thick[:, None] + half + _GAP * min(size)
    places = [
        np.stack([middle[:, 0], (high + out)[:, 1]], -1),
        np.stack([middle[:, 0], (low - out)[:, 1]], -1),
        np.stack([(low - out)[:, 0], middle[:, 1]], -1),
        np.stack([(high + out)[:, 0], middle[:, 1]], -1),
    ]
    # A word does not shake with the strokes of its animal.
    return [smooth(place, _STEADY) for place in places]


def _cost(
    place: Float[np.ndarray, "frames 2"],
    half: Float[np.ndarray, "2"],
    tags: list[Tag],
    things: Float[np.ndarray, "frames n 2"],
    thick: Float[np.ndarray, " frames"],
    size: tuple[int, int],
) -> Float[np.ndarray, " frames"]:
    """Return the cost of a place for a word in every frame."""
    off = np.abs(things - place[:, None]) - thick[:, None, None]
    on_body = (off < half).all(-1).sum(1)
    outside, crossed = ~_inside(place, half, size), _crosses(place, half, tags)
    return _ON_BODY * on_body + _OUTSIDE * outside + _CROSSED * crossed


def _tag(
    name: str,
    place: Float[np.ndarray, "frames 2"],
    half: Float[np.ndarray, "2"],
    opacity: Float[np.ndarray, " frames"],
    tags: list[Tag],
    size: tuple[int, int],
) -> Tag:
    """Return a word that fades where it would leave the picture or cross earlier words."""
    frames = np.arange(len(place))
    hidden = np.flatnonzero(~_inside(place, half, size) | _crosses(place, half, tags))
    if len(hidden):
        apart = np.abs(frames[:, None] - hidden).min(1)
        opacity = np.minimum(opacity, np.clip(apart / _FADE, 0.0, 1.0))
    return Tag(name, place, half, opacity)


def _inside(
    place: Float[np.ndarray, "frames 2"], half: Float[np.ndarray, "2"], size: tuple[int, int]
) -> Bool[np.ndarray, " frames"]:
    """Return whether a word is in the part of the picture for words."""
    low, high = (np.array([[-_SIDEWAYS, -_DOWN], [_SIDEWAYS, _UP]]) + 1) / 2 * size
    inside = (place - half * [1, 0] > low) & (place + half * [1, 0] < high)
    return inside.all(-1)


def _crosses(
    place: Float[np.ndarray, "frames 2"], half: Float[np.ndarray, "2"], tags: list[Tag]
) -> Bool[np.ndarray, " frames"]:
    """Return whether a word crosses one of some others that are seen."""
    crossed = np.zeros(len(place), bool)
    for tag in tags:
        close = (np.abs(place - tag.middle) < half + tag.half).all(-1)
        crossed |= close & (tag.opacity > 0)
    return crossed
