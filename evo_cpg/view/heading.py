"""A line of words above a picture, dark on white."""

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from evo_cpg.view.legible import legible

# Of the height of the line are letters so much.
_LETTERS = 0.6
_DPI = 100


def heading(text: str, width: int, height: int) -> np.ndarray:
    """The line: ``(height, width, 3)`` bytes, bottom row first.

    Args:
        text: its words.
        width: pixels.
        height: pixels.
    """
    figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    figure.text(
        *(0.5, 0.5),
        legible(text),
        fontsize=_LETTERS * height * 72 / _DPI,
        fontweight="bold",
        ha="center",
        va="center",
        parse_math=False,
    )
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[::-1, :, :3]
