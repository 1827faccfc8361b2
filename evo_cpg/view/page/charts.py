"""Charts of a page, as SVG that takes the page's colours and whose text is text."""

import io
import re
from collections.abc import Sequence
from typing import NamedTuple

import matplotlib
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from evo_cpg.analysis import footfalls
from evo_cpg.analysis.body_wave import BodyWave
from evo_cpg.analysis.gait_numbers import Feet
from evo_cpg.view.legible import legible
from evo_cpg.view.page.html import Html, tag
from evo_cpg.view.plots import empty_figure

_BLUE, _ORANGE, _RED, _GREY = "#0072B2", "#E69F00", "#D55E00", "#6b7280"
_FEET = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_WIDTH = 8.0


class TimeAxis(NamedTuple):
    """Where a chart shows which time, for a cursor that moves with the animal.

    Attributes:
        left: of its axes, share of the chart's width.
        right: likewise.
        start: first instant, s.
        stop: last instant, s.
    """

    left: float
    right: float
    start: float
    stop: float


def chart(figure: Figure, words: str, timed: bool = False) -> Html:
    """A figure with its caption; black becomes the page's ink and white its paper.

    Args:
        figure: to be drawn.
        words: what it shows.
        timed: whether the first axes have time, in seconds, to the right: a cursor moves with the
            animal there, and a click brings it to an instant.
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
    svg = re.sub(r"#(?:000000|000)\b", "currentColor", svg)
    svg = re.sub(r"#(?:ffffff|fff)\b", "var(--paper)", svg)
    svg = svg.replace(_BLUE.lower(), "var(--blue)")
    told = {}
    if timed:
        axis = _time_axis(figure.axes[0])
        told = {f"data_{name}": f"{value:.6g}" for name, value in axis._asdict().items()}
    sheet = tag("div", Html(svg), class_="sheet timed" if timed else "sheet", **told)
    drawing = tag("div", sheet, class_="drawing")
    return tag("figure", drawing, tag("figcaption", words), class_="chart")


def footfall_figure(feet: Feet, step: float, window: tuple[float, float]) -> Figure:
    """A bar for every stance, a row for every foot (Hildebrand 1965).

    Args:
        feet: what touches the ground.
        step: between samples, s.
        window: that is shown, s.
    """
    figure = empty_figure(_WIDTH, 0.9 + 0.27 * len(feet.names))
    axes = figure.subplots()
    for row, name in enumerate(feet.names):
        bars = footfalls.stances(feet.touched[:, row], step)
        bars = bars[(bars[:, 1] > window[0]) & (bars[:, 0] < window[1])].clip(*window)
        axes.broken_barh(
            [(a, b - a) for a, b in bars],
            (row - 0.36, 0.72),
            facecolors=_FEET[row % len(_FEET)],
        )
        del name
    axes.set_yticks(range(len(feet.names)), [legible(name) for name in feet.names])
    for label in axes.get_yticklabels():
        label.set_parse_math(False)
    axes.set_ylim(len(feet.names) - 0.4, -0.6)
    _over_time(axes, window)
    return _framed(figure)


def wave_figure(
    bending: Float[np.ndarray, "t j"],
    step: float,
    window: tuple[float, float],
    names: Sequence[str],
) -> Figure:
    """Bending along the body over time: a wave that runs is a slanting stripe.

    Args:
        bending: of every joint along the body, rad.
        step: between samples, s.
        window: that is shown, s.
        names: of the joints.
    """
    first, last = (round(instant / step) for instant in window)
    shown = np.degrees(bending[first:last]).T
    shown = shown - shown.mean(1, keepdims=True)
    figure = empty_figure(_WIDTH, 1.3 + 0.22 * len(names))
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
    axes.set_yticks(range(len(names)), [legible(name) for name in names], fontsize=8)
    for label in axes.get_yticklabels():
        label.set_parse_math(False)
    figure.colorbar(picture, ax=axes, label="bending less its mean (deg)", pad=0.015)
    _over_time(axes, window)
    return _framed(figure)


def lag_figure(wave: BodyWave, place: Float[np.ndarray, " j"]) -> Figure:
    """Phase and amplitude along the body.

    Args:
        wave: along the body.
        place: of its joints, m behind the first.
    """
    figure = empty_figure(_WIDTH, 2.7)
    left, right = figure.subplots(1, 2)
    left.plot(place, wave.phase, "o-", color=_BLUE, lw=1.6)
    left.set_ylabel("phase behind the first (deg)")
    right.bar(place, np.degrees(wave.amplitude), color=_ORANGE, width=0.6 * _gap(place))
    right.set_ylabel("amplitude (deg)")
    for axes in (left, right):
        axes.set_xlabel("place along the body (m)")
    return _framed(figure)


def effort_figure(
    time: Float[np.ndarray, " t"],
    power: Float[np.ndarray, " t"],
    instant: Float[np.ndarray, " f"],
    speed: Float[np.ndarray, " f"],
) -> Figure:
    """Power and speed over the whole trial.

    Args:
        time: of the control steps, s.
        power: in each, W.
        instant: at which the speed is known, s.
        speed: smoothed, m/s.
    """
    figure = empty_figure(_WIDTH, 2.6)
    axes = figure.subplots()
    width = max(1, round(0.1 / (time[1] - time[0]))) if len(time) > 1 else 1
    count = len(time) // width * width
    mean = power[:count].reshape(-1, width).mean(1)
    axes.plot(time[:count].reshape(-1, width).mean(1), mean, color=_RED, lw=1.0)
    axes.set_ylabel("power (W)", color=_RED)
    axes.set_ylim(bottom=0)
    right = axes.twinx()
    right.plot(instant, speed, color=_BLUE, lw=1.8)
    right.set_ylabel("speed (m/s)", color=_BLUE)
    right.set_ylim(bottom=0)
    _over_time(axes, (float(time[0]), float(time[-1]) if len(time) > 1 else 1.0))
    return _framed(figure)


def _over_time(axes: Axes, window: tuple[float, float]) -> None:
    axes.set_xlim(*window)
    axes.set_xlabel("time (s)")
    axes.xaxis.set_major_locator(MaxNLocator(8))


def _gap(place: Float[np.ndarray, " j"]) -> float:
    return float(np.diff(place).min()) if len(place) > 1 else 1.0


def _time_axis(axes: Axes) -> TimeAxis:
    box = axes.get_position()
    return TimeAxis(box.x0, box.x1, *axes.get_xlim())


def _framed(figure: Figure) -> Figure:
    for axes in figure.axes:
        axes.spines["top"].set_visible(False)
        if axes.yaxis.get_ticks_position() != "right":
            axes.spines["right"].set_visible(False)
    return figure
