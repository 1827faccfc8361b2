"""A picture of the rates: bars for us and for every peer of each case, on a logarithmic axis."""

import re
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from benchmarks.moving import PHYSICS, UNIT, WHOLE
from benchmarks.report import amount, times
from benchmarks.rows import Row
from evo_cpg.files import in_one_piece
from evo_cpg.view.output import output_path

SUFFIXES = (".png", ".svg", ".pdf")
# Okabe and Ito's palette for us, MuJoCo and others, and a grey for text.
_BLUE, _ORANGE, _GREEN, _GREY = "#0072B2", "#E69F00", "#009E73", "#6b7280"
# 900 pixels wide.
_WIDTH, _DPI = 7.5, 120
# Heights in inches: a bar, the gap between cases, and the rest.
_BAR, _GAP, _REST = 0.27, 0.35, 1.1
# Limits of the axis, as factors on the least and largest rate. The least bar needs some length, and
# the text of the longest bar needs room.
_LEFT, _RIGHT = 0.4, 30.0
# Longest text at a bar, characters.
_WORDS = 48
# A note that starts with the name of a Python error, and the words in its place.
_ERROR, _STOPPED = re.compile(r"\w+(Error|Exception)\b"), "stopped with an error"

Bar = tuple[str, float | None, str, str]


def draw(rows: list[Row], machine: dict[str, Any], path: Path) -> Path:
    """Draw every case with a moving animal, each at the size with the most rows.

    Args:
        rows: measured rows.
        machine: result of `benchmarks.machine.describe`.
        path: name that ends in `.png`, `.svg` or `.pdf`.

    Returns:
        The path.

    Raises:
        OutputError: the path cannot be written, or is not of this kind.
    """
    path = output_path(path, SUFFIXES)
    groups = {title: bars for title, bars in _groups(rows) if bars}
    lengths = [len(bars) for bars in groups.values()] or [1]
    height = sum(lengths) * _BAR + len(lengths) * _GAP + _REST
    figure = Figure(figsize=(_WIDTH, height), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    values = [bar[1] for bars in groups.values() for bar in bars if bar[1]] or [1.0]
    limits = min(values) * _LEFT, max(values) * _RIGHT
    heights = [count * _BAR + _GAP for count in lengths]
    panels = figure.subplots(len(lengths), height_ratios=heights, sharex=True, squeeze=False)
    for axes, (title, bars) in zip(panels[:, 0], groups.items(), strict=False):
        _panel(axes, title, bars, limits)
    panels[-1, 0].set_xlabel("individual physics steps per second", fontsize=10)
    figure.suptitle(
        f"{machine['processor']}, cores: {machine['cores']}\nratios: our physics over theirs",
        fontsize=9,
        color=_GREY,
    )
    with in_one_piece(path) as partial:
        figure.savefig(partial, dpi=_DPI)
    return path


def _groups(rows: list[Row]) -> list[tuple[str, list[Bar]]]:
    """Return the title and the bars of every animal."""
    moving = [row for row in rows if row.part in (PHYSICS, WHOLE) and row.unit == UNIT]
    groups = []
    for case in dict.fromkeys(row.case for row in moving):
        own = [row for row in moving if row.case == case]
        peers = {size: sum(row.size == size for row in own) for size in (r.size for r in own)}
        size = max(peers, key=lambda size: peers[size])
        groups.append((f"{case}, {size} individuals", _bars([r for r in own if r.size == size])))
    return groups


def _bars(rows: list[Row]) -> list[Bar]:
    """Return label, rate (None if unknown), text at the end, and colour of each bar, ours first."""
    ours = {row.part: row for row in rows}
    bars: list[Bar] = [
        (f"ours, {part}", row.rate, amount(row.rate).strip(), _BLUE) for part, row in ours.items()
    ]
    for row in rows:
        if row.part == PHYSICS and row.peer:
            color = _ORANGE if row.peer.startswith("MuJoCo") else _GREEN
            if row.peer_rate and row.ratio:
                words = f"{amount(row.peer_rate).strip()}   {times(row.ratio)}"
                words += f"   {row.note}" if row.note else ""
            else:
                # The table holds the message of the error.
                words = _STOPPED if _ERROR.match(row.note or "") else row.note or ""
            bars.append((row.peer, row.peer_rate, words, color))
    return bars


def _panel(axes: Axes, title: str, bars: list[Bar], limits: tuple[float, float]) -> None:
    axes.set_xscale("log")
    axes.set_xlim(*limits)
    for place, (_, rate, words, color) in enumerate(bars):
        axes.barh(place, rate or limits[0], height=0.72, color=color, left=0)
        short = words if len(words) < _WORDS else words[: _WORDS - 3] + "..."
        axes.text(
            (rate or limits[0]) * 1.1,
            place,
            short,
            va="center",
            fontsize=10,
            color="black" if rate else _GREY,
        )
    axes.set_yticks(range(len(bars)), [bar[0] for bar in bars], fontsize=10)
    axes.invert_yaxis()
    axes.set_title(title, loc="left", fontsize=11, fontweight="bold")
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x", alpha=0.3)
    axes.set_axisbelow(True)
    axes.spines[["top", "right", "left"]].set_visible(False)
