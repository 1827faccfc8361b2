"""Figures of an audit, of probed lights, of laboratory answers, parameters and a report card."""

import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.markers import MarkerStyle
from matplotlib.patches import Circle, Patch
from matplotlib.ticker import FuncFormatter, NullFormatter
from matplotlib.transforms import Affine2D

from evo_cpg.analysis.energy import Ledger
from evo_cpg.analysis.sensitivity import CHANGE, Sensitivity
from evo_cpg.analysis.verdict import Check
from evo_cpg.training.conditions import Probe, seen_from_start
from evo_cpg.view.figure import (
    BLUE,
    GREEN,
    GREY,
    INK,
    LIGHT_GREY,
    ORANGE,
    PALETTE,
    PINK,
    RED,
    SKY,
    framed,
    name_rows,
    new_figure,
)
from evo_cpg.view.legible import legible

# Label and colour of each kind of work, by its name in the ledger.
_WORKERS = {
    "motors": ("motors", BLUE),
    "dampers": ("joint dampers", SKY),
    "limits": ("joint limits", PINK),
    "lift": ("ground, normal forces", "#b45309"),
    "friction": ("ground, friction", ORANGE),
    "limbs": ("limb contacts", "#5b2a86"),
    "water": ("water", GREEN),
    "own": ("force laws of your own", "#7A5C00"),
    "pushes": ("random pushes", GREY),
}

# Colours of this program's path and of at most three paths from MuJoCo.
_OPINIONS = (INK, BLUE, SKY, ORANGE)

# Sizes in inches: width, height of the upper row, height of a bar, and height around the bars.
_WIDTH, _UPPER, _BAR, _REST = 10.0, 3.9, 0.3, 1.2

# About the largest number of points of a curve over a trial.
_POINTS = 1000


