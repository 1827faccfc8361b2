"""Words of a story: a title, and a caption in each take. They fade in and out."""

from typing import Literal, NamedTuple

import numpy as np
from PIL import ImageDraw

from evo_cpg.view.legible import font, legible, write
from evo_cpg.view.look import Look

# Sizes of letters, margin, and distance of lines, in a picture whose shorter side is 1080 pixels.
_SIZES = {"title": 98.0, "subtitle": 56.0, "caption": 64.0}
_MARGIN, _LINE = 84.0, 1.25
# Time in which words fade in and out, s.
_FADE = 0.35
# Offset and opacity of the shadow behind letters, in their size.
_SHADOW, _SHADOW_OPACITY = 0.045, 0.45


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


def written(
    draw: ImageDraw.ImageDraw, words: Words, time: float, look: Look, size: tuple[int, int]
) -> None:
    """Write words into a picture, if they are shown at a time.

    Args:
        draw: drawing context, see `evo_cpg.view.legible.lettering`.
        words: the words.
        time: time in the film, s.
        look: look of the world.
        size: width and height of the picture, pixels.
    """
    opacity = min((time - words.start) / _FADE, (words.end - time) / _FADE, 1.0)
    if opacity <= 0:
        return
    unit = min(size) / 1080
    letters, margin = _SIZES[words.kind] * unit, _MARGIN * unit
    lines = wrapped(words.text, letters, size[0] - 2 * margin)
    step = _LINE * letters
    if words.kind == "caption":
        first = size[1] - margin - step * (len(lines) - 1)
    else:
        first = margin + letters
        if words.kind == "subtitle":
            # It stands below a title of one line, or of two in a tall picture.
            first += 0.3 * letters + _SIZES["title"] * unit * (
                2 * _LINE if size[0] < size[1] else _LINE
            )
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
    lines = _filled(text, size, room)
    # Lines of about equal length look better than a last line of one word.
    while len(lines) > 1 and len(shorter := _filled(text, size, 0.95 * room)) == len(lines):
        lines, room = shorter, 0.95 * room
    return lines


def _filled(text: str, size: float, room: float) -> list[str]:
    """Return the lines of a text, each filled as far as its words go."""
    lines: list[str] = []
    for word in legible(text).split():
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and font(size).getlength(longer) <= room:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines
