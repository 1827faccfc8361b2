"""The audits of a study's champions, as a table."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from evo_cpg.studies.study import Part, Table, middle, percent

if TYPE_CHECKING:
    from evo_cpg.studies.workshop import Workshop

# Checks that a table shows as shares of the way, and what each is called there.
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
        title: of the part.
        shown: names of the runs, by their names in tables.
        medians: make a table of medians and ranges, too.
    """

    def report(workshop: "Workshop") -> list[Table]:
        rows = {called: audited(workshop, name) for called, name in shown.items()}
        if not medians:
            return [audit_table("", rows)]
        return [kept_table("Medians and ranges:", rows), audit_table("Every champion:", rows)]

    return Part(title, tuple(shown.values()), report)


def audited(workshop: "Workshop", name: str) -> list[dict[str, Any]]:
    """What the audits of a run's champions found, a row for each; the first alone where quick."""

    def measure() -> list[dict[str, Any]]:
        from evo_cpg.api.audit import audits

        member = workshop.member(name)
        champions = workshop.champions(name)[: 1 if workshop.quick else None]
        config, source = member.config, workshop.source(name)
        made = audits(member.experiment, champions, config.audit.limits(), config, source)
        return [
            {
                "seed": member.experiment.seed + champion.run,
                "passed": done.verdict.passed,
                "reasons": done.verdict.reasons,
                "measured": {
                    each.key: float(each.measured) if np.isfinite(each.measured) else None
                    for each in done.verdict.checks
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
    """A line for every champion.

    Args:
        title: above the table.
        rows: from `audited`, by what their runs are called.
    """
    every = [row for found in rows.values() for row in found]
    keys = [key for key in _KEPT if any(key in row["measured"] for row in every)]
    programs = list(dict.fromkeys(one["program"] for row in every for one in _others(row)))
    head = ["", "seed", "way, m", *(_KEPT[key] for key in keys)]
    head += [*(f"{program}: over ground, m" for program in programs), "passes"]
    lines = [
        [
            name,
            str(row["seed"]),
            _number(row["measured"].get("way")),
            *(_share(row["measured"].get(key)) for key in keys),
            *(_number(_ways(row).get(program)) for program in programs),
            "yes" if row["passed"] else "no: " + "; ".join(row["reasons"]),
        ]
        for name, found in rows.items()
        for row in found
    ]
    return Table(title, head, lines)


def kept_table(title: str, rows: dict[str, list[dict[str, Any]]]) -> Table:
    """A line for every run: medians and ranges of what its champions keep.

    In MuJoCo they are asked as nearly as can be what they are asked here: the last of its opinions.
    """
    head = ["", "way, m", *_KEPT.values(), "in MuJoCo", "pass"]
    lines = []
    for name, found in rows.items():
        columns = [[row["measured"].get(key) for row in found] for key in ("way", *_KEPT)]
        columns.append([_second_opinion(row) for row in found])
        known = [[value for value in column if value is not None] for column in columns]
        lines.append(
            [
                name,
                middle(known[0]),
                *(f"{middle(100 * np.array(each), 0)} %" if each else "" for each in known[1:]),
                f"{sum(row['passed'] for row in found)} of {len(found)}",
            ]
        )
    return Table(title, head, lines)


def _others(row: dict[str, Any]) -> list[dict[str, Any]]:
    """Opinions of other programs than ours, which is the first."""
    return row["opinions"][1:]


def _ways(row: dict[str, Any]) -> dict[str, float]:
    return {one["program"]: one["way"] for one in _others(row)}


def _second_opinion(row: dict[str, Any]) -> float | None:
    """Share of our own way of the same trial that is made in the last program."""
    others = _others(row)
    return others[-1]["way"] / row["opinions"][0]["way"] if others else None


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


def _share(value: float | None) -> str:
    return "" if value is None else percent(value)
