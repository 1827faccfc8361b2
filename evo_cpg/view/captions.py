"""Words in films: captions, an arrow to a goal out of sight, and the words of a story.

The words of a story fade in and out. A word beside an animal or a line also fades out where it
would cross another one.
"""

from collections import Counter
from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from PIL import ImageDraw

from evo_cpg.view.camera import CameraPath, in_camera, project, smooth
from evo_cpg.view.legible import font, legible, lettering, write
from evo_cpg.view.look import Look
from evo_cpg.view.scene import Growth, Panel, Scene, grid_spacing

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


def captions(
    look: Look, title: str, distance: str, note: str, size: tuple[int, int], scale: float
) -> Callable[[np.ndarray, float, float, float], None]:
    """Lay out the captions.

    If a picture is too narrow for the title and the values, the last values are left out. A title
    that does not fit next to the time shrinks, and may be cut. A small picture has only title and
    time.

    Args:
        look: look of the world.
        title: text at the bottom right.
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


# Length of the scale bar in cells, its thickness, height of its ends, and the gap between parts of
# the caption, pixels in a picture 720 pixels high. Side of a square of the legend, distance of its
# lines, and their largest number.
_BAR, _THICK, _TICK, _BETWEEN, _SQUARE, _STEP, _LINES = 0.9, 3, 8, 30, 11, 19, 3


def wall_captions(
    panel: Panel, scene: Scene, view: CameraPath, size: tuple[int, int], scale: float
) -> Callable[[np.ndarray, float], None]:
    """Return a function that writes the captions of a wall into a picture, with the time, s.

    A small picture has only title and time, and a narrow one has no legend.

    Args:
        panel: the animals.
        scene: their scene.
        view: the camera.
        size: width and height of the film, pixels.
        scale: pixels rendered per pixel of the film.
    """
    wall, look, unit = scene.wall, scene.look, scale * max(size[1] / 720, _SMALLEST)
    assert wall is not None
    width, margin, note = round(size[0] * scale), _MARGIN * unit, _NOTE * unit
    height = round(margin + 60 * unit)
    bottom, legend, clock = height - margin, legend_of(panel), font(_LARGE * unit)
    length = grid_spacing(2 * _BAR * wall.cell[0])
    ends = np.array([[[0.0, 0.0, 0.0], [length, 0.0, 0.0]]]) + view.focus[0]
    pixels = np.ptp(project(view, ends, size[0] / size[1])[0, :, 0]) / 2 * width
    left = margin + clock.getlength(f"{scene.clip.time[-1]:.1f} s") + _BETWEEN * unit
    title, large = fitted(panel.title or "", _LARGE * unit, min(width / 2, width - margin - left))
    middle, right, top = left + pixels / 2, left + pixels, bottom - _TICK * unit
    corners = [(left, top), (left, bottom), (right, bottom), (right, top)]
    free = (
        width - margin - max(font(large).getlength(title), font(note, False).getlength(panel.note))
    )
    square, beside = _SQUARE * unit, right + _BETWEEN * unit
    lettered = max((font(note, False).getlength(words) for _, words in legend), default=0)
    if beside + 2 * square + lettered > free:
        legend = []

    def write_into(picture: np.ndarray, time: float) -> None:
        with lettering(picture[:height]) as draw:
            dim = {"color": look.text, "bold": False, "opacity": 0.75}
            small = size[1] < _SMALL
            above = bottom if small else bottom - 27 * unit
            write(draw, title, (width - margin, above), large, look.text, anchor="rd")
            write(draw, f"{time:.1f} s", (margin, bottom), _LARGE * unit, look.text)
            if small:
                return
            write(draw, panel.note, (width - margin, bottom), note, anchor="rd", **dim)
            draw.line(corners, look.text, max(round(_THICK * unit), 1))
            write(draw, f"{length:g} m", (middle, top), note, look.text, anchor="md")
            for number, (color, words) in enumerate(reversed(legend)):
                low = bottom - number * _STEP * unit
                draw.rectangle((beside, low - square, beside + square, low), fill=color)
                write(draw, words, (beside + 1.5 * square, low - square / 2), note,
                      anchor="lm", **dim)  # fmt: skip

    return write_into


def legend_of(panel: Panel) -> list[tuple[str, str]]:
    """Return colours and words for the largest lines of descent, or for the ranks of fitness."""
    shown = panel.exhibits
    if shown[0].founder is None:
        return [(shown[0].color, "fittest"), (shown[-1].color, f"rank {len(shown)}")]
    color_of = {one.founder: one.color for one in shown}
    largest = Counter(one.founder for one in shown).most_common(_LINES)
    return [(color_of[line], f"line {line}: {n} of {len(shown)}") for line, n in largest if n > 1]


# Places of the arrow's tip, from the middle to the edges: sideways, down and up. The captions are
# below.
_SIDEWAYS, _DOWN, _UP, _UNDER_TITLE = 0.93, 0.6, 0.88, 0.3
# Length and half width of the arrow, and height of the letters, as fractions of the picture's
# height.
_ARROW, _HALF_WIDTH, _WORD = 0.055, 0.026, 0.032
# Colours of the arrow and of its rim.
_COLOR, _RIM = "#ffd37a", "#4a3a12"


def pointer(
    camera: CameraPath,
    goal: Float[np.ndarray, "*frames 3"] | None,
    look: Look,
    size: tuple[int, int],
    name: str = "light",
    titled: bool = False,
) -> Callable[[np.ndarray, int], None]:
    """Return a function that draws the arrow to a goal (m) into a frame, if the goal is outside.

    Args:
        camera: the camera in every frame.
        goal: place of the goal, in every frame if it moves, m, or None without a goal.
        look: look of the world.
        size: width and height of the picture, pixels.
        name: word beside the arrow.
        titled: whether a title is at the top.

    Returns:
        A function of a picture, bytes ``(height, width, 3)``, bottom row first, and its number.
    """
    if goal is None:
        return lambda picture, number: None
    width, height = size
    tips = edge_places(camera, goal, width / height)
    if titled:
        tips[:, 1] = np.minimum(tips[:, 1], _UNDER_TITLE)

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
    camera: CameraPath, goal: Float[np.ndarray, "*t 3"], aspect: float
) -> Float[np.ndarray, "frames 2"]:
    """Return the places of the arrow's tip, or NaN where the light is in the picture.

    Args:
        camera: the camera in every frame.
        goal: place of the light, in every frame if it moves, m.
        aspect: width of the picture over its height.

    Returns:
        Right and up, from -1 to 1 between the edges of the frame.
    """
    right, up, depth = in_camera(camera, np.atleast_2d(goal)[:, None])[:, 0].T
    half = np.tan(np.radians(camera.view_angle / 2))
    # Behind the camera, only the direction counts.
    scale = half * np.where(depth > 0, depth, 1e-9)
    place = np.stack([right / (scale * aspect), up / scale], -1)
    limit = np.where(place[:, 1:] < 0, _DOWN, _UP)
    beyond = np.maximum(np.abs(place[:, :1]) / _SIDEWAYS, np.abs(place[:, 1:]) / limit)
    seen = (np.abs(place) < 1).all(-1, keepdims=True) & (depth > 0)[:, None]
    return np.where(seen, np.nan, place / np.maximum(beyond, 1.0))


# Sizes of letters, margin, and distance of lines, in a picture whose shorter side is 1080 pixels.
_SIZES = {"title": 98.0, "subtitle": 56.0, "caption": 64.0}
_EDGE, _LINE = 84.0, 1.25
# Time in which words fade in and out, s.
_FADE = 0.35
# Offset and opacity of the shadow behind letters, in their size.
_SHADOW, _SHADOW_OPACITY = 0.045, 0.45
# Height of the letters of a tag and its distance from an animal, as fractions of the shorter side.
_LETTERS, _GAP = 0.034, 0.012
# Half height of a tag and its margin sideways, in the height of its letters.
_HIGH, _BORDER = 0.7, 0.4
# Part of the picture for tags, from -1 to 1 between its edges: sideways, down and up. The captions
# are lower.
_TAG_ASIDE, _TAG_DOWN, _TAG_UP = 0.97, 0.62, 0.95
# Half width of the window over which the place of a tag is averaged, and time in which it fades, in
# frames.
_STEADY, _FADING = 5.0, 6.0
# Distance of the tags at the lines from the lanes, in radii of the animal.
_BESIDE = 0.15


class Words(NamedTuple):
    """A text in a story.

    Attributes:
        text: the text.
        kind: ``title`` and ``subtitle`` stand at the top, ``caption`` at the bottom.
        start: time in the film at which it begins to appear, s.
        end: time at which it has gone, s.
    """

    text: str
    kind: Literal["title", "subtitle", "caption"]
    start: float
    end: float


def growth_captions(
    growth: Growth, look: Look, size: tuple[int, int]
) -> Callable[[np.ndarray, float, float, float], None]:
    """Return a function as that of `captions`, which writes what has grown."""
    spans = zip(growth.words, growth.begins, (*growth.begins[1:], np.inf), strict=True)
    words = [Words(text, "caption", begin, end) for text, begin, end in spans]

    def write_into(picture: np.ndarray, time: float, distance: float, speed: float) -> None:
        del distance, speed
        with lettering(picture) as draw:
            for each in words:
                written(draw, each, time, look, size)

    return write_into


def written(
    draw: ImageDraw.ImageDraw, words: Words, time: float, look: Look, size: tuple[int, int]
) -> None:
    """Write words into a picture of a size (pixels), if they are shown at a time of the film, s."""
    opacity = min((time - words.start) / _FADE, (words.end - time) / _FADE, 1.0)
    if opacity <= 0:
        return
    unit = min(size) / 1080
    letters, margin = _SIZES[words.kind] * unit, _EDGE * unit
    lines = wrapped(words.text, letters, size[0] - 2 * margin)
    step = _LINE * letters
    if words.kind == "caption":
        first = size[1] - margin - step * (len(lines) - 1)
    else:
        first = margin + letters
        if words.kind == "subtitle":
            # It stands below a title of one line.
            first += 0.3 * letters + _SIZES["title"] * unit * _LINE
    bold = words.kind != "subtitle"
    dark = float(np.mean([int(look.text[i : i + 2], 16) for i in (1, 3, 5)])) > 128
    for number, line in enumerate(lines):
        place = margin, first + number * step
        if dark and words.kind != "caption":
            offset = _SHADOW * letters
            behind = place[0] + offset, place[1] + offset
            write(
                draw, line, behind, letters, "#000000", bold=bold,
                opacity=_SHADOW_OPACITY * opacity, anchor="ls",
            )  # fmt: skip
        # Letters would be lost on lines and bodies that pass below them.
        plate = look.distance if words.kind == "caption" else ""
        write(
            draw, line, place, letters, look.text,
            bold=bold, opacity=opacity, anchor="ls", plate=plate,
        )  # fmt: skip


def wrapped(text: str, size: float, room: float) -> list[str]:
    """Return the lines of a text that are at most this wide, if its words are.

    Args:
        text: the text.
        size: size of the letters, pixels.
        room: available width, pixels.
    """
    lines: list[str] = []
    while True:
        # Each line is filled as far as its words go.
        shorter: list[str] = []
        for word in legible(text).split():
            longer = f"{shorter[-1]} {word}" if shorter else word
            if shorter and font(size).getlength(longer) <= room:
                shorter[-1] = longer
            else:
                shorter.append(word)
        if lines and len(shorter) != len(lines):
            return lines
        lines, room = shorter, 0.95 * room
        # Lines of about equal length look better than a last line of one word.
        if len(lines) <= 1:
            return lines


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


def tags_of(
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
        part = min(1.0, (number - begin + 1) / _FADING, (end - number + 1) / _FADING)
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
    """Return the names of animals, and then the distances at the lines, for a picture of a size.

    A name is below the first animal and above the others. A tag fades where it would leave the
    picture or cross an earlier one.
    """
    staging = scene.staging
    if staging is None:
        return []
    count, letters, aspect = len(scene.clip.time), _LETTERS * min(size), size[0] / size[1]
    low, high = (np.array([[-_TAG_ASIDE, -_TAG_DOWN], [_TAG_ASIDE, _TAG_UP]]) + 1) / 2 * size
    tags: list[Tag] = []

    def add(name: str, place: np.ndarray) -> None:
        opacity = np.ones(count)
        width = font(letters).getlength(name)
        half = np.array([width / 2 + _BORDER * letters, _HIGH * letters])
        sideways = half * [1, 0]
        # Places behind the camera are not numbers, and are hidden.
        hidden = ~((place - sideways >= low) & (place + sideways <= high)).all(-1)
        for tag in tags:
            close = (np.abs(place - tag.middle) < half + tag.half).all(-1)
            hidden |= close & (tag.opacity > 0)
        if hidden.any():
            away = np.abs(np.arange(count)[:, None] - np.flatnonzero(hidden)).min(1)
            opacity = np.clip(away / _FADING, 0.0, 1.0)
        tags.append(Tag(name, place, half, opacity))

    bodies = scene.clip.position[:, None]
    if scene.ghosts is not None:
        bodies = np.concatenate([bodies, scene.ghosts.position], 1)
    # Half of an animal's thickness in every frame, pixels.
    away = np.linalg.norm(camera.position - camera.focus, axis=-1)
    seen = size[1] / 2 / (np.tan(np.radians(camera.view_angle / 2)) * away)
    out = scene.half_extents.min(1).max() * seen + _HIGH * letters + _GAP * min(size)
    for animal, name in enumerate(staging.names):
        spots = (project(camera, bodies[:, animal], aspect) + 1) / 2 * size
        # Nothing stands between the viewer and the first animal, so its name is below it.
        up = spots[..., 1].max(1) + out if animal else spots[..., 1].min(1) - out
        # A word does not shake with the strokes of its animal.
        add(name, smooth(np.stack([spots[..., 0].mean(1), up], -1), _STEADY))
    if (track := staging.track) is not None:
        along = track.spacing * np.arange(1, track.lines + 1)
        lines = np.array([track.at(each, -track.right - _BESIDE * scene.radius) for each in along])
        lines[:, 2] = scene.level or 0.0
        places = (project(camera, lines[None].repeat(count, 0), aspect) + 1) / 2 * size
        for number, each in enumerate(along):
            add(f"{each:g} m", places[:, number])
    return tags
