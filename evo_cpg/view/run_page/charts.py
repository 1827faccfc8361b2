"""Charts of a page, as SVG in the page's colours and with real text.

Times and windows are in s, angles in rad, and places along the body in m.
"""

import io
import re
from collections.abc import Sequence

import matplotlib
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from evo_cpg.analysis.body_wave import BodyWave
from evo_cpg.analysis.feet import Feet, stances
from evo_cpg.analysis.midline import MidlineMotion
from evo_cpg.view.figure import (
    BLUE,
    BLUES,
    INK,
    ORANGE,
    PALETTE,
    RED,
    draw_stances,
    framed,
    name_rows,
    new_figure,
    right_axis,
)
from evo_cpg.view.run_page.html import Html, tag

_WIDTH = 8.0
# Number of midlines that are drawn in a stride.
_MIDLINES = 12
_TIMED = ("data_left", "data_right", "data_start", "data_stop")


@framed
def chart(figure: Figure, words: str, timed: bool = False) -> Html:
    """Return a figure with its caption, in the ink and paper colours of the page.

    Args:
        figure: figure to draw.
        words: caption of the figure.
        timed: whether the x axis of the first axes is time, s. A cursor then moves with the animal,
            and a click moves the animal to an instant.
    """
    text = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "font.family": ["sans-serif"]}):
        figure.savefig(text, format="svg", transparent=True, metadata={"Date": None})
    svg = text.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.S)
    svg = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", svg, count=1)
    svg = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", svg, count=1)
    # Ids of groups are the same in every figure, and nothing refers to them.
    svg = re.sub(r'<g id="[^"]*">', "<g>", svg)
    svg = re.sub(rf"#(?:000000|000)\b|{INK}", "currentColor", svg)
    svg = re.sub(r"#(?:ffffff|fff)\b", "var(--paper)", svg)
    svg = svg.replace(BLUE.lower(), "var(--blue)")
    instants = {}
    if timed:
        axes = figure.axes[0]
        box = axes.get_position()
        # Place and range of the time axis, for a cursor that moves with the animal.
        instants = dict(zip(_TIMED, (box.x0, box.x1, *axes.get_xlim()), strict=True))
        instants = {name: f"{value:.6g}" for name, value in instants.items()}
    sheet = tag("div", Html(svg), class_="sheet timed" if timed else "sheet", **instants)
    drawing = tag("div", sheet, class_="drawing")
    return tag("figure", drawing, tag("figcaption", words), class_="chart")


@framed
def footfall_figure(feet: Feet, step: float, window: tuple[float, float]) -> Figure:
    """Draw a bar for every stance, a row for every foot (Hildebrand 1965)."""
    figure = new_figure(_WIDTH, 0.9 + 0.27 * len(feet.names))
    axes = figure.subplots()
    for row, touched in enumerate(feet.touched.T):
        color = PALETTE[row % len(PALETTE)]
        draw_stances(axes, stances(touched, step), window, row, 0.72, color)
    name_rows(axes, feet.names)
    _over_time(axes, window)
    return figure


@framed
def wave_figure(
    bending: Float[np.ndarray, "t j"],
    step: float,
    window: tuple[float, float],
    names: Sequence[str],
) -> Figure:
    """Draw bending along the body over time. A running wave is a slanting stripe."""
    first, last = (round(instant / step) for instant in window)
    shown = np.degrees(bending[first:last]).T
    shown = shown - shown.mean(1, keepdims=True)
    figure = new_figure(_WIDTH, 1.3 + 0.22 * len(names))
    axes = figure.subplots()
    most = max(float(np.abs(shown).max(initial=0.0)), 1e-6)
    picture = axes.imshow(
        shown,
        cmap="RdBu_r",
        vmin=-most,
        vmax=most,
        aspect="auto",
        interpolation="bilinear",
        extent=(window[0], window[1], len(names) - 0.5, -0.5),
    )
    name_rows(axes, names)
    axes.set_ylim(len(names) - 0.5, -0.5)
    figure.colorbar(picture, ax=axes, label="bending minus its mean (deg)", pad=0.015)
    _over_time(axes, window)
    return figure


@framed
def lag_figure(wave: BodyWave, place: Float[np.ndarray, " j"]) -> Figure:
    """Draw phase and amplitude along the body."""
    figure = new_figure(_WIDTH, 2.7)
    left, right = figure.subplots(1, 2)
    left.plot(place, wave.phase, "o-", color=BLUE, lw=1.6)
    left.set_ylabel("phase lag (deg)")
    gap = float(np.diff(place).min()) if len(place) > 1 else 1.0
    right.bar(place, np.degrees(wave.amplitude), color=ORANGE, width=0.6 * gap)
    right.set_ylabel("amplitude (deg)")
    for axes in (left, right):
        axes.set_xlabel("position along the body (m)")
    return figure


@framed
def midline_figure(motion: MidlineMotion) -> Figure:
    """Draw midlines in the body's frame, the amplitude envelope, and the lag on bending."""
    figure = new_figure(_WIDTH, 2.7)
    lines, middle, right = figure.subplots(1, 3, width_ratios=(1.5, 1, 1))
    cycles, place = motion.sway
    instants = np.linspace(0, cycles.width, _MIDLINES, endpoint=False).round().astype(int)
    shades = BLUES(np.linspace(0.0, 1.0, _MIDLINES))
    for instant, shade in zip(instants, shades, strict=True):
        lines.plot(place, cycles.values[instant - cycles.width], color=shade, lw=1.2)
    lines.set(xlabel="distance behind the nose (m)", ylabel="sway (m)")
    along = motion.envelope
    fine = np.linspace(0.0, 1.0, 50)
    middle.plot(along.place, along.amplitude, "o", color=ORANGE, ms=4)
    middle.plot(fine, np.polyval(along.quadratic[::-1], fine), color=INK, lw=1.2)
    middle.set(xlabel="place (lengths)", ylabel="amplitude (lengths)", ylim=(0, None))
    right.plot(along.place, motion.lag.each, "o-", color=BLUE, lw=1.2, ms=4)
    right.axhline(0.0, color=INK, lw=0.6)
    right.set(xlabel="place (lengths)", ylabel="lag on bending (cycles)")
    return figure


@framed
def effort_figure(
    time: Float[np.ndarray, " t"],
    power: Float[np.ndarray, " t"],
    instant: Float[np.ndarray, " f"],
    speed: Float[np.ndarray, " f"],
) -> Figure:
    """Draw power and speed over the whole trial."""
    figure = new_figure(_WIDTH, 2.6)
    axes = figure.subplots()
    width = max(1, round(0.1 / (time[1] - time[0]))) if len(time) > 1 else 1
    count = len(time) // width * width
    mean = power[:count].reshape(-1, width).mean(1)
    axes.plot(time[:count].reshape(-1, width).mean(1), mean, color=RED, lw=1.0)
    axes.set_ylabel("power (W)", color=RED)
    axes.set_ylim(bottom=0)
    right = right_axis(axes)
    right.plot(instant, speed, color=BLUE, lw=1.8)
    right.set_ylabel("speed (m/s)", color=BLUE)
    right.set_ylim(bottom=0)
    _over_time(axes, (float(time[0]), float(time[-1]) if len(time) > 1 else 1.0))
    return figure


def _over_time(axes: Axes, window: tuple[float, float]) -> None:
    axes.set_xlim(*window)
    axes.set_xlabel("time (s)")
    axes.xaxis.set_major_locator(MaxNLocator(8))
