"""Tables, files and messages of the command `audit`."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from evo_cpg.analysis.second_opinion import Opinion
from evo_cpg.analysis.verdict import Check, limits_from, shown
from evo_cpg.api import audit
from evo_cpg.api.audit import Audit
from evo_cpg.api.display import working
from evo_cpg.api.training import now
from evo_cpg.cli.champions import open_champion
from evo_cpg.cli.errors import ExitCode, UsageError, tell
from evo_cpg.cli.options import Which
from evo_cpg.cli.tables import show_table, show_words
from evo_cpg.io.run import class_folders
from evo_cpg.training.checkpoint import Champion
from evo_cpg.training.conditions import UNSEEING
from evo_cpg.training.run_folder import RunFolder

# Head of the summary's column for each key of a check.
_KEPT = {
    "half_step": "half",
    "quarter_step": "quarter",
    "friction": "friction",
    "drag": "drag",
    "pose": "poses",
    "precision": "float64",
}

# Width of the summary, characters.
_WIDTH = 110

_WORDS = {True: "passed", False: "FAILED", None: ""}


def audit_champions(run: Path, limits: Sequence[str], which: Which, every: bool) -> None:
    """Audit one champion or all, and write, draw and print the results.

    Args:
        run: path of the run folder.
        limits: changed limits, ``key=value``.
        which: champion or elite to audit.
        every: audit the champions of all runs side by side instead.

    Raises:
        SystemExit: with `ExitCode.NOT_PASSED`, if an audit fails.
    """
    opened = open_champion(run, which)
    opened.require_configured()
    experiment, config, folder = opened.experiment, opened.config, opened.folder
    allowed = limits_from(limits, config.audit.limits())
    champions = champions_of(folder) if every else [opened.champion]
    with working("auditing: compiling for each of several simulations") as work:

        def tell(what: str, done: int, total: int) -> None:
            work.doing(f"auditing, {done + 1} of {total}: {what}")

        made = audit.audits(
            experiment, champions, allowed, config, folder.config, class_folders(folder), tell
        )
    for champion, done in zip(champions, made, strict=True):
        of_run = f"_run{champion.run}" if every else which.of_run
        name = f"audit{which.of_cell}{of_run}"
        folder.write_json(f"{name}.json", done.as_dict(champion) | {"made": now()})
        print(run / f"{name}.json")
        if not every:
            show_checks(done.verdict.checks)
            if done.opinions:
                show_opinions(done.opinions)
            if done.missing:
                none = "a second opinion is missing" if done.opinions else "no second opinion"
                show_words(f"{none}: {done.missing}")
        title = f"{experiment.name}: audit" + (f" of run {champion.run}" if every else "")
        title += "" if which.cell is None else f" of cell {which.cell}"
        title += ", not confirmed" if done.verdict.confirmed is False else ""
        draw_audit(folder, name, title, done)
    if every:
        show_summary(champions, made)
    subject = "the champion" if which.cell is None else f"the elite of cell {which.cell}"
    say_verdict(run, champions, made, subject)


def champions_of(folder: RunFolder) -> list[Champion]:
    """Return the champions of all runs, and print which runs have none.

    Raises:
        UsageError: no run has a champion.
    """
    checkpoint = folder.load()
    champions = checkpoint.champions if checkpoint else ()
    found = [champion for champion in champions if champion is not None]
    if not found:
        raise UsageError(f"--all: {folder.path} has no champion in its checkpoints")
    for run, champion in enumerate(champions):
        if champion is None:
            tell(f"{folder.path}: run {run} has no champion to audit: every individual diverged")
    return found


def say_verdict(
    run: Path, champions: Sequence[Champion], made: Sequence[Audit], subject: str
) -> None:
    """Print the verdict, and exit with `ExitCode.NOT_PASSED` if an audit fails."""
    for each, done in zip(champions, made, strict=True):
        lines = list(done.verdict.reasons)
        if "half_step" not in done.measured:
            displacement = shown(done.measured["way"], "m")
            lines.insert(0, f"displacement {displacement}: too short to compare variations with")
        blind = done.measured.get("blind", 0.0)
        if blind >= UNSEEING:
            lines.append(
                "note: the champion does not use its eyes: blinded, it keeps "
                f"{blind:.0%} of its displacement"
            )
        whose = f"{run}: run {each.run}" if len(made) > 1 else run
        for line in lines:
            tell(f"{whose}: {line}")
    passed = sum(done.verdict.passed for done in made)
    if len(made) > 1:
        alone = sum(done.verdict.confirmed is False for done in made)
        words = f"; {alone} of {len(made)} are not confirmed by a second opinion" if alone else ""
        print(f"{run}: {passed} of {len(made)} champions pass their audit{words}")
    else:
        words = made[0].verdict.confirmation
        words = f"; {words}" if words else ""
        print(f"{run}: {subject} {'passes' if passed else 'does not pass'} its audit{words}")
    if passed < len(made):
        raise SystemExit(ExitCode.NOT_PASSED)


def draw_audit(folder: RunFolder, name: str, title: str, done: Audit) -> None:
    """Draw the energy and the paths of an audit into the run folder."""
    from evo_cpg.view.answer_plots import audit_figure
    from evo_cpg.view.figure import save_figure

    figure = audit_figure(
        done.trials[0].ledger,
        done.step_length,
        [
            check
            for check in done.verdict.checks
            if check.unit == "%" and (check.least or check.key.endswith("_way"))
        ],
        {one.program: one.path for one in done.opinions},
        title,
    )
    print(save_figure(figure, folder.path / "plots" / f"{name}.png"))


def show_summary(champions: Sequence[Champion], made: Sequence[Audit]) -> None:
    """Print a row for each champion: fractions of the displacement kept, and results of MuJoCo."""
    keys = [key for key in _KEPT if any(key in done.measured for done in made)]
    rows = []
    for each, done in zip(champions, made, strict=True):
        displacements = [f"{one.displacement:.2g}" for one in done.opinions]
        rows.append(
            (
                str(each.run),
                shown(done.measured.get("way")),
                *(shown(done.measured.get(key), "%").removesuffix(" %") for key in keys),
                f"{', '.join(displacements[1:])} of {displacements[0]}" if displacements else "",
                ", ".join(f"{100 * one.upright:.0f}" for one in done.opinions),
                _WORDS[done.verdict.passed]
                + (", not confirmed" if done.verdict.confirmed is False else ""),
            )
        )
    names = [f"{_KEPT[key]} %" for key in keys]
    heads = "run", "way m", *names, "MuJoCo: way m", "upright %", ""
    show_table(heads, rows, width=_WIDTH)


def show_checks(checks: tuple[Check, ...]) -> None:
    """Print the checks, each with its result and its limit."""
    rows = []
    for check in checks:
        allowed = shown(check.limit, check.unit)
        if allowed:
            allowed = f"{'at least' if check.least else 'at most'} {allowed}"
        measured = shown(check.measured, check.unit)
        rows.append((check.question, measured, allowed, _WORDS[check.passed]))
    show_table(("check", "measured", "allowed", ""), rows)


def show_opinions(opinions: Sequence[Opinion]) -> None:
    """Print the results of our simulation and of MuJoCo for the champion's first trial."""
    # The time in the air is not measured without ground, or with water everywhere.
    flight = [] if opinions[0].airborne is None else ["airborne"]
    rows = []
    for one in opinions:
        off = one.joint_angle - opinions[0].joint_angle
        errors = [
            f"{scale * np.sqrt(np.mean(off[axes] ** 2)):.2g} {unit}"
            for axes, scale, unit in (
                (~one.slides, math.degrees(1.0), "deg"),
                (one.slides, 1.0, "m"),
            )
            if axes.any()
        ]
        rows.append(
            (
                one.program,
                f"{one.displacement:.3g} m",
                f"{math.degrees(one.heading):.0f} deg",
                shown(one.upright, "%"),
                *([] if one.airborne is None else [shown(one.airborne, "%")]),
                ", ".join(errors) if one is not opinions[0] else "",
            )
        )
    show_table(("program", "displacement", "heading", "upright", *flight, "joint error"), rows)
