"""An audit in tables, files and words, for the command `audit`."""

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from evo_cpg.analysis.verdict import Check, LimitError, Limits, limits_from, shown
from evo_cpg.api.training import now
from evo_cpg.cli.errors import UsageError
from evo_cpg.cli.exit_codes import ExitCode
from evo_cpg.cli.tables import show_table
from evo_cpg.training.checkpoint import Champion
from evo_cpg.training.probe import UNSEEING
from evo_cpg.training.run_folder import RunFolder

if TYPE_CHECKING:
    from evo_cpg.api.audit import Audit

# Columns of the summary, by the key of the check.
_KEPT = {
    "half_step": "half",
    "quarter_step": "quarter",
    "friction": "friction",
    "drag": "drag",
    "pose": "poses",
    "precision": "float64",
}

# Of the summary, characters.
_WIDTH = 110

_WORDS = {True: "passed", False: "FAILED", None: ""}


def champions_of(folder: RunFolder) -> list[Champion]:
    """Those of all runs in which anybody lived; of the others it is said that they have none.

    Raises:
        UsageError: no run has one.
    """
    checkpoint = folder.load()
    champions = checkpoint.champions if checkpoint else ()
    found = [champion for champion in champions if champion is not None]
    if not found:
        raise UsageError(f"--all: the checkpoints of {folder.path} hold no champion")
    for run, champion in enumerate(champions):
        if champion is None:
            print(
                f"{folder.path}: run {run}: every individual diverged: it has no champion to audit",
                file=sys.stderr,
            )
    return found


def say_verdict(
    run: Path, champions: Sequence[Champion], made: Sequence["Audit"], who: str
) -> None:
    """The verdict, and the exit code that goes with it."""
    for each, done in zip(champions, made, strict=True):
        if _measured(done, "half_step") is None:
            print(
                f"{run}: {_of(each, made)}displacement {shown(_measured(done, 'way'), 'm')}: too "
                "little to try what is kept of it",
                file=sys.stderr,
            )
        for reason in done.verdict.reasons:
            print(f"{run}: {_of(each, made)}{reason}", file=sys.stderr)
        blind = _measured(done, "blind")
        if blind is not None and blind >= UNSEEING:
            print(
                f"{run}: {_of(each, made)}note: the champion does not use its eyes: blind it keeps "
                f"{blind:.0%} of its displacement",
                file=sys.stderr,
            )
    passed = sum(done.verdict.passed for done in made)
    if len(made) > 1:
        print(f"{run}: {passed} of {len(made)} champions pass their audit")
    else:
        print(f"{run}: {who} {'passes' if passed else 'does not pass'} its audit")
    if passed < len(made):
        raise SystemExit(ExitCode.NOT_PASSED)


def _of(champion: Champion, made: Sequence["Audit"]) -> str:
    """Whose a line is, where there are several."""
    return f"run {champion.run}: " if len(made) > 1 else ""


def write_audit(folder: RunFolder, name: str, champion: Champion, done: "Audit") -> None:
    """Write an audit to the run folder as JSON."""
    verdict = done.verdict
    told: dict[str, Any] = {
        "passed": verdict.passed,
        "reasons": verdict.reasons,
        "run": champion.run,
        "generation": champion.generation,
        "fitness": champion.fitness,
        "expected": champion.expected,
        "checks": [_as_dict(check) for check in verdict.checks],
        "energy": [_energy(trial.ledger) for trial in done.trials],
        "second_opinion": [_opinion(each) for each in done.opinions] or done.missing,
        "made": now(),
    }
    folder.write_json(f"{name}.json", told)
    print(folder.path / f"{name}.json")


def draw_audit(folder: RunFolder, name: str, title: str, done: "Audit") -> None:
    """Draw the energy and the paths of an audit into the run folder."""
    from evo_cpg.view.audit_plot import audit_figure
    from evo_cpg.view.figure import save_figure

    figure = audit_figure(
        done.trials[0].ledger,
        done.step_length,
        [check for check in done.verdict.checks if "way" in check.question and check.unit == "%"],
        {one.program: one.path for one in done.opinions},
        title,
    )
    print(save_figure(figure, folder.path / "plots" / f"{name}.png"))


def show_summary(champions: Sequence[Champion], made: Sequence["Audit"]) -> None:
    """Print a line for each champion: which part of its way it keeps, and what MuJoCo says."""
    keys = [key for key in _KEPT if any(_measured(done, key) is not None for done in made)]
    rows = []
    for each, done in zip(champions, made, strict=True):
        ways = [one.displacement for one in done.opinions]
        rights = [one.upright for one in done.opinions]
        rows.append(
            (
                str(each.run),
                shown(_measured(done, "way")),
                *(shown(_percent(_measured(done, key))) for key in keys),
                ", ".join(f"{way:.2g}" for way in ways[1:]) + f" of {ways[0]:.2g}" if ways else "",
                ", ".join(f"{100 * right:.0f}" for right in rights),
                _WORDS[done.verdict.passed],
            )
        )
    names = [f"{_KEPT[key]} %" for key in keys]
    heads = "run", "way m", *names, "MuJoCo: way m", "upright %", ""
    show_table(heads, rows, width=_WIDTH)


def _percent(share: float | None) -> float | None:
    return None if share is None else 100 * share


def _measured(done: "Audit", key: str) -> float | None:
    return next((check.measured for check in done.verdict.checks if check.key == key), None)


def read_limits(settings: Sequence[str], others: Limits | None = None) -> Limits:
    """Return limits with some changed by ``key=value``.

    Raises:
        UsageError: a limit does not exist.
    """
    try:
        return limits_from(settings, others or Limits())
    except LimitError as error:
        raise UsageError(str(error)) from None


def show_checks(checks: tuple[Check, ...]) -> None:
    """Print the checks with what was measured and what is allowed."""
    rows = []
    for check in checks:
        allowed = shown(check.limit, check.unit)
        if allowed:
            allowed = f"{'at least' if check.least else 'at most'} {allowed}"
        measured = shown(check.measured, check.unit)
        rows.append((check.question, measured, allowed, _WORDS[check.passed]))
    show_table(("check", "measured", "allowed", ""), rows)


def show_opinions(opinions: tuple) -> None:
    """Print what two programs make of the same commands."""
    # Without ground, or with water everywhere, nothing flies.
    flight = [] if opinions[0].airborne is None else ["airborne"]
    rows = []
    for one in opinions:
        told = _opinion(one)
        off = np.sqrt(np.mean((one.joint_angle - opinions[0].joint_angle) ** 2))
        rows.append(
            (
                one.program,
                f"{told['way_m']:.3g} m",
                f"{told['heading_deg']:.0f} deg",
                shown(one.upright, "%"),
                *([] if one.airborne is None else [shown(one.airborne, "%")]),
                f"{math.degrees(off):.2g} deg" if one is not opinions[0] else "",
            )
        )
    show_table(("program", "displacement", "heading", "upright", *flight, "joints off by"), rows)


def _opinion(one: Any) -> dict[str, Any]:
    return {
        "program": one.program,
        "way_m": one.displacement,
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
        "measured": float(check.measured),
        "limit": check.limit,
        "least": check.least,
        "unit": check.unit,
        "passed": check.passed,
        "detail": check.detail,
    }
