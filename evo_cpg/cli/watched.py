"""Display of `watch` on a terminal: numbers, and curves of 2 by 4 Braille dots per character."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from evo_cpg.live.standing import duration
from evo_cpg.training.run_folder import RunFolder

if TYPE_CHECKING:
    from evo_cpg.live.standing import Standing

_HEIGHT, _MARGIN = 9, 16
_COLORS = (("champion", "bright_blue"), ("mean", "grey58"))

_BLANK = 0x2800
# Bit of each dot in the code of a Braille character, by column and by row from above.
_BITS = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))


def panel(folder: RunFolder, now: "Standing", width: int) -> RenderableType:
    """Return a panel with the numbers and curves of a run."""
    checkpoint = now.checkpoint
    name = Text(str(folder.path))
    if checkpoint is None or not checkpoint.history:
        return Panel(Text("no generation is finished yet"), title=name, title_align="left")
    columns = _over_generations(checkpoint.history)
    plots = [
        part for key, color in _COLORS for part in _plot(key, columns[key], width - _MARGIN, color)
    ]
    inner = Group(_table(now), Text(), *plots)
    return Panel(inner, title=name, title_align="left", subtitle="Ctrl-C ends this display only")


def _over_generations(history: list[dict[str, float]]) -> dict[str, np.ndarray]:
    """Return the best champion and the mean of the means over runs, for each generation."""
    instants = np.array([row["generation"] for row in history])
    found = {}
    for key, over in (("champion", np.nanmax), ("mean", np.nanmean)):
        values = np.array([row[key] for row in history], float)
        found[key] = np.array(
            [
                over(own) if np.isfinite(own := values[instants == g]).any() else math.nan
                for g in np.unique(instants)
            ]
        )
    return found


def _plot(key: str, values: np.ndarray, width: int, color: str) -> list[Text]:
    """Return lines of a curve, labelled with its highest and lowest value."""
    lines = curve(values.tolist(), max(width, 10), _HEIGHT // (1 if key == "champion" else 2))
    finite = values[np.isfinite(values)]
    marks = [""] * len(lines)
    if len(finite):
        marks[0], marks[-1] = f"{finite.max():.4g}", f"{finite.min():.4g}"
    made = [Text(key, style="bold")]
    for mark, line in zip(marks, lines, strict=True):
        made.append(Text.assemble((f"{mark:>10} ", "dim"), (line, color)))
    return made


def _table(now: "Standing") -> Table:
    assert now.checkpoint is not None
    history, champion = now.checkpoint.history, now.checkpoint.champion
    rows = [row for row in history if row["generation"] == history[-1]["generation"]]
    table = Table.grid(padding=(0, 3))
    done, left, seconds = now.checkpoint.generation, now.left, now.seconds
    when = "finished" if not left else f"about {duration(left * seconds)} to go"
    table.add_row(
        Text(f"{done}/{now.generations} generations", style="bold"), f"{seconds:.3g} s each", when
    )
    if now.quiet:
        table.add_row(Text(f"no new generation for {now.quiet}", style="yellow"), "", "")
    if champion is not None:
        whose = f" of run {champion.run}" if len(now.checkpoint.champions) > 1 else ""
        table.add_row(
            f"champion {champion.worth:.4f}",
            f"of generation {champion.generation} (the first is 0){whose}",
            ", ".join(f"{name} {value:.3g}" for name, value in champion.terms.items()),
        )
    mean = np.mean([row["mean"] for row in rows])
    diverged = int(sum(row["diverged"] for row in rows))
    table.add_row(f"mean {mean:.4f}", f"diverged {diverged}", "")
    return table


def curve(values: Sequence[float], width: int, height: int) -> list[str]:
    """Return lines of text in which a curve runs from left to right.

    Args:
        values: values at equal steps. A value that is not finite leaves a gap.
        width: number of characters of a line.
        height: number of lines.

    Returns:
        Lines from top to bottom, all blank if no value is finite.
    """
    given = np.asarray(values, float)
    cells = np.zeros((height, width), int)
    across, down = 2 * width, 4 * height
    finite = given[np.isfinite(given)]
    if not len(finite):
        return [chr(_BLANK) * width] * height
    low, high = float(finite.min()), float(finite.max())
    scale = (down - 1) / (high - low) if high > low else 0.0
    place = np.linspace(0, len(given) - 1, across) if len(given) > 1 else np.zeros(across)
    before = math.nan
    for column, at in enumerate(place):
        value = float(given[round(at)])
        if math.isfinite(value):
            row = down - 1 - round((value - low) * scale)
            # Fill the dots between two values, so that a steep curve stays connected.
            start = row if math.isnan(before) else int(before)
            for dot in range(min(start, row), max(start, row) + 1):
                cells[dot // 4, column // 2] |= _BITS[column % 2][dot % 4]
            before = row
        else:
            before = math.nan
    return ["".join(chr(_BLANK + cell) for cell in line) for line in cells.tolist()]
