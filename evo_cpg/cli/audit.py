"""The command that asks whether a champion's gait is one: audit."""

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from evo_cpg.analysis.verdict import Check, LimitError, Limits, limits_from, shown
from evo_cpg.api.load import class_folders
from evo_cpg.api.training import now, require_configured
from evo_cpg.cli.errors import UsageError
from evo_cpg.cli.progress import working
from evo_cpg.cli.training import open_champion
from evo_cpg.config.load import load_config

# What the command ends with where a champion does not pass.
NOT_PASSED = 3

_WORDS = {True: "passed", False: "FAILED", None: ""}


def audit_run(run: Path, settings: Sequence[str], number: int | None) -> None:
    """`evo-cpg audit`.

    Args:
        run: the run folder.
        settings: limits to change, ``key=value``.
        number: whose champion, where the folder holds several runs; None for the best.

    Raises:
        UsageError: a limit that does not exist.
        SystemExit: with `NOT_PASSED`, where the champion does not pass.
    """
    # Before anything that takes long.
    _limits(settings)
    experiment, champion, _, folder = open_champion(run, number)
    require_configured(folder)
    config = load_config(folder.config)
    limits = _limits(settings, config.audit.limits())
    with working("auditing: compiling each time, it takes one to some minutes") as work:
        from evo_cpg.api.audit import audit

        def tell(what: str, done: int, total: int) -> None:
            work.doing(f"auditing, {done + 1} of {total}: {what}")

        done = audit(
            experiment, champion, limits, config, folder.config, class_folders(folder), tell
        )
    name = "audit" if number is None else f"audit_run{number}"
    verdict = done.verdict
    told: dict[str, Any] = {
        "passed": verdict.passed,
        "reasons": verdict.reasons,
        "run": champion.run,
        "generation": champion.generation,
        "fitness": champion.fitness,
        "checks": [_as_dict(check) for check in verdict.checks],
        "energy": [_energy(trial.ledger) for trial in done.trials],
        "second_opinion": [_opinion(each) for each in done.opinions] or done.missing,
        "made": now(),
    }
    folder.write_json(f"{name}.json", told)
    console = Console()
    console.print(_table(verdict.checks))
    if done.opinions:
        console.print(_opinions(done.opinions))
    else:
        print(f"no second opinion: {done.missing}")
    from evo_cpg.view.audit_plot import plot_audit

    picture = plot_audit(
        done.trials[0].ledger,
        done.step_length,
        [check for check in verdict.checks if "way" in check.question and check.unit == "%"],
        {one.program: one.path for one in done.opinions},
        f"{experiment.name}: audit",
        folder.path / "plots" / f"{name}.png",
    )
    print(folder.path / f"{name}.json")
    print(picture)
    for reason in verdict.reasons:
        print(f"{run}: {reason}", file=sys.stderr)
    print(f"{run}: the champion {'passes' if verdict.passed else 'does not pass'} its audit")
    if not verdict.passed:
        raise SystemExit(NOT_PASSED)


def _limits(settings: Sequence[str], others: Limits | None = None) -> Limits:
    try:
        return limits_from(settings, others or Limits())
    except LimitError as error:
        raise UsageError(str(error)) from None


def _table(checks: tuple[Check, ...]) -> Table:
    table = Table("check", "measured", "allowed", "", box=box.SIMPLE_HEAD, pad_edge=False)
    for column in table.columns[1:3]:
        column.justify = "right"
        column.no_wrap = True
    for check in checks:
        allowed = shown(check.limit, check.unit)
        if allowed:
            allowed = f"{'at least' if check.least else 'at most'} {allowed}"
        measured = shown(check.measured, check.unit)
        table.add_row(check.question, measured, allowed, _WORDS[check.passed])
    return table


def _opinions(opinions: tuple) -> Table:
    """What two programs make of the same commands."""
    table = Table(
        "program", "way", "heading", "upright", "airborne", "joints off by",
        box=box.SIMPLE_HEAD, pad_edge=False,
    )  # fmt: skip
    for one in opinions:
        told = _opinion(one)
        off = np.sqrt(np.mean((one.joint_angle - opinions[0].joint_angle) ** 2))
        table.add_row(
            one.program,
            f"{told['way_m']:.3g} m",
            f"{told['heading_deg']:.0f} deg",
            shown(one.upright, "%"),
            shown(one.airborne, "%"),
            f"{math.degrees(off):.2g} deg" if one is not opinions[0] else "",
        )
    return table


def _opinion(one: Any) -> dict[str, Any]:
    first, last = one.path[:, 0], one.path[:, -1]
    return {
        "program": one.program,
        "way_m": float(np.linalg.norm((last - first)[:2])),
        "heading_deg": math.degrees(one.heading),
        "upright": one.upright,
        "nothing_touches": one.airborne,
    }


def _energy(ledger: Any) -> dict[str, float]:
    """Sums over a trial, J."""
    parts = {name: float(value.sum()) for name, value in ledger.work.items()}
    left_over = float(ledger.left_over.sum())
    return {"stored": float(ledger.stored.sum()), **parts, "left_over": left_over}


def _as_dict(check: Check) -> dict[str, Any]:
    return {
        "key": check.key,
        "question": check.question,
        "measured": float(check.measured) if math.isfinite(check.measured) else None,
        "limit": check.limit,
        "least": check.least,
        "unit": check.unit,
        "passed": check.passed,
        "detail": check.detail,
    }