@framed
def audit_figure(
    ledger: Ledger,
    step: float,
    kept: Sequence[Check],
    paths: Mapping[str, Float[np.ndarray, "3 t"]],
    title: str,
) -> Figure:
    """Draw the energy, the paths and the displacements of an audit.

    Args:
        ledger: energy ledger of a trial.
        step: length of the trial's physics steps, s.
        kept: checks of trials under changed conditions, as fractions of the original displacement.
        paths: path of the root by program, m. Empty if MuJoCo was not run.
        title: text above the picture.
    """
    lower = _REST + _BAR * len(kept)
    figure = new_figure(_WIDTH, _UPPER + lower, title)
    places = figure.add_gridspec(2, 2, height_ratios=(_UPPER, lower), width_ratios=(4, 3))
    # Without MuJoCo there are no paths to compare, and the energy takes the whole row.
    axes = figure.add_subplot(places[0, 0] if paths else places[0, :])
    time = step * (1 + np.arange(len(ledger.stored)))
    each = slice(None, None, max(1, len(time) // _POINTS))
    for name, (label, color) in _WORKERS.items():
        work = ledger.work[name]
        if np.any(work):
            axes.plot(time[each], np.cumsum(work)[each], color=color, lw=1.5, label=label)
    left_over = np.cumsum(ledger.left_over)[each]
    axes.plot(time[each], left_over, color=INK, lw=2.2, label="unexplained (simulator error)")
    axes.axhline(0, color=GREY, lw=0.8)
    axes.set(xlabel="time (s)", ylabel="cumulative work (J)", title="Sources and sinks of energy")
    axes.legend(fontsize=8)
    if paths:
        axes = figure.add_subplot(places[0, 1])
        for (name, path), color in zip(paths.items(), _OPINIONS[: len(paths)], strict=True):
            axes.plot(path[0], path[1], color=color, lw=1.6, label=name)
            axes.plot(*path[:2, -1], "o", color=color, ms=5)
        first = next(iter(paths.values()))
        axes.plot(*first[:2, 0], "s", color=INK, ms=5, mfc="white", label="start")
        axes.set_aspect("equal", adjustable="box")
        every = np.concatenate([path[:2] for path in paths.values()], 1)
        middle, half = (every.max(1) + every.min(1)) / 2, 0.55 * np.ptp(every, 1).max() + 0.05
        (left, low), (right, high) = middle - half, middle + half
        axes.set(xlabel="x (m)", ylabel="y (m)", title="Paths of the root, from above")
        axes.set(xlim=(left, right), ylim=(low, high))
        axes.legend(fontsize=8)
    axes = figure.add_subplot(places[1, :])
    colors = {True: GREEN, False: RED, None: LIGHT_GREY}
    fractions = np.nan_to_num([100 * check.measured for check in kept])
    own = [colors[check.passed] for check in kept]
    axes.barh(np.arange(len(kept)), fractions, 0.62, color=own, zorder=2)
    for row, check in enumerate(kept):
        if check.limit is not None:
            limit, side = 100 * check.limit, ">" if check.least else "<"
            axes.plot([limit] * 2, [row - 0.42, row + 0.42], color=INK, lw=2, zorder=3)
            axes.text(limit, row, f" {side} {limit:.0f}", va="center", fontsize=8, zorder=4)
    name_rows(axes, [check.question for check in kept])
    axes.set(xlim=(0, 105), xlabel="displacement kept, relative to the original (%)")
    for axes in figure.axes:
        axes.grid()
    return figure


# Colours from lights on the right to lights on the left. All of them stand out on white.
_COLOURS = LinearSegmentedColormap.from_list("bearing", ["#5b2a86", BLUE, GREEN, ORANGE, RED])
# Longer side of the picture, and least length of each side, inches.
_LONG, _SHORT = 7.4, 5.6

# Offset of a label's centre from its light, across and up, points.
_LABEL = np.array([27.0, 19.0])


@framed
def probe_figure(probe: Probe, fraction: float, title: str) -> Figure:
    """Draw the animal's path in each situation, in the colour of its light.

    A filled star marks a reached light. A light counts as reached within the disc around it.

    Args:
        probe: results of the animal.
        fraction: fraction of the initial distance within which a light counts as reached.
        title: text above the picture.
    """
    bearings = np.array([seen_from_start(situation)[1] for situation in probe.situations])
    widest = max(float(np.abs(bearings).max()), 1e-9)
    colours = _COLOURS(0.5 + 0.5 * bearings / widest)
    reached = probe.reached(fraction)
    starts = np.array([situation.start_position for situation in probe.situations])
    lights = np.array([situation.light for situation in probe.situations], float)
    places = np.concatenate([lights, probe.paths[np.isfinite(probe.paths).all(-1)]])
    extent = np.ptp(places[:, :2], axis=0) + 1e-9
    width, height = np.maximum(_LONG * extent / extent.max(), _SHORT).tolist()
    # The title and the legend need height.
    figure = new_figure(width, height + 1.0, title)
    axes = figure.subplots()
    for i, colour in enumerate(colours):
        place, away = lights[i, :2], (lights - starts)[i, :2]
        near = Circle(tuple(place.tolist()), fraction * probe.start_distance[i], color=colour, lw=0)
        near.set_alpha(0.07)
        axes.add_patch(near)
        path = probe.paths[i][np.isfinite(probe.paths[i]).all(1)]
        axes.plot(*path[:, :2].T, color=colour, lw=1.5, zorder=3)
        end = path[-1:, :2].T
        axes.plot(*end, "o", color=colour, mec="white", mew=0.8, ms=7, zorder=5)
        face = colour if reached[i] else "white"
        axes.plot(*place, "*", mfc=face, mec=colour, mew=1.4, ms=17, zorder=4)
        bearing = f"{np.rad2deg(bearings[i]):+.0f}".replace("-", "\N{MINUS SIGN}")
        axes.annotate(
            f"{bearing if bearing[1:] != '0' else '0'}\N{DEGREE SIGN}",
            tuple(place.tolist()),
            tuple((_LABEL * away / max(float(np.linalg.norm(away)), 1e-9)).tolist()),
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=9,
        )
    for (x, y, _), heading in {situation[:2] for situation in probe.situations}:
        # A wedge at every start points along the animal's heading.
        marker = MarkerStyle(">", transform=Affine2D().rotate(heading))
        axes.plot(x, y, marker=marker, color=INK, mec="white", mew=0.8, ms=12, zorder=6)
    axes.set_aspect("equal", "datalim")
    axes.margins(0.07)
    axes.set(xlabel="x (m)", ylabel="y (m)")
    axes.grid()
    star = {"ls": "", "marker": "*", "mec": GREY, "ms": 13}
    reach = f"light reached: at most {fraction:.0%} of the distance left"
    handles = [
        Line2D([], [], ls="", marker=">", color=INK, ms=9, label="start"),
        Line2D([], [], ls="-", color=GREY, marker="o", ms=5, label="path and its end"),
        Line2D([], [], mfc=GREY, label=reach, **star),
        Line2D([], [], mfc="white", label="light not reached", **star),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return figure


# Size of a panel, inches, and number of panels side by side.
_PANEL_SIZE, _ACROSS = (3.5, 2.6), 3
# Largest number of lines with a name each. More lines have a colour bar's colours and no legend.
_NAMED = 10


class MeasurePanel(NamedTuple):
    """A measure under every setting, which has axes of its own in the figure.

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
    panels: Sequence[MeasurePanel],
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
    figure = new_figure(_PANEL_SIZE[0] * across, _PANEL_SIZE[1] * rows + 0.9, title)
    grid = figure.subplots(rows, across, squeeze=False).reshape(-1)
    lines: dict[tuple, list[int]] = {}
    for number, values in enumerate(settings):
        lines.setdefault(tuple(values[1:]), []).append(number)
    first: list[Any] = [values[0] if values else "" for values in settings]
    named = any(isinstance(value, str) for value in first)
    names = list(dict.fromkeys(map(str, first)))
    for axes, panel in zip(grid, panels, strict=False):
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
        known = [value for value in panel.values if math.isfinite(value)]
        across, upwards = [] if named else first, known if panel.decades else []
        for axis, values in ((axes.xaxis, across), (axes.yaxis, upwards)):
            # Positive values that span more than a factor of 30 have a logarithmic axis. Its
            # numbers are plain, because our pictures never have formulas.
            if len(values) and min(values) > 0 and max(values) > 30 * min(values):
                axes.set(**{f"{axis.axis_name}scale": "log"})
                axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
                axis.set_minor_formatter(NullFormatter())
        axes.set(xlabel=legible(knobs[0]) if knobs else "", title=legible(panel.label))
        axes.grid()
    for axes in grid[len(panels) :]:
        axes.set_visible(False)
    if 1 < len(lines) <= _NAMED:
        handles = grid[0].get_legend_handles_labels()
        others = legible(", ".join(knobs[1:]))
        across = -(-len(lines) // -(-len(lines) // 5))
        figure.legend(*handles, title=others, loc="outside lower center", ncols=across)
    return figure


def cell(value: Any) -> str:
    """Return a value of a knob or measure as short text."""
    if isinstance(value, str):
        return value
    if value is None or not math.isfinite(value):
        return "-"
    return f"{value:.0f}" if 1000 <= abs(value) < 1e5 else f"{value:.3g}"


_MORE, _LESS, _DOUBTFUL = BLUE, RED, "#d1d5db"

# Sizes of the sensitivity picture in inches: width, height of a bar, and height of the rest.
_WIDE, _ROW, _AROUND = 8.6, 0.27, 1.9


@framed
def sensitivity_figure(
    rows: Sequence[Sensitivity], measure: str, title: str, most: int = 25
) -> Figure:
    """Draw elasticities as bars. Unconfirmed bars are grey and show the simulated change.

    Parameters that are 0 have no elasticity and are left out.

    Args:
        rows: sensitivities from the top down.
        measure: measured quantity, such as ``speed``.
        title: text above the picture.
        most: largest number of bars.
    """
    shown = [row for row in rows if row.value][:most]
    figure = new_figure(_WIDE, _AROUND + _ROW * len(shown), title)
    axes = figure.subplots()
    found = np.array([row.elasticity if row.confirmed else row.finite for row in shown])
    lengths, places = np.nan_to_num(found, posinf=0.0, neginf=0.0), np.arange(len(shown))
    colors = [
        (_MORE if length > 0 else _LESS) if row.confirmed else _DOUBTFUL
        for row, length in zip(shown, lengths, strict=True)
    ]
    axes.barh(places, lengths, 0.66, color=colors, zorder=2)
    again = {"mfc": "white", "mec": INK, "ls": "", "marker": "d", "zorder": 3}
    axes.plot([row.finite for row in shown], places, ms=5, **again)
    axes.axvline(0, color=INK, lw=0.9, zorder=4)
    name_rows(axes, [f"{row.key} = {row.value:.4g}" for row in shown])
    axes.margins(x=0.06)
    axes.set_xlabel(f"change of the {measure} (%) if the parameter grows by 1 %")
    axes.grid(axis="x")
    axes.spines["left"].set_visible(False)
    handles = [
        Patch(color=_MORE, label=f"derivative: growth raises the {measure}"),
        Patch(color=_LESS, label=f"derivative: growth lowers the {measure}"),
        Line2D([], [], label=f"simulated with \N{PLUS-MINUS SIGN}{CHANGE:.0%}", **again),
        Patch(color=_DOUBTFUL, label="derivative not confirmed by simulation"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return figure


# Report card: size of a row and width of the picture, inches, and longest line of a name, letters.
_RULE, _CARD, _LINE = 0.52, 9.0, 52


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
    """Draw a card, each row with its own axis. The median is green if reproduced, else red."""
    figure = new_figure(_CARD, _RULE * len(bars) + 0.3)
    for axes, bar in zip(figure.subplots(len(bars), 1, squeeze=False)[:, 0], bars, strict=True):
        known = np.array([value for value in bar.values if math.isfinite(value)])
        ends = [end for end in (bar.low, bar.high) if math.isfinite(end)]
        shown = [*ends, *known.tolist()]
        span = max(shown) - min(shown) or abs(max(shown)) or 1.0
        left, right = min(shown) - 0.15 * span, max(shown) + 0.15 * span
        low, high = max(bar.low, left), min(bar.high, right)
        axes.barh(0, high - low, left=low, height=0.9, color=BLUE, alpha=0.25, lw=0)
        if known.size:
            axes.plot(known, 0 * known, "o", color=LIGHT_GREY, ms=4, mec=INK, mew=0.4)
            color = GREEN if bar.reproduced else RED
            axes.plot(float(np.median(known)), 0, "D", color=color, ms=7)
        axes.set(xlim=(left, right), ylim=(-0.8, 0.8))
        name = textwrap.fill(bar.name, _LINE, break_long_words=False, break_on_hyphens=False)
        axes.set_yticks([0], [legible(name)], fontsize=8)
        axes.tick_params(axis="y", length=0)
        axes.tick_params(axis="x", labelsize=7, pad=1)
        axes.locator_params(axis="x", nbins=6)
        axes.spines["left"].set_visible(False)
    return figure
