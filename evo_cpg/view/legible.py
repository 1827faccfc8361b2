"""Names in any script, in pictures: in a font that is always there, or spelt out.

Matplotlib brings DejaVu Sans, which has the Latin, Greek, Cyrillic, Arabic and Hebrew scripts and
many symbols; VTK's own fonts have little but Latin. Chinese, Japanese and Korean characters and
most emoji are in neither, nor on every computer, and would all look like the same box. They are
spelt out by their names in Unicode: a syllable by its sound, an emoji by what it shows, and an
ideograph, which has no name, by its number.
"""

import functools
import unicodedata
from pathlib import Path
from typing import cast

import matplotlib
import pyvista as pv
from matplotlib.ft2font import FT2Font

_FOLDER = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
_REGULAR, BOLD = _FOLDER / "DejaVuSans.ttf", _FOLDER / "DejaVuSans-Bold.ttf"


def legible(text: str) -> str:
    """The text with what the font lacks spelt out."""
    if text.isascii():
        return text
    text = unicodedata.normalize("NFC", text)
    return "".join(
        letter if letter.isascii() or ord(letter) in _letters() else _spelt(letter)
        for letter in text
    )


def write_legibly(label: pv.Text, text: str) -> None:
    """Let a text of a picture say this.

    Args:
        label: with its properties.
        text: in any script.
    """
    # Between two dollars VTK would read a formula.
    label.input = legible(text).replace("$", r"\$")
    if not text.isascii():
        style = cast(pv.TextProperty, label.prop)
        style.set_font_file(str(BOLD if style.bold else _REGULAR))


@functools.cache
def _letters() -> frozenset[int]:
    """What both faces of the font have."""
    regular, bold = (set(FT2Font(str(file)).get_charmap()) for file in (_REGULAR, BOLD))
    # VTK drops what takes two words of UTF-16.
    return frozenset(letter for letter in regular & bold if letter < 0x10000)


def _spelt(letter: str) -> str:
    """A character in ASCII."""
    name = unicodedata.name(letter, "")
    kind = unicodedata.category(letter)
    if kind in ("Mn", "Mc", "Me", "Cf"):
        # Marks on a letter, and what joins or selects glyphs.
        return ""
    if kind[0] == "L" and "IDEOGRAPH" not in name and name:
        for word in (" LETTER ", " SYLLABLE "):
            if word in name:
                return name.rsplit(word, 1)[1].removeprefix("SMALL ").lower().replace(" ", "")
    if kind[0] == "S" and name:
        return f"({name.lower()})"
    return f"<{ord(letter):04X}>"
