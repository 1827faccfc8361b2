"""Pictures of parameters: elasticities of a result, and the agreement of a fit with its data."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from evo_cpg.analysis.sensitivity import CHANGE, Sensitivity
from evo_cpg.view.figure import (
    BLUE,
    INK,
    LIGHT_GREY,
    RED,
    framed,
    name_rows,
    new_figure,
)
from evo_cpg.view.legible import legible

_MORE, _LESS, _DOUBTFUL = BLUE, RED, "#d1d5db"

# Sizes of the sensitivity picture in inches: width, height of a bar, and height of the rest.
_WIDTH, _BAR, _REST = 8.6, 0.27, 1.9


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
    figure = new_figure(_WIDTH, _REST + _BAR * len(shown), title)
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


@framed
def fit_figure(
    time: np.ndarray, columns: Sequence[str], data: np.ndarray, fitted: np.ndarray
) -> Figure:
    """Draw every column over time: the recording as dots, the fitted simulation as a line.

    Args:
        time: instants, s.
        columns: names of the columns: ``x``, ``y`` and ``z`` in m, others in rad.
        data: recorded values ``(t, c)``.
        fitted: simulated values ``(t, c)``.
    """
    figure = new_figure(7.4, 0.9 + 1.5 * len(columns))
    rows = figure.subplots(len(columns), 1, sharex=True, squeeze=False)[:, 0]
    for axes, name, own, model in zip(rows, columns, data.T, fitted.T, strict=True):
        axes.plot(time, own, "o", ms=3, color=LIGHT_GREY, label="recorded")
        axes.plot(time, model, color=RED, lw=1.6, label="fitted")
        axes.set_ylabel(f"{legible(name)} ({'m' if name in 'xyz' else 'rad'})")
        axes.grid()
    rows[-1].set_xlabel("time (s)")
    figure.legend(*rows[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure
