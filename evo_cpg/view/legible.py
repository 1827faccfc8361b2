"""Write names of any script into pictures, in a font that is always there or spelt out.

Matplotlib ships DejaVu Sans, which has the Latin, Greek, Cyrillic, Arabic and Hebrew scripts and
many symbols. Pillow writes with this font into pictures drawn by VTK. The font lacks Chinese,
Japanese and Korean characters and most emoji, which would all look like the same box. These
characters are spelt out by their names in Unicode: a syllable by its sound, an emoji by its
picture, and an ideograph by its number. Terms of a task and measures of gait have units.
"""

import contextlib
import functools
import unicodedata
from collections.abc import Iterator
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.ft2font import FT2Font
from PIL import Image, ImageColor, ImageDraw, ImageFont

_FOLDER = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
_REGULAR, _BOLD = _FOLDER / "DejaVuSans.ttf", _FOLDER / "DejaVuSans-Bold.ttf"

# Opacity of a plate behind letters, 0 to 255.
_PLATE = 184


def legible(text: str) -> str:
    """Return the text, with characters that the font lacks spelt out."""
    if text.isascii():
        return text
    text = unicodedata.normalize("NFC", text)
    return "".join(
        letter if letter.isascii() or ord(letter) in _letters() else _spelt(letter)
        for letter in text
    )


@contextlib.contextmanager
def lettering(picture: np.ndarray) -> Iterator[ImageDraw.ImageDraw]:
    """Open a picture for `write`. The words are in the picture at the end of the context.

    Args:
        picture: bytes ``(height, width, 3)``, bottom row first. It is changed in place.

    Yields:
        The drawing context for `write`.
    """
    image = Image.fromarray(picture[::-1])
    yield ImageDraw.Draw(image, "RGBA")
    picture[:] = np.asarray(image)[::-1]


def write(
    draw: ImageDraw.ImageDraw,
    text: str,
    place: tuple[float, float],
    size: float,
    color: str,
    *,
    bold: bool = True,
    opacity: float = 1.0,
    anchor: str = "ld",
    plate: str = "",
) -> None:
    """Write a text into a picture.

    Args:
        draw: drawing context of the picture, see `lettering`.
        text: text in any script.
        place: pixels to the right and down.
        size: size of the letters, pixels.
        color: colour of the letters.
        bold: whether to use the bold face.
        opacity: opacity of the letters, 0 to 1. A plate fades with them.
        anchor: point of the text that is at the place, see Pillow's "Text anchors".
        plate: colour of a translucent plate behind the letters, or empty for no plate.
    """
    text, face = legible(text), font(size, bold)
    if plate:
        left, top, right, bottom = draw.textbbox(place, text, face, anchor)
        pad, back = 0.15 * size, (*ImageColor.getrgb(plate), round(_PLATE * opacity))
        draw.rectangle((left - pad, top - pad, right + pad, bottom + pad), fill=back)
    fill = (*ImageColor.getrgb(color), round(255 * opacity))
    draw.text(place, text, fill, face, anchor)


@functools.cache
def font(size: float, bold: bool = True) -> ImageFont.FreeTypeFont:
    """Return a face of the font that is always there, in a size (pixels)."""
    return ImageFont.truetype(str(_BOLD if bold else _REGULAR), size)


@functools.cache
def _letters() -> frozenset[int]:
    """Return the characters that both faces of the font have."""
    regular, bold = (set(FT2Font(str(file)).get_charmap()) for file in (_REGULAR, _BOLD))
    return frozenset(regular & bold)


def _spelt(letter: str) -> str:
    """Return a character spelt out in ASCII."""
    name = unicodedata.name(letter, "")
    kind = unicodedata.category(letter)
    if kind in ("Mn", "Mc", "Me", "Cf"):
        # Marks on a letter, and characters that join or select glyphs.
        return ""
    if kind[0] == "L" and "IDEOGRAPH" not in name and name:
        for word in (" LETTER ", " SYLLABLE "):
            if word in name:
                return name.rsplit(word, 1)[1].removeprefix("SMALL ").lower().replace(" ", "")
    if kind[0] == "S" and name:
        return f"({name.lower()})"
    return f"<{ord(letter):04X}>"


# Units by name. All other terms have no unit.
UNITS = {
    "amplitude": "rad", "bounce": "m", "distance": "m", "energy": "J", "forward": "m",
    "frequency": "Hz", "power": "W", "speed": "m/s", "stride_length": "m",
    "turning": "rad/s",
}  # fmt: skip


def in_words(name: str) -> str:
    """Return the name of a term, such as ``duty factor``."""
    return legible(name.replace("_", " "))


def terms_text(terms: dict[str, float]) -> str:
    """Return terms with their values and units, such as ``speed 0.31 m/s, duty factor 0.62``."""
    return ", ".join(
        f"{in_words(name)} {value:.3g} {UNITS.get(name, '')}".rstrip()
        for name, value in terms.items()
    )
