"""The frame of every figure: its style, colours, axes and legend, and how it is saved.

Figures use matplotlib's object interface and need no display.
"""

import os
from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from jaxtyping import Float, Real
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from evo_cpg.files import in_one_piece
from evo_cpg.view.legible import legible
from evo_cpg.view.output import PLOT_SUFFIXES, output_path

INK, GREY, LIGHT_GREY = "#1f2937", "#6b7280", "#9ca3af"
# Okabe and Ito's palette, which is clear with every common kind of colour blindness, and a brown.
BLUE, ORANGE, RED, GREEN = "#0072B2", "#E69F00", "#D55E00", "#009E73"
PINK, SKY, BROWN = "#CC79A7", "#56B4E9", "#7f5539"
PALETTE = (BLUE, RED, GREEN, PINK, ORANGE, SKY, INK, BROWN, LIGHT_GREY)

# Colours of time and of repeated lines. Their ends are left out, because they would vanish on white
# or on the dark paper of a page.
TIME = ListedColormap(matplotlib.colormaps["viridis"](np.linspace(0.25, 0.75, 256)), "time")
BLUES = ListedColormap(matplotlib.colormaps["Blues"](np.linspace(0.47, 0.85, 256)), "blues")

_DPI = 160

# Decorator of a function that returns a figure. Names are plain text and never formulas, so
# `text.parse_math` is off.
framed = matplotlib.rc_context(
    {
        "axes.axisbelow": True,
        "axes.edgecolor": INK,
        "axes.labelcolor": INK,
        "axes.spines.right": False,
        "axes.spines.top": False,
        "axes.titlesize": 11,
        "figure.titlesize": 12,
        "figure.titleweight": "bold",
        "grid.color": "#e5e7eb",
        "legend.fontsize": 9,
        "legend.frameon": False,
        "text.color": INK,
        "text.parse_math": False,
        "xtick.color": INK,
        "ytick.color": INK,
    }
)


def new_figure(width: float, height: float, title: str = "") -> Figure:
    """Return an empty figure of a width and height (inches) with a title above it."""
    figure = Figure(figsize=(width, height), layout="constrained")
    if title:
        figure.suptitle(legible(title))
    return figure


@framed
def save_figure(figure: Figure, path: str | os.PathLike[str]) -> Path:
    """Write a figure to a ``.png``, ``.svg`` or ``.pdf`` file, and return its path.

    Raises:
        OutputError: the path cannot be written, or has another suffix.
    """
    path = output_path(path, PLOT_SUFFIXES)
    with in_one_piece(path) as partial:
        figure.savefig(partial, dpi=_DPI)
    return path


def right_axis(axes: Axes) -> Axes:
    """Return axes with a second scale on the right."""
    right = axes.twinx()
    right.spines["right"].set_visible(True)
    return right


def name_rows(axes: Axes, names: Sequence[str]) -> None:
    """Name horizontal rows 0, 1, 2, ..., from the top down."""
    axes.set_yticks(range(len(names)), [legible(name) for name in names], fontsize=8.5)
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(len(names) - 0.4, -0.6)


def draw_runs(
    axes: Axes,
    x: Real[np.ndarray, " n"],
    runs: Float[np.ndarray, "runs n"],
    color: str,
    label: str = "",
    *,
    width: float = 2.0,
    band: bool = True,
    opacity: float = 1.0,
) -> None:
    """Draw the median of runs and the band in which half of them lie.

    Args:
        axes: axes of the drawing.
        x: horizontal positions of the columns of ``runs``.
        runs: one row for each run. Values that are not finite are left out.
        color: colour of the line and the band.
        label: label of the line.
        width: width of the line, points.
        band: whether to draw the band. Its opacity is at most 0.16, so that bands may overlap.
        opacity: desired opacity of the band.
    """
    known = np.isfinite(runs).any(0)
    if not known.any():
        return
    finite = np.where(np.isfinite(runs), runs, np.nan)[:, known]
    low, median, high = np.nanquantile(finite, (0.25, 0.5, 0.75), axis=0)
    if band and len(runs) > 1:
        axes.fill_between(x[known], low, high, color=color, alpha=min(opacity, 0.16), lw=0)
    axes.plot(x[known], median, color=color, lw=width, label=label, solid_capstyle="butt")


def draw_stances(
    axes: Axes,
    stances: Float[np.ndarray, "n 2"],
    window: tuple[float, float],
    row: float,
    height: float,
    color: str,
) -> None:
    """Draw the stances of a foot as bars (Hildebrand 1965) around a row, with time (s) across.

    Args:
        axes: axes of the drawing.
        stances: beginning and end of each stance, s.
        window: first and last instant that the axes show, s.
        row: middle of the bars.
        height: height of the bars.
        color: colour of the bars.
    """
    shown = stances[(stances[:, 1] > window[0]) & (stances[:, 0] < window[1])].clip(*window)
    bars = [(begin, end - begin) for begin, end in shown]
    axes.broken_barh(bars, (row - height / 2, height), facecolors=color)
