"""Find the rows that became slower since an earlier run.

Rows with a peer are compared by their ratio to the peer, because a slow machine slows both. Other
rows are compared by their rates.
"""

from typing import Any, NamedTuple

from benchmarks.rows import SECONDS, Row


class Change(NamedTuple):
    """A row of the present run, compared with the same row of the earlier run.

    Attributes:
        row: row of the present run.
        kind: "ratio to NAME" or the unit of the rate.
        then: rate or ratio of the earlier run.
        now: rate or ratio of the present run.
        gain: present speed, or ratio to the peer, over the earlier one. Below 1 is slower.
        slower: whether the loss exceeds the tolerance.
    """

    row: Row
    kind: str
    then: float
    now: float
    gain: float
    slower: bool


class Verdict(NamedTuple):
    """Comparison of all rows that both runs have.

    Attributes:
        changes: one change for each row.
        remarks: phrases about differences between the runs.
    """

    changes: list[Change]
    remarks: list[str]

    @property
    def slower(self) -> list[Change]:
        """Return the changes whose loss of speed exceeds the tolerance."""
        return [change for change in self.changes if change.slower]


def compare(
    then: tuple[dict[str, Any], list[Row]], now: tuple[dict[str, Any], list[Row]], tolerance: float
) -> Verdict:
    """Compare all rows that both runs have.

    Args:
        then: machine and rows of the earlier run.
        now: machine and rows of this run.
        tolerance: largest fraction that a rate or ratio may lose.
    """
    earlier = {row.key: row for row in then[1]}
    changes = [_change(earlier[row.key], row, tolerance) for row in now[1] if row.key in earlier]
    remarks = []
    alone = len(now[1]) - len(changes)
    if alone:
        remarks.append(f"{alone} of {len(now[1])} rows have no counterpart in the earlier run")
    for key, what in (("processor", "processor"), ("cores", "number of cores")):
        if then[0].get(key) != now[0].get(key):
            remarks.append(f"the earlier run had another {what}: {then[0].get(key)}")
    if then[0].get("quick") != now[0].get("quick"):
        remarks.append("one run was quick and the other was not: their calls differ in length")
    return Verdict(changes, remarks)


def _change(then: Row, now: Row, tolerance: float) -> Change:
    if then.ratio and now.ratio:
        kind, before, after = f"ratio to {now.peer}", then.ratio, now.ratio
        gain = after / before
    else:
        kind, before, after = now.unit, then.rate, now.rate
        old, new = (after, before) if now.unit == SECONDS else (before, after)
        gain = new / old if old else 1.0
    return Change(now, kind, before, after, gain, gain < 1 - tolerance)
