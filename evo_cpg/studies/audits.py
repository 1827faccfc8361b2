"""Tables of the audits of a study's champions."""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from evo_cpg.studies.study import Part, Table, middle, percent, tabled

if TYPE_CHECKING:
    from evo_cpg.studies.workshop import Workshop

# Head of the column for each check, which shows the fraction of the displacement that is kept.
_KEPT = {
    "pose": "in other poses or draws",
    "half_step": "at half the step",
    "quarter_step": "at a quarter",
    "friction": "friction 10 % off",
    "drag": "drag 10 % off",
}


def audit_part(title: str, shown: Mapping[str, str], *, medians: bool = False) -> Part:
    """Return a part that audits the champions of runs.

    Args:
        title: title of the part.
        shown: names of the runs, by their names in tables.
        medians: add a table of medians and ranges.
    """

    def report(workshop: "Workshop") -> list[Table]:
        rows = {called: audited(workshop, name) for called, name in shown.items()}
        if not medians:
            return [audit_table("", rows)]
        return [kept_table("Medians and ranges:", rows), audit_table("Every champion:", rows)]

    return Part(title, tuple(shown.values()), report)


def audited(workshop: "Workshop", name: str) -> list[dict[str, Any]]:
    """Return a row for the audit of each champion of a run, or only of the first if quick."""

    def measure() -> list[dict[str, Any]]:
        from evo_cpg.api.audit import audits

        member = workshop.member(name)
        champions = workshop.champions(name)[: 1 if workshop.quick else None]
        config, source = member.config, member.source
        made = audits(member.experiment, champions, config.audit.limits(), config, source)
        return [
            {
                "seed": member.experiment.seed + champion.run,
                "passed": done.verdict.passed,
                "reasons": done.verdict.reasons,
                "measured": {
                    key: value if np.isfinite(value) else None
                    for key, value in done.measured.items()
                },
                "opinions": [
                    {"program": one.program, "way": one.displacement, "upright": one.upright}
                    for one in done.opinions
                ],
            }
            for champion, done in zip(champions, made, strict=True)
        ]

    return workshop.kept(f"audit_{name}", [name], measure)


def audit_table(title: str, rows: dict[str, list[dict[str, Any]]]) -> Table:
    """Return a table with a row for each champion.

    Args:
        title: title above the table.
        rows: rows from `audited`, by the name of their runs in the table.
    """
    every = [row for found in rows.values() for row in found]
    keys = [key for key in _KEPT if any(key in row["measured"] for row in every)]
    programs = list(dict.fromkeys(one["program"] for row in every for one in _others(row)))
    lines = []
    for name, row in ((name, row) for name, found in rows.items() for row in found):
        measured, goes = row["measured"], {one["program"]: one["way"] for one in _others(row)}
        lines.append(
            {"": name, "seed": str(row["seed"]), "displacement, m": _number(measured.get("way"))}
            | {_KEPT[key]: _percent(measured.get(key)) for key in keys}
            | {f"{program}: over ground, m": _number(goes.get(program)) for program in programs}
            | {"passes": "yes" if row["passed"] else "no: " + "; ".join(row["reasons"])}
        )
    return tabled(lines, title)


def kept_table(title: str, rows: dict[str, list[dict[str, Any]]]) -> Table:
    """Return a table with a row for each run: medians and ranges of its champions.

    The column for MuJoCo shows its last opinion, which is closest to our own simulation.
    """
    lines = []
    for name, found in rows.items():
        line = {
            "": name,
            "displacement, m": middle(_known(row["measured"].get("way") for row in found)),
        }
        for key, head in _KEPT.items():
            line[head] = _percents(row["measured"].get(key) for row in found)
        line["in MuJoCo"] = _percents(map(_second_opinion, found))
        line["pass"] = f"{sum(row['passed'] for row in found)} of {len(found)}"
        lines.append(line)
    return tabled(lines, title)


def _known(values: Iterable[float | None]) -> list[float]:
    return [value for value in values if value is not None]


def _percents(values: Iterable[float | None]) -> str:
    """Return median and range of fractions, in per cent."""
    known = _known(values)
    return f"{middle(100 * np.array(known), 0)} %" if known else ""


def _others(row: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the opinions of other programs. The first opinion is our own."""
    return row["opinions"][1:]


def _second_opinion(row: dict[str, Any]) -> float | None:
    """Return the displacement in the last other program, relative to ours, or None without one."""
    others = _others(row)
    return others[-1]["way"] / row["opinions"][0]["way"] if others else None


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


def _percent(value: float | None) -> str:
    return "" if value is None else percent(value)
