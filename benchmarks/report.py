"""The rows as tables on the screen."""

from typing import Any

from rich.table import Table

from benchmarks.compare import Verdict
from benchmarks.rows import SECONDS, Row

_SCALES = ((1e9, "G"), (1e6, "M"), (1e3, "k"))


def table(rows: list[Row], machine: dict[str, Any]) -> Table:
    """Everything measured, a line per row.

    Args:
        rows: what was measured.
        machine: from `benchmarks.machine.describe`.
    """
    shown = Table(
        title=f"{machine['cores']} cores of {machine['processor']}, float32 matrix product "
        f"{amount(machine['float32_peak'])}FLOP/s",
        caption="n: individuals; error: see docs/benchmarks.md; peak: useful operations per second "
        "as a share of the matrix product's; ratio: median and quartiles over the rounds",
    )
    columns = ("case", "n", "ours", "compile", "memory", "error", "peak", "beside", "theirs")
    for column in (*columns, "error", "ratio"):
        left = column in ("case", "beside", "theirs")
        shown.add_column(column, justify="left" if left else "right")
    last = None
    for row in rows:
        known = last is not None and last[:3] == row.key[:3]
        shown.add_row(*(("",) * 7 if known else _ours(row)), *_theirs(row))
        last = row.key
    return shown


def comparison(verdict: Verdict, tolerance: float) -> Table:
    """What became of the earlier rows, slower ones marked.

    Args:
        verdict: from `benchmarks.compare.compare`.
        tolerance: largest share that a row may lose.
    """
    shown = Table(
        title=f"against the earlier run: {len(verdict.slower)} of {len(verdict.changes)} lost more "
        f"than {tolerance:.0%}",
        caption="rows beside a peer are compared by the ratio to it, others by their rate",
    )
    for column in ("case", "n", "compared", "then", "now", "speed"):
        left = column in ("case", "compared")
        shown.add_column(column, justify="left" if left else "right")
    for change in verdict.changes:
        row = change.row
        shown.add_row(
            _name(row),
            str(row.size),
            change.kind,
            f"{change.then:,.4g}",
            f"{change.now:,.4g}",
            f"{change.gain:.2f}x{' SLOWER' if change.slower else ''}",
            style="bold red" if change.slower else None,
        )
    return shown


def amount(value: float) -> str:
    """A number with three digits and k, M or G."""
    for scale, letter in _SCALES:
        if value >= scale:
            return f"{value / scale:.3g} {letter}"
    return f"{value:.3g} "


def _name(row: Row) -> str:
    return f"{row.case}, {row.part}"


def _ours(row: Row) -> tuple[str, ...]:
    return (
        _name(row),
        str(row.size),
        _rate(row.rate, row.unit),
        f"{row.compile_seconds:.1f} s" if row.compile_seconds is not None else "",
        f"{row.memory / 2**20:.0f} MiB" if row.memory else "",
        _error(row.error),
        f"{row.peak_share:.1%}" if row.peak_share else "",
    )


def _theirs(row: Row) -> tuple[str, ...]:
    rate = _rate(row.peer_rate, row.unit) if row.peer_rate else ""
    ratio = f"{row.ratio:.3g}x" if row.ratio else ""
    if row.ratio_spread:
        low, high = row.ratio_spread
        ratio += f" ({low:.3g} to {high:.3g})"
    words = "; ".join(filter(None, [rate, row.note]))
    return row.peer or "", words, _error(row.peer_error), ratio


def _rate(value: float, unit: str) -> str:
    if unit == SECONDS:
        return f"{value:.2f} s"
    return f"{amount(value)}{unit.removeprefix('steps').removeprefix('control steps')}"


def _error(value: float | None) -> str:
    return f"{value:.2g}" if value is not None else ""
