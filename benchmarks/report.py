"""The rows as tables, on the screen and for a page."""

from collections.abc import Sequence
from typing import Any

from rich import box
from rich.table import Table

from benchmarks import growth
from benchmarks.compare import Verdict
from benchmarks.rows import SECONDS, Row
from evo_cpg.studies.study import Table as PageTable

_SCALES = ((1e9, "G"), (1e6, "M"), (1e3, "k"))

# Packages whose versions a page's table names.
_PACKAGES = {
    "jax": "JAX",
    "mujoco": "MuJoCo",
    "mujoco-mjx": "MJX",
    "brax": "Brax",
    "evosax": "evosax",
}


def tables(rows: list[Row], machine: dict[str, Any]) -> tuple[Table, ...]:
    """Return tables of our results, the comparison with the peers, and the growth of costs.

    Args:
        rows: measured rows.
        machine: result of `benchmarks.machine.describe`.
    """
    ours = _table(
        f"cores of {machine['processor']}: {machine['cores']}",
        "n: individuals. rate: per second. memory: MiB. error: defined in docs/benchmarks.md. "
        "peak: useful operations, as a fraction of the float32 matrix product's "
        f"{amount(machine['float32_peak'])}FLOP/s",
        ("case", "n", "rate", "compile", "memory", "error", "peak"),
    )
    beside = _table(
        "compared with its peers",
        "ratio: ours over theirs, median over the rounds. spread: half the interquartile range of "
        "the ratio",
        ("case", "n", "peer", "theirs", "error", "ratio", "spread"),
        ("peer",),
    )
    known = set()
    for row in rows:
        if row.key[:3] not in known:
            ours.add_row(_name(row), str(row.size), *_ours(row))
            known.add(row.key[:3])
        if row.peer:
            beside.add_row(_name(row), str(row.size), *_theirs(row))
    return ours, beside, *map(_on_screen, growth.tables(rows))


def _on_screen(table: PageTable) -> Table:
    shown = Table(title=table.title, box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    for name in table.head:
        shown.add_column(name, justify="left" if name == table.head[0] else "right")
    for cells in table.rows:
        shown.add_row(*cells)
    return shown


def line(row: Row) -> str:
    """Return a short line about a row, to report progress."""
    words = f"{_name(row)}, {row.size}: {_with_unit(row.rate, row.unit)}"
    if row.peer is None:
        return words
    return f"{words}, {times(row.ratio)} {row.peer}" if row.ratio else f"{words}, no {row.peer}"


def page_tables(rows: list[Row], machine: dict[str, Any]) -> list[PageTable]:
    """Return tables of our results and, if there are peers, of the comparison with them.

    Columns without any value are left out. If there are creatures of many bodies, only their tables
    of `benchmarks.growth` are returned.

    Args:
        rows: measured rows.
        machine: result of `benchmarks.machine.describe`.
    """
    if grown := growth.tables(rows):
        return grown
    units = sorted({row.unit for row in rows})
    # If all rows have the same unit, the unit stands in the heading.
    head, cell = (f", {units[0]}", _rate) if len(units) == 1 else ("", _with_unit)
    ours: dict[Any, list[str]] = {}
    beside = []
    for row in rows:
        name = [row.part, str(row.size)]
        ours.setdefault(row.key[:3], [*name, cell(row.rate, row.unit), *_ours(row)[1:]])
        if row.peer:
            theirs = cell(row.peer_rate, row.unit) if row.peer_rate else row.note or "none"
            ratio = times(row.ratio) if row.ratio else ""
            if row.ratio and row.ratio_spread:
                ratio += f" ({' to '.join(map(times, row.ratio_spread))})"
            beside.append([*name, row.peer, theirs, _error(row.peer_error), ratio])
    versions = [
        f"{words} {machine['versions'][name]}"
        for name, words in _PACKAGES.items()
        if machine["versions"].get(name)
    ]
    title = f"Peak: {amount(machine['float32_peak'])}FLOP/s; {', '.join(versions)}."
    names = ["", "n", f"ours{head}", "compile", "memory, MiB", "error", "of the peak"]
    found = [_known_columns(title, names, list(ours.values()))]
    if beside:
        names = ["", "n", "beside", f"theirs{head}", "error", "ratio (quartiles)"]
        found.append(_known_columns("Beside others:", names, beside))
    return found


def _known_columns(title: str, head: list[str], rows: list[list[str]]) -> PageTable:
    kept = [place for place in range(len(head)) if any(row[place] for row in rows)]
    return PageTable(title, [head[i] for i in kept], [[row[i] for i in kept] for row in rows])


def notes(rows: list[Row]) -> list[str]:
    """Return reasons why peers or rows have no rate, and other remarks, one per line."""
    lines = [
        f"{row.case}, {row.size}, {row.peer or row.part}: {row.note}" for row in rows if row.note
    ]
    return list(dict.fromkeys(lines))


def comparison(verdict: Verdict, tolerance: float) -> Table:
    """Return the comparison with the earlier rows, with slower rows marked.

    Args:
        verdict: result of `benchmarks.compare.compare`.
        tolerance: largest fraction that a row may lose.
    """
    shown = _table(
        f"against the earlier run: {len(verdict.slower)} of {len(verdict.changes)} lost more than "
        f"{tolerance:.0%}",
        "Rows with a peer are compared by their ratio to the peer, other rows by their rate.",
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
    """Return a number with at most three significant digits, a space, and k, M, G or nothing."""
    for scale, letter in _SCALES:
        if value >= scale:
            return f"{value / scale:.3g} {letter}"
    return f"{value:.3g} "


def _table(title: str, caption: str, columns: Sequence[str], words: Sequence[str] = ()) -> Table:
    """Return an empty table, with the first column and the columns of words set to the left."""
    shown = Table(
        title=title, caption=caption, box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True
    )
    for column in columns:
        left = column in (columns[0], *words)
        # A narrow terminal may break words, but not numbers.
        whole = column not in words
        shown.add_column(column, justify="left" if left else "right", no_wrap=whole)
    return shown


def _name(row: Row) -> str:
    return f"{row.case}, {row.part}"


def _ours(row: Row) -> tuple[str, ...]:
    return (
        _rate(row.rate, row.unit),
        f"{row.compile_seconds:.0f} s" if row.compile_seconds is not None else "",
        f"{row.memory / 2**20:.0f}" if row.memory else "",
        _error(row.error),
        f"{row.peak_share:.1%}" if row.peak_share else "",
    )


def _theirs(row: Row) -> tuple[str, ...]:
    rate = _rate(row.peer_rate, row.unit) if row.peer_rate else "none"
    ratio = times(row.ratio) if row.ratio else ""
    spread = ""
    if row.ratio and row.ratio_spread:
        low, high = row.ratio_spread
        spread = f"{(high - low) / 2 / row.ratio:.0%}"
    return row.peer or "", rate, _error(row.peer_error), ratio, spread


def times(ratio: float) -> str:
    """Return a ratio and an x: three significant digits at most, or a whole number from 1000 on."""
    return f"{ratio:,.0f}x" if ratio >= 1000 else f"{ratio:.3g}x"


def _rate(value: float, unit: str) -> str:
    # A row whose process failed has the rate 0.
    if not value:
        return "none"
    if unit == SECONDS:
        return f"{value:.2f} s"
    return amount(value).strip()


def _with_unit(value: float, unit: str) -> str:
    return _rate(value, unit) if unit == SECONDS or not value else f"{_rate(value, unit)} {unit}"


def _error(value: float | None) -> str:
    return f"{value:.2g}" if value is not None else ""
