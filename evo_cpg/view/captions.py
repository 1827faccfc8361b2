"""Captions of a film, an arrow to a goal outside of its picture, and the headings of a sheet."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from evo_cpg.view.camera import CameraPath, in_camera
from evo_cpg.view.legible import font, legible, lettering, write
from evo_cpg.view.look import Look

# Margin around the captions in a picture 720 pixels high, pixels, and the least factor by which
# margin and letters shrink in smaller pictures.
_MARGIN, _SMALLEST = 34, 0.62
# Height below which pictures show only title and time, pixels.
_SMALL = 200
# Sizes of letters in a picture 720 pixels high: of the title and values, of the note, and of the
# names of values. Left edges and width of values, pixels. Values without room are left out.
_LARGE, _NOTE, _NAME = 23, 16, 15
_COLUMNS, _VALUE = (0, 140, 290), 105
# Smallest fraction of its size to which a title shrinks, and the ending of a cut title.
_LEAST, _CUT = 0.55, "..."
# Height of a heading's letters, as a fraction of its line.
_HEADING = 0.6


def captions(
    look: Look, title: str, distance: str, note: str, size: tuple[int, int], scale: float
) -> Callable[[np.ndarray, float, float, float], None]:
    """Lay out the captions.

    Args:
        look: look of the world.
        title: text at the bottom right. If a picture is too narrow for the title and the values,
            the last values are left out. A title that does not fit next to the time shrinks, and
            may be cut. A small picture has only title and time.
        distance: name of the shown distance.
        note: text below the title.
        size: width and height of the film, pixels.
        scale: pixels rendered per pixel of the film.

    Returns:
        A function that writes them into a picture: bytes ``(height, width, 3)``, bottom row first,
        and time (s), distance (m) and speed (m/s).
    """
    unit = scale * max(size[1] / 720, _SMALLEST)
    width, margin, small = round(size[0] * scale), _MARGIN * unit, size[1] < _SMALL
    title, large = fitted(title, _LARGE * unit, width - 2 * margin - _VALUE * unit)
    note = "" if small else note
    beside = max(
        font(large).getlength(legible(title)), font(_NOTE * unit, False).getlength(legible(note))
    )
    room = (width - 2 * margin - beside) / unit - _VALUE
    shown = [x for x in _COLUMNS if x <= (0 if small else max(room, 0))]
    height = round(margin + 60 * unit)
    bottom, names = height - margin, ("time", distance, "speed")

    def write_into(picture: np.ndarray, time: float, distance: float, speed: float) -> None:
        values = (f"{time:.1f} s", f"{distance:.2f} m", f"{speed:.2f} m/s")
        with lettering(picture[:height]) as draw:
            above = 0 if small else 27 * unit
            write(draw, title, (width - margin, bottom - above), large, look.text, anchor="rd")
            dim = {"color": look.text, "bold": False, "opacity": 0.75}
            write(draw, note, (width - margin, bottom), _NOTE * unit, anchor="rd", **dim)
            for x, name, value in zip(shown, names, values, strict=False):
                left = margin + x * unit
                write(draw, name, (left, bottom - 32 * unit), _NAME * unit, **dim)
                write(draw, value, (left, bottom), _LARGE * unit, look.text)

    return write_into


def heading(text: str, width: int, height: int) -> np.ndarray:
    """Return a moment's heading, dark on white: ``(height, width, 3)`` bytes, bottom row first.

    Args:
        text: words of the line.
        width: width, pixels.
        height: height, pixels.
    """
    picture = np.full((height, width, 3), 255, np.uint8)
    with lettering(picture) as draw:
        write(draw, text, (width / 2, height / 2), _HEADING * height, "black", anchor="mm")
    return picture


def fitted(title: str, size: float, room: float) -> tuple[str, float]:
    """Return a title, cut if it is too long, and the letter size at which it fits.

    Args:
        title: text in any script.
        size: size of the letters if there is room, pixels.
        room: available width, pixels.
    """
    full = font(size).getlength(legible(title))
    if full * _LEAST <= room:
        return title, size * min(1.0, room / max(full, 1.0))
    least = size * _LEAST
    while title and font(least).getlength(legible(title) + _CUT) > room:
        title = title[:-1]
    return title + _CUT, least


# Places of the arrow's tip, from the middle to the edges: sideways, down and up. The captions are
# below.
_SIDEWAYS, _DOWN, _UP = 0.93, 0.6, 0.88
# Length and half width of the arrow, and height of the letters, as fractions of the picture's
# height.
_ARROW, _HALF_WIDTH, _WORD = 0.055, 0.026, 0.032
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
        back, side = place - _ARROW * height * along, _HALF_WIDTH * height * across
        with lettering(picture) as draw:
            corners = [tuple(map(float, corner)) for corner in (place, back + side, back - side)]
            draw.polygon(corners, fill=_COLOR, outline=_RIM)
            words = back - 0.9 * _WORD * height * along
            anchor = ("r" if along[0] > 0.4 else "l" if along[0] < -0.4 else "m") + "m"
            where = float(words[0]), float(words[1])
            # Lines on the floor do not cross the word.
            write(
                draw, name, where, _WORD * height, look.text,
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
