"""Measures that a table on the terminal and a picture show. The file has all of them."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple


class Column(NamedTuple):
    """A measure in a table.

    Attributes:
        key: name of the measure in the rows.
        head: head of the column, at most 9 characters.
        label: name with unit.
    """

    key: str
    head: str
    label: str


COLUMNS = (
    Column("path_speed", "U m/s", "speed along the path (m/s)"),
    Column("stride_frequency", "f Hz", "frequency (Hz)"),
    Column("tail_excursion", "A m", "tail, peak to peak (m)"),
    Column("strouhal", "St", "Strouhal number"),
    Column("wave_slip", "U/V", "slip U/V"),
    Column("power", "P W", "mean power of the motors (W)"),
    Column("travelling_index", "travel", "travelling index"),
    Column("duty_factor", "duty", "duty factor"),
    Column("cost_of_transport", "CoT", "cost of transport"),
)


def shown_columns(rows: Sequence[Mapping[str, Any]]) -> list[Column]:
    """Return the measures that exist under at least one setting."""
    return [
        column
        for column in COLUMNS
        if any(math.isfinite(row.get(column.key, math.nan)) for row in rows)
    ]
