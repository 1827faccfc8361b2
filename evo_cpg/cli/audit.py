"""The command that asks whether a champion's gait is one: audit."""

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from evo_cpg.analysis.verdict import Check, LimitError, Limits, limits_from, shown
from evo_cpg.api.load import class_folders
from evo_cpg.api.training import now, require_configured
from evo_cpg.cli.champions import open_champion
from evo_cpg.cli.errors import UsageError
from evo_cpg.cli.exit_codes import ExitCode
from evo_cpg.cli.progress import working
from evo_cpg.config.load import load_config
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


def audit_run(
    run: Path,
    settings: Sequence[str],
    number: int | None,
    every: bool = False,
    cell: str | None = None,
) -> None:
    """`evo-cpg audit`.

    Args:
        run: the run folder.
        settings: limits to change, ``key=value``.
        number: whose champion, where the folder holds several runs; None for the best.
        every: audit the champions of all of its runs.
        cell: of the run's map, whose elite is audited instead, as ``3,0,7``.

    Raises:
        UsageError: a limit that does not exist, or one run or cell and all.
        SystemExit: with `ExitCode.NOT_PASSED`, where a champion does not pass.
    """
    # Before anything that takes long.
    _limits(settings)
    if every and number is not None:
        raise UsageError("--all and --run: give one of them")
    if every and cell is not None:
        raise UsageError("--all and --cell: give one of them")
    experiment, champion, _, folder = open_champion(run, number, cell)
    require_configured(folder)
    config = load_config(folder.config)
    limits = _limits(settings, config.audit.limits())
    champions = [champion]
    if every:
        champions = _champions(folder)
    with working("auditing: compiling for each of several simulations") as work:
        from evo_cpg.api.audit import audits

        def tell(what: str, done: int, total: int) -> None:
            work.doing(f"auditing, {done + 1} of {total}: {what}")

        beside = class_folders(folder)
        made = audits(experiment, champions, limits, config, folder.config, beside, tell)
    console = Console()
    for each, done in zip(champions, made, strict=True):
        name = "audit" if cell is None else f"audit_cell_{cell.replace(',', '_')}"
        name += f"_run{each.run}" if every or number is not None else ""
        _write(folder, name, each, done)
        if not every:
            console.print(_table(done.verdict.checks))
            if done.opinions:
                console.print(_opinions(done.opinions))
            if done.missing:
                none = "one opinion is missing" if done.opinions else "no second opinion"
                print(f"{none}: {done.missing}")
        title = f"{experiment.name}: audit" + (f" of run {each.run}" if every else "")
        _draw(folder, name, title + ("" if cell is None else f" of cell {cell}"), done)
    if every:
        Console(width=max(_WIDTH, console.width)).print(_summary(champions, made))
    _say(run, champions, made, "the champion" if cell is None else f"the elite of cell {cell}")


def _champions(folder: RunFolder) -> list[Champion]:
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


def _say(run: Path, champions: Sequence[Champion], made: Sequence["Audit"], who: str) -> None:
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


def _write(folder: RunFolder, name: str, champion: Champion, done: "Audit") -> None:
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


def _draw(folder: RunFolder, name: str, title: str, done: "Audit") -> None:
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


def _summary(champions: Sequence[Champion], made: Sequence["Audit"]) -> Table:
    """A line for each champion: what it keeps of its way where, and what MuJoCo says."""
    keys = [key for key in _KEPT if any(_measured(done, key) is not None for done in made)]
    names = [f"{_KEPT[key]} %" for key in keys]
    table = Table(
        "run", "way m", *names, "MuJoCo: way m", "upright %", "",
        box=box.SIMPLE_HEAD, pad_edge=False,
    )  # fmt: skip
    for column in table.columns[1:-1]:
        column.justify = "right"
    for each, done in zip(champions, made, strict=True):
        ways = [one.way for one in done.opinions]
        rights = [one.upright for one in done.opinions]
        table.add_row(
            str(each.run),
            shown(_measured(done, "way")),
            *(shown(_percent(_measured(done, key))) for key in keys),
            ", ".join(f"{way:.2g}" for way in ways[1:]) + f" of {ways[0]:.2g}" if ways else "",
            ", ".join(f"{100 * right:.0f}" for right in rights),
            _WORDS[done.verdict.passed],
        )
    return table


def _percent(share: float | None) -> float | None:
    return None if share is None else 100 * share


def _measured(done: "Audit", key: str) -> float | None:
    return next((check.measured for check in done.verdict.checks if check.key == key), None)


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
    # Without ground, or with water everywhere, nothing flies.
    flight = [] if opinions[0].airborne is None else ["airborne"]
    table = Table(
        "program", "displacement", "heading", "upright", *flight, "joints off by",
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
            *([] if one.airborne is None else [shown(one.airborne, "%")]),
            f"{math.degrees(off):.2g} deg" if one is not opinions[0] else "",
        )
    return table


def _opinion(one: Any) -> dict[str, Any]:
    return {
        "program": one.program,
        "way_m": one.way,
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
