"""Picture of a report card: the range of each rule as a bar, and our values as dots."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from evo_cpg.view.figure import BLUE, GREEN, INK, LIGHT_GREY, RED, framed, new_figure
from evo_cpg.view.legible import legible

# Size of a row and width of the picture, inches, and longest line of a name, characters.
_ROW, _WIDTH, _LINE = 0.52, 9.0, 52


class Bar(NamedTuple):
    """A row of the picture.

    Attributes:
        name: animal and quantity.
        low: lower end of the bar, or minus infinity.
        high: upper end of the bar, or infinity.
        values: our values.
        reproduced: whether their median is in the range of the rule.
    """

    name: str
    low: float
    high: float
    values: Sequence[float]
    reproduced: bool


@framed
def card_figure(bars: Sequence[Bar]) -> Figure:
    """Draw a card, each row with its own axis. The median is green if reproduced, else red.

    Args:
        bars: rows from top to bottom.
    """
    figure = new_figure(_WIDTH, _ROW * len(bars) + 0.3)
    for axes, bar in zip(figure.subplots(len(bars), 1, squeeze=False)[:, 0], bars, strict=True):
        _draw(axes, bar)
    return figure


def _draw(axes: Axes, bar: Bar) -> None:
    known = np.array([value for value in bar.values if math.isfinite(value)])
    ends = [end for end in (bar.low, bar.high) if math.isfinite(end)]
    shown = [*ends, *known.tolist()]
    span = max(shown) - min(shown) or abs(max(shown)) or 1.0
    left, right = min(shown) - 0.15 * span, max(shown) + 0.15 * span
    axes.barh(0, min(bar.high, right) - max(bar.low, left), left=max(bar.low, left), height=0.9,
              color=BLUE, alpha=0.25, lw=0)  # fmt: skip
    if known.size:
        axes.plot(known, 0 * known, "o", color=LIGHT_GREY, ms=4, mec=INK, mew=0.4)
        color = GREEN if bar.reproduced else RED
        axes.plot(float(np.median(known)), 0, "D", color=color, ms=7)
    axes.set_xlim(left, right)
    axes.set_ylim(-0.8, 0.8)
    axes.set_yticks([0], [legible(_broken(bar.name))], fontsize=8)
    axes.tick_params(axis="y", length=0)
    axes.tick_params(axis="x", labelsize=7, pad=1)
    axes.locator_params(axis="x", nbins=6)
    axes.spines["left"].set_visible(False)


def _broken(text: str) -> str:
    """Return a text with line breaks between words."""
    lines = [""]
    for word in text.split():
        if len(lines[-1]) + len(word) >= _LINE:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return "\n".join(lines)
