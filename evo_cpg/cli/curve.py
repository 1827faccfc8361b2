"""A curve of dots for a terminal: two by four of Braille's to a character."""

import math
from collections.abc import Sequence

import numpy as np

_BLANK = 0x2800
# Bits of the dots of a character, by column and by row from above.
_BITS = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))


def curve(values: Sequence[float], width: int, height: int) -> list[str]:
    """Lines of text in which a curve runs from left to right.

    Args:
        values: at equal steps; those that are not finite are gaps.
        width: characters.
        height: lines.

    Returns:
        Lines, from above; blank where no value is finite.
    """
    given = np.asarray(values, float)
    cells = np.zeros((height, width), int)
    across, down = 2 * width, 4 * height
    finite = given[np.isfinite(given)]
    if not len(finite):
        return [chr(_BLANK) * width] * height
    low, high = float(finite.min()), float(finite.max())
    scale = (down - 1) / (high - low) if high > low else 0.0
    place = np.linspace(0, len(given) - 1, across) if len(given) > 1 else np.zeros(across)
    before = math.nan
    for column, at in enumerate(place):
        value = float(given[round(at)])
        if math.isfinite(value):
            row = down - 1 - round((value - low) * scale)
            # A steep step is drawn through.
            start = row if math.isnan(before) else int(before)
            for dot in range(min(start, row), max(start, row) + 1):
                cells[dot // 4, column // 2] |= _BITS[column % 2][dot % 4]
            before = row
        else:
            before = math.nan
    return ["".join(chr(_BLANK + cell) for cell in line) for line in cells.tolist()]
