"""Picture of an answer of the laboratory: each measure over the first knob."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from evo_cpg.view.figure import PALETTE, framed, new_figure
from evo_cpg.view.legible import legible

# Size of a panel, inches, and number of panels side by side.
_PANEL, _ACROSS = (3.5, 2.6), 3
# Largest number of lines with a name each. More lines have a colour bar's colours and no legend.
_NAMED = 10


class Panel(NamedTuple):
    """A measure of every setting.

    Attributes:
        label: name of the measure with its unit.
        values: its value under each setting, NaN if it does not exist.
        decades: whether the axis is logarithmic if positive values span decades.
        cycle: length of a cycle, for a phase, or 0. Lines break where a phase wraps around.
    """

    label: str
    values: Sequence[float]
    decades: bool = False
    cycle: float = 0.0


@framed
def lab_figure(
    knobs: Sequence[str],
    settings: Sequence[Sequence[Any]],
    panels: Sequence[Panel],
    title: str,
) -> Figure:
    """Draw measures over the values of the first knob, a line for each value of the others.

    Args:
        knobs: names of the knobs that vary, with their units.
        settings: values of these knobs under each setting.
        panels: measures to draw.
        title: text above the picture.
    """
    rows = -(-len(panels) // _ACROSS)
    across = min(len(panels), _ACROSS)
    figure = new_figure(_PANEL[0] * across, _PANEL[1] * rows + 0.9, title)
    grid = figure.subplots(rows, across, squeeze=False).reshape(-1)
    lines: dict[tuple, list[int]] = {}
    for number, values in enumerate(settings):
        lines.setdefault(tuple(values[1:]), []).append(number)
    first = [values[0] if values else "" for values in settings]
    for axes, panel in zip(grid, panels, strict=False):
        _draw(axes, first, lines, panel, knobs)
    for axes in grid[len(panels) :]:
        axes.set_visible(False)
    if 1 < len(lines) <= _NAMED:
        handles = grid[0].get_legend_handles_labels()
        others = legible(", ".join(knobs[1:]))
        across = -(-len(lines) // -(-len(lines) // 5))
        figure.legend(*handles, title=others, loc="outside lower center", ncols=across)
    return figure


def _draw(
    axes: Axes,
    first: Sequence[Any],
    lines: dict[tuple, list[int]],
    panel: Panel,
    knobs: Sequence[str],
) -> None:
    named = any(isinstance(value, str) for value in first)
    names = list(dict.fromkeys(map(str, first)))
    for number, (values, places) in enumerate(lines.items()):
        color = PALETTE[number % len(PALETTE)]
        y = np.array([panel.values[place] for place in places], float)
        if named:
            x = np.array([names.index(str(first[place])) for place in places], float)
            x = x + 0.5 * (number - 0.5 * (len(lines) - 1)) / max(len(lines), 2)
        else:
            x = np.array([first[place] for place in places], float)
        if panel.cycle:
            wraps = np.flatnonzero(np.abs(np.diff(y)) > 0.5 * panel.cycle) + 1
            x, y = np.insert(x, wraps, np.nan), np.insert(y, wraps, np.nan)
        label = legible(", ".join(map(cell, values)))
        style = "o" if named else "o-"
        axes.plot(x, y, style, color=color, label=label, lw=1.6, ms=4.5)
    if named:
        axes.set_xticks(range(len(names)), [legible(name) for name in names], fontsize=8)
        axes.set_xlim(-0.6, len(names) - 0.4)
        if max(map(len, names)) * len(names) > 30:
            axes.tick_params(axis="x", rotation=40)
    elif _spans_decades(first):
        axes.set_xscale("log")
        _write_plainly(axes.xaxis)
    known = [value for value in panel.values if math.isfinite(value)]
    if panel.decades and known and _spans_decades(known):
        axes.set_yscale("log")
        _write_plainly(axes.yaxis)
    if knobs:
        axes.set_xlabel(legible(knobs[0]))
    axes.set_title(legible(panel.label))
    axes.grid()


def _write_plainly(axis: Axis) -> None:
    """Write numbers on a logarithmic axis without mathematics, which our pictures never have."""
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _spans_decades(values: Sequence[float]) -> bool:
    """Return whether positive values span more than a factor of 30."""
    return min(values) > 0 and max(values) > 30 * min(values)


def cell(value: Any) -> str:
    """Return a value of a knob or measure as short text."""
    if isinstance(value, str):
        return value
    if value is None or not math.isfinite(value):
        return "-"
    return f"{value:.0f}" if 1000 <= abs(value) < 1e5 else f"{value:.3g}"
