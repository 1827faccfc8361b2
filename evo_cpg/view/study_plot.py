"""Pictures of studies: the best of every generation by setting, and champions as dots."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from evo_cpg.files import in_one_piece
from evo_cpg.view.output import PLOT_SUFFIXES, output_path

# Okabe and Ito's colours without yellow, which is too faint for a line on white.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#E69F00", "#CC79A7", "#56B4E9", "#000000")

_HEIGHT, _DPI = 4.6, 130


def plot_generations(
    bests: Mapping[str, Float[np.ndarray, "generations runs"]],
    label: str,
    path: str | os.PathLike[str],
    single_runs: bool = False,
) -> Path:
    """Draw the best of every generation: medians over the runs, and where half of these lie.

    Args:
        bests: by what each setting is called.
        label: what is drawn, with its unit.
        path: ``.png``, ``.svg`` or ``.pdf``.
        single_runs: draw each of the runs, too, as a thin line.

    Returns:
        The path.

    Raises:
        OutputError: nothing can be written there, or not this kind of file.
    """
    figure, axes = _panel(8)
    runs = max(best.shape[1] for best in bests.values())
    for number, (name, best) in enumerate(bests.items()):
        colour = _COLOURS[number % len(_COLOURS)]
        generation = np.arange(len(best))
        known = np.isfinite(best).any(1)
        low, middle, high = np.nanquantile(best[known], (0.25, 0.5, 0.75), axis=1)
        if single_runs:
            axes.plot(generation, best, color=colour, lw=0.5, alpha=0.3)
        axes.fill_between(generation[known], low, high, color=colour, alpha=0.15, lw=0)
        axes.plot(generation[known], middle, color=colour, lw=2, label=name)
    axes.set_xlabel("generation")
    axes.set_ylabel(label)
    axes.set_ylim(bottom=0)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    title = f"median of {runs} runs, half of them in the band" if runs > 1 else None
    axes.legend(frameon=False, title=title)
    return _save(figure, path)


def plot_champions(
    groups: Mapping[str, tuple[Sequence[float], Sequence[float]]],
    labels: tuple[str, str],
    path: str | os.PathLike[str],
) -> Path:
    """Draw a dot for every champion.

    Args:
        groups: what stands across and upwards, by what each group is called; the second of every
            two has the colour of the first, and is filled.
        labels: of the axes, with units.
        path: ``.png``, ``.svg`` or ``.pdf``.

    Returns:
        The path.

    Raises:
        OutputError: nothing can be written there, or not this kind of file.
    """
    figure, axes = _panel(6.5)
    for number, (name, (across, upwards)) in enumerate(groups.items()):
        colour = _COLOURS[number // 2 % len(_COLOURS)]
        fill = colour if number % 2 else "none"
        axes.scatter(across, upwards, edgecolors=colour, facecolors=fill, label=name)
    axes.set_xlabel(labels[0])
    axes.set_ylabel(labels[1])
    axes.set_ylim(bottom=0)
    figure.legend(frameon=False, ncols=2, loc="outside upper center")
    return _save(figure, path)


def _panel(width: float) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(width, _HEIGHT), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.grid(alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)
    return figure, axes


def _save(figure: Figure, path: str | os.PathLike[str]) -> Path:
    place = output_path(path, PLOT_SUFFIXES)
    with in_one_piece(place) as partial:
        figure.savefig(partial, dpi=_DPI)
    return place
