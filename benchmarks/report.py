"""The rows as tables on the screen."""

from collections.abc import Sequence
from typing import Any

from rich.table import Table

from benchmarks.compare import Verdict
from benchmarks.rows import SECONDS, Row

_SCALES = ((1e9, "G"), (1e6, "M"), (1e3, "k"))


def tables(rows: list[Row], machine: dict[str, Any]) -> tuple[Table, Table]:
    """Everything measured: what is known of ours, and who stands beside it.

    Args:
        rows: what was measured.
        machine: from `benchmarks.machine.describe`.
    """
    ours = _table(
        f"{machine['cores']} cores of {machine['processor']}",
        "n: individuals; error: docs/benchmarks.md says of what; peak: useful operations as a "
        f"share of the float32 matrix product's {amount(machine['float32_peak'])}FLOP/s",
        ("case", "n", "rate", "compile", "memory", "error", "peak"),
    )
    beside = _table(
        "beside its peers",
        "ratio: ours over theirs, median and quartiles over the rounds",
        ("case", "n", "peer", "theirs", "error", "ratio"),
        ("peer",),
    )
    known = set()
    for row in rows:
        if row.key[:3] not in known:
            ours.add_row(_name(row), str(row.size), *_ours(row))
            known.add(row.key[:3])
        if row.peer:
            beside.add_row(_name(row), str(row.size), *_theirs(row))
    return ours, beside


def comparison(verdict: Verdict, tolerance: float) -> Table:
    """What became of the earlier rows, slower ones marked.

    Args:
        verdict: from `benchmarks.compare.compare`.
        tolerance: largest share that a row may lose.
    """
    shown = _table(
        f"against the earlier run: {len(verdict.slower)} of {len(verdict.changes)} lost more than "
        f"{tolerance:.0%}",
        "rows beside a peer are compared by the ratio to it, others by their rate",
        ("case", "n", "compared", "then", "now", "speed"),
        ("compared",),
    )
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


def _table(title: str, caption: str, columns: Sequence[str], words: Sequence[str] = ()) -> Table:
    """An empty table; the columns of words, and the first, are set to the left."""
    shown = Table(title=title, caption=caption)
    for column in columns:
        left = column in (columns[0], *words)
        shown.add_column(column, justify="left" if left else "right", no_wrap=column == columns[0])
    return shown


def _name(row: Row) -> str:
    return f"{row.case}, {row.part}"


def _ours(row: Row) -> tuple[str, ...]:
    return (
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
