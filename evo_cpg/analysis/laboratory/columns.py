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
        decades: whether values often span decades, so that a picture needs a logarithmic axis.
        cycle: length of a cycle, for a phase, or 0.
    """

    key: str
    head: str
    label: str
    decades: bool = False
    cycle: float = 0.0


SWIMMING = (
    Column("path_speed", "U m/s", "speed along the path (m/s)"),
    Column("stride_frequency", "f Hz", "frequency (Hz)"),
    Column("strouhal", "St", "Strouhal number"),
    Column("wave_slip", "U/V", "slip U/V"),
    Column("froude_efficiency", "eta", "Froude efficiency"),
    Column("cost_of_transport", "CoT", "cost of transport", decades=True),
    Column("power", "P W", "mean power of the motors (W)", decades=True),
    Column("tail_excursion", "A m", "tail, peak to peak (m)"),
    Column("travelling_index", "travel", "travelling index"),
    Column("duty_factor", "duty", "duty factor"),
)

FLUME = (Column("ground_speed", "ground m/s", "speed over ground (m/s)"), *SWIMMING)

CUT = (
    SWIMMING[0],
    Column("front_frequency", "f1 Hz", "frequency in front of the cut (Hz)"),
    Column("behind_frequency", "f2 Hz", "frequency behind the cut (Hz)"),
    Column("cut_lag", "lag deg", "lag at the cut (degrees)", cycle=360.0),
    Column("cut_scatter", "scatter", "scatter of the lag (cycles)"),
    *SWIMMING[1:],
)

TOWED = (
    Column("holding_force", "F N", "mean force that holds it, forwards (N)"),
    Column("straight_drag", "D N", "drag of the straight body (N)"),
    Column("thrust", "T N", "thrust (N)"),
    Column("net_power", "P W", "mean net power of the motors (W)"),
    Column("efficiency", "eta", "efficiency of the thrust"),
    Column("holding_sway", "side N", "sideways force that holds it, rms (N)"),
    Column("holding_yaw", "yaw N m", "moment that holds its heading, rms (N m)"),
    Column("stride_frequency", "f Hz", "frequency (Hz)"),
)

CORD = (
    Column("rest_frequency", "f0 Hz", "frequency without bending (Hz)"),
    Column("frequency", "f Hz", "frequency (Hz)"),
    Column("followed", "f/fb", "frequency: cord / bending"),
    Column("phase", "phase", "phase behind the bending (cycles)", cycle=1.0),
    Column("scatter", "scatter", "scatter of the phase (cycles)"),
    Column("entrained", "1:1", "entrained 1:1 (1 or 0)"),
)


def shown_columns(rows: Sequence[Mapping[str, Any]]) -> list[Column]:
    """Return the measures that exist under at least one setting, the most important first."""
    names = {name for row in rows for name in row}
    kinds = {"entrained": CORD, "holding_force": TOWED, "current": FLUME, "cut_lag": CUT}
    kind = next((kind for name, kind in kinds.items() if name in names), SWIMMING)
    return [
        column
        for column in kind
        if any(math.isfinite(row.get(column.key, math.nan)) for row in rows)
    ]
