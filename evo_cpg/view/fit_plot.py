"""A picture of a recorded motion and the simulation that was fitted to it."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from evo_cpg.files import in_one_piece
from evo_cpg.view.legible import legible
from evo_cpg.view.output import PLOT_SUFFIXES, output_path

_INK, _DATA, _MODEL = "#1f2937", "#9ca3af", "#D55E00"
_WIDTH, _ROW, _REST = 7.4, 1.5, 0.9
_ANGLE, _PLACES = "rad", {"x": "m", "y": "m", "z": "m"}


def plot_fit(
    time: np.ndarray,
    columns: Sequence[str],
    data: np.ndarray,
    fitted: np.ndarray,
    path: str | os.PathLike[str],
) -> Path:
    """Draw every column over time: what was measured as dots, the fitted simulation as a line.

    Args:
        time: s.
        columns: names.
        data: ``(t, c)``.
        fitted: likewise.
        path: ``.png``, ``.svg`` or ``.pdf``.

    Raises:
        OutputError: nothing can be written there, or not this kind of file.
    """
    path = output_path(path, PLOT_SUFFIXES)
    figure = Figure(figsize=(_WIDTH, _REST + _ROW * len(columns)), layout="constrained")
    FigureCanvasAgg(figure)
    rows = figure.subplots(len(columns), 1, sharex=True, squeeze=False)[:, 0]
    for axes, name, own, model in zip(rows, columns, data.T, fitted.T, strict=True):
        axes.plot(time, own, "o", ms=3, color=_DATA, label="recorded")
        axes.plot(time, model, color=_MODEL, lw=1.6, label="fitted")
        unit = _PLACES.get(name, _ANGLE)
        axes.set_ylabel(f"{legible(name)} ({unit})", color=_INK, parse_math=False)
        axes.grid(color="#e5e7eb", lw=0.8)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    rows[-1].set_xlabel("time (s)", color=_INK)
    handles, labels = rows[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=2, frameon=False)
    with in_one_piece(path) as partial:
        figure.savefig(partial, dpi=160)
    return path
