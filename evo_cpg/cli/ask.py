"""Commands that ask about a champion: `analyse`, `audit`, `verify`, `probe`, `sensitivity`, `lab`.

Each calls the function of its name in `evo_cpg` and prints the result.
"""

import contextlib
import math
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

import evo_cpg as evo
from evo_cpg.cli.errors import ExitCode, require_free
from evo_cpg.cli.options import (
    Cell,
    CoresOfRun,
    Folder,
    Number,
    Overwrite,
    Run,
    Trial,
    complete_config,
    find_config_or_folder,
)
from evo_cpg.cli.terminal import show_table, show_words, tell, warn
from evo_cpg.errors import UsageError

# Head of the column in the summary of audits, for each key of a check.
_KEPT = {
    "half_step": "half",
    "quarter_step": "quarter",
    "friction": "friction",
    "drag": "drag",
    "pose": "poses",
    "precision": "float64",
}

_PASSED = {True: "passed", False: "FAILED", None: ""}

# Width of the summary of audits, and of other tables and lines, characters.
_SUMMARY_WIDTH, _WIDTH = 110, 80

# Most rows of a table of sensitivities, and of an answer, on the terminal. The files have all rows.
_MOST_PARAMETERS, _MOST_ROWS = 25, 60

# Largest number of lights, bearings or distances, and most values of a knob.
_MOST = 10_000


def analyse(
    run: Run,
    output: Annotated[
        Path | None, typer.Option("--out", "-o", help="A .html file (default: RUN/analysis.html).")
    ] = None,
    number: Number = None,
    trial: Trial = 0,
    overwrite: Overwrite = False,
) -> None:
    """Write a page about a run, and print the numbers of its gait."""
    from evo_cpg.view.output import output_path

    if output is not None:
        output = output_path(output, (".html", ".htm"))
        for path in (output, output.with_suffix(".json")):
            require_free(path, overwrite)
    made = evo.analyse(run, trial, number=number, out=output)
    rows, missing = [], {}
    for each in made.numbers.quantities:
        if each.exists:
            value = f"{each.value:.3g}"
            if 1e3 <= abs(each.value) < 1e9:
                value = f"{float(value):.0f}"
            animals = "; ".join(f"{animals.range} {animals.animal}" for animals in each.animals)
            rows.append([each.name, value, each.unit, animals])
        elif each.missing:
            missing.setdefault(each.missing, []).append(each.name)
    show_table(["number", "value", "unit", "animals"], rows, left=4)
    for reason, names in missing.items():
        print(textwrap.fill(f"no {', '.join(names)}: {reason}", _WIDTH))
    print(made.table)
    print(made.page)


def verify(run: Run, cores: CoresOfRun = None) -> None:
    """Replay the champion and compare it with the record."""
    found = evo.verify(run, cores)
    for changed in found.machine:
        tell(f"{run}: {changed}. The last digits may differ")
    for difference in found.differences:
        tell(f"evo-cpg: {run}: {difference}")
    if found.differences:
        raise SystemExit(ExitCode.NOT_PASSED)
    exact = "exactly" if found.exact else f"to {found.tolerance:g}"
    print(f"{run}: the champion's fitness {found.fitness:.6f} is as recorded ({exact})")


def audit(
    run: Run,
    limits: Annotated[
        list[str] | None,
        typer.Argument(metavar="LIMIT=VALUE", help="Limits to change, such as half_step=0.8."),
    ] = None,
    number: Number = None,
    every: Annotated[
        bool, typer.Option("--all", help="Audit the champions of all runs side by side.")
    ] = False,
    cell: Cell = None,
) -> None:
    """Check whether the champion exploits the simulation."""
    from evo_cpg.analysis.verdict import shown
    from evo_cpg.api.audit import audit_runs
    from evo_cpg.api.runs import suffix, writing

    for option, value in (("--run", number), ("--cell", cell)):
        if every and value is not None:
            raise UsageError(f"--all and {option} exclude each other. Give only one of them")
    with writing(run):
        made = audit_runs(run, limits or []) if every else []
        made = made or [evo.audit(run, limits or [], number, cell)]
        for done in made:
            own = done.champion.run if every else number
            whose = f" of run {own}" if every else "" if cell is None else f" of cell {cell}"
            table, picture = done.save(
                run, f"audit{suffix(own, cell=cell)}", f"{run.name}: audit{whose}"
            )
            print(table)
            if not every:
                _show_checks(done)
            print(picture)
    if every:
        # A row for each champion: fractions of the displacement kept, and results of MuJoCo.
        keys = [key for key in _KEPT if any(key in done.measured for done in made)]
        rows = []
        for done in made:
            displacements = [f"{one.displacement:.2g}" for one in done.opinions]
            theirs = (
                f"{', '.join(displacements[1:])} of {displacements[0]}" if displacements else ""
            )
            unconfirmed = ", not confirmed" if done.verdict.confirmed is False else ""
            rows.append(
                (
                    str(done.champion.run),
                    shown(done.measured.get("way")),
                    *(shown(done.measured.get(key), "%").removesuffix(" %") for key in keys),
                    theirs,
                    ", ".join(f"{100 * one.upright:.0f}" for one in done.opinions),
                    _PASSED[done.passed] + unconfirmed,
                )
            )
        names = [f"{_KEPT[key]} %" for key in keys]
        heads = "run", "way m", *names, "MuJoCo: way m", "upright %", ""
        show_table(heads, rows, width=_SUMMARY_WIDTH)
    show_verdict(run, made, "the champion" if cell is None else f"the elite of cell {cell}")


def _show_checks(done: "evo.Audit") -> None:
    """Print the checks, each with its result and its limit, and the second opinions."""
    from evo_cpg.analysis.verdict import shown

    rows = []
    for check in done.verdict.checks:
        allowed = shown(check.limit, check.unit)
        if allowed:
            allowed = f"{'at least' if check.least else 'at most'} {allowed}"
        measured = shown(check.measured, check.unit)
        rows.append((check.question, measured, allowed, _PASSED[check.passed]))
    show_table(("check", "measured", "allowed", ""), rows)
    # The results of our simulation and of MuJoCo for the champion's first trial.
    rows = []
    for one in done.opinions:
        off = one.joint_angle - done.opinions[0].joint_angle
        kinds = (~one.slides, math.degrees(1.0), "deg"), (one.slides, 1.0, "m")
        errors = [
            f"{scale * (off[axes] ** 2).mean() ** 0.5:.2g} {unit}"
            for axes, scale, unit in kinds
            if axes.any()
        ]
        rows.append(
            (
                one.program,
                f"{one.displacement:.3g} m",
                f"{math.degrees(one.heading):.0f} deg",
                shown(one.upright, "%"),
                *([] if one.airborne is None else [shown(one.airborne, "%")]),
                ", ".join(errors) if one is not done.opinions[0] else "",
            )
        )
    if done.opinions:
        # The time in the air is not measured without ground, or with water everywhere.
        flight = [] if done.opinions[0].airborne is None else ["airborne"]
        show_table(("program", "displacement", "heading", "upright", *flight, "joint error"), rows)
    if done.missing:
        none = "a second opinion is missing" if done.opinions else "no second opinion"
        show_words(f"{none}: {done.missing}")


def show_verdict(run: Path, made: Sequence["evo.Audit"], subject: str) -> None:
    """Print the verdict, and exit with `ExitCode.NOT_PASSED` if an audit fails."""
    from evo_cpg.analysis.verdict import shown
    from evo_cpg.training.conditions import UNSEEING

    for done in made:
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
        whose = f"{run}: run {done.champion.run}" if len(made) > 1 else run
        for line in lines:
            tell(f"{whose}: {line}")
    passed = sum(done.passed for done in made)
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


def probe(
    run: Run,
    bearings: Annotated[
        str | None,
        typer.Option(
            help="Bearings of the light, degrees to the left: START:STOP:COUNT or a list such as "
            "-60,0,60 (default: -75:75:11)."
        ),
    ] = None,
    distances: Annotated[
        str | None,
        typer.Option(
            help="Distances of the light, m, in the same form (default: from the configuration)."
        ),
    ] = None,
    trials: Annotated[
        bool, typer.Option("--trials", help="Use the situations of the configuration instead.")
    ] = False,
    blind: Annotated[bool, typer.Option("--blind", help="Set all light sensors to 0.")] = False,
    reach: Annotated[
        float,
        typer.Option(
            min=0, help="Largest fraction of the distance that may be left to a reached light."
        ),
    ] = 0.2,
    number: Number = None,
    out: Folder = None,
) -> None:
    """Test the champion in new situations."""
    from evo_cpg.api.probe import BEARINGS
    from evo_cpg.api.runs import writing

    if trials and (bearings is not None or distances is not None):
        raise UsageError(
            "--trials uses the lights of the configuration. Leave out --bearings and --distances, "
            "or --trials"
        )
    turned: Sequence[float] | None = None if trials else BEARINGS
    if bearings is not None:
        turned = _numbers("--bearings", bearings)
    away = [] if distances is None else _numbers("--distances", distances)
    with writing(run, out):
        found = evo.probe(run, turned, away, blind, reach, number)
        files = found.save(out or run)
    cells = []
    for row in found.rows:
        lost = bool(row["diverged"])
        cells.append(
            (
                f"{row['bearing_deg']:+.1f}",
                f"{row['start_distance']:.2f}",
                "diverged" if lost else f"{row['distance_left']:.2f}",
                "" if lost else f"{row['distance']:.1%}",
                "" if lost else f"{row['light']:.2f}",
                "yes" if row["reached"] else "no",
            )
        )
    show_table(("bearing", "from (m)", "left (m)", "left", "light seen", "reached"), cells, left=0)
    if found.kept is not None:
        print(f"blinded, it keeps {found.kept:.0%} of its displacement towards the lights")
    reached = found.reached
    print(
        f"{reached.sum()} of {len(cells)} lights reached ({reached.mean():.0%}), with at most "
        f"{reach:g} of the distance left"
    )
    for file in files:
        print(file)
    if found.remark:
        warn(f"{run}: the champion: {found.remark}")


def _numbers(option: str, text: str) -> list[float]:
    """Return the numbers of a list such as -60,0,60, of START:STOP:COUNT or START:STOP:COUNT:log.

    Raises:
        UsageError: the text has another form, or there are too many numbers.
    """
    import numpy as np

    try:
        if ":" in text:
            start, stop, count, *kind = text.split(":")
            if kind not in ([], ["log"]) or int(count) > _MOST:
                raise ValueError
            space = np.geomspace if kind else np.linspace
            numbers = space(float(start), float(stop), int(count)).tolist()
        else:
            numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if not numbers or len(numbers) > _MOST or not all(map(math.isfinite, numbers)):
        raise UsageError(
            f"{option}: {text!r} is neither START:STOP:COUNT, such as 0.2:1:9, with :log for equal "
            f"ratios, nor a list, such as -60,0,60. Allowed: at most {_MOST} numbers"
        )
    return numbers


def sensitivity(
    run: Run,
    keys: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="KEY",
            help="Numbers of the configuration, such as world.water.form_drag, or genes "
            "(default: all except shapes in water).",
        ),
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(min=0, help="Seconds to simulate from the start of the trial (default: all)."),
    ] = None,
    shapes: Annotated[
        bool, typer.Option("--shapes", help="Include numbers that change surfaces in water (slow).")
    ] = False,
    number: Number = None,
    out: Folder = None,
) -> None:
    """Rank the parameters that speed and fitness depend on."""
    from evo_cpg.api.runs import writing

    with writing(run, out):
        found = evo.sensitivity(run, keys or [], seconds, shapes, number)
        files = found.save(out or run)
    rows, speed = found.rows, found.speed
    cells = []
    for row in rows[:_MOST_PARAMETERS]:
        words = []
        for name in ("speed", "fitness"):
            sure = row[f"{name}_confirmed"]
            size: Any = row[f"{name}_elasticity" if sure else f"{name}_found"]
            size, unit = (size, " %/%") if row["relative"] else (100 * size, " %/unit")
            # A change relative to a measure of 0 is not finite.
            text = f"{size:+.3g}{unit}" if math.isfinite(size) else "\N{EN DASH}"
            words.append(f"{'' if sure else '? '}{text}")
        cells.append((str(row["key"]), f"{row['value']:.4g}", *words))
    if found.trials > 1:
        print(f"{run}: using the first of {found.trials} trials")
    show_table(("parameter", "value", "speed", "fitness"), cells)
    stuck = sum(not one.step for one in speed)
    doubtful = sum(not one.confirmed for one in speed) - stuck
    print(
        f"speed {speed[0].measure:.4g} m/s, fitness {found.fitness[0].measure:.4g} over "
        f"{found.seconds:.3g} s"
    )
    if doubtful:
        print(
            f"{doubtful} of {len(rows)} marked ?: trials with 1 % more and less disagree with the "
            "derivative, so the table shows their change. Try a shorter trial: --seconds"
        )
    if stuck:
        print(
            f"{stuck} of {len(rows)} marked ?: a change by 1 % is not allowed in either direction, "
            "so the derivative is not checked"
        )
    for file in files:
        print(file)


def lab(
    animal: Annotated[
        Path,
        typer.Argument(
            metavar="ANIMAL",
            help="A run folder, a YAML configuration file, or the name of one that `evo-cpg "
            "configs` lists.",
            callback=find_config_or_folder,
            autocompletion=complete_config,
        ),
    ],
    knobs: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="KNOB=VALUES",
            help="What to vary: a list such as u=0.2,0.6 or u=0.2:1:9 (START:STOP:COUNT). Knobs: "
            "u (drive), b (adaptation), turn, cut, behind, undriven, feedback, silence, passive, "
            "stiffness, size, viscosity, gravity, current, tow, and keys of "
            "the configuration such as world.water.density.",
        ),
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(
            min=0.1,
            help="Duration of each trial, of which the second half is measured (default: from the "
            "configuration).",
        ),
    ] = None,
    courses: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Held-out courses of the champion's task, over which success is averaged. Without "
            "KNOB=VALUES, each sense is silenced, and the cord is cut in the middle.",
        ),
    ] = None,
    number: Number = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", help="Folder for the files (default: lab/NAME, lab/NAME_2...)."
        ),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Ask an animal a question without evolution."""
    import numpy as np

    from evo_cpg.analysis.laboratory.ask import shown_columns
    from evo_cpg.api.lab import TABLE, save_answer, varied_knobs
    from evo_cpg.io.load import load_config
    from evo_cpg.view.answer_plots import cell

    values = values_of(knobs or [])
    if out is not None:
        require_free(out / TABLE, overwrite)
        if out.exists() and not out.is_dir():
            raise UsageError(f"{out} is a file. --out is a folder")
    answer = evo.lab(animal, values, seconds, courses=courses, number=number)
    # Print as many columns as fit, and the notes.
    rows, varied = answer.rows, varied_knobs(answer)
    columns = shown_columns(rows)
    heads = [*short_heads(varied), *(one.head for one in columns)]
    keys = [*varied, *(one.key for one in columns)]
    cells = [[cell(row[key]) for key in keys] for row in rows[:_MOST_ROWS]]
    fit, width = 0, 0
    for column in zip(heads, *cells, strict=True):
        width += max(map(len, column)) + 3
        fit += width <= _WIDTH + 1
    fit = max(fit, len(varied) + 1)
    show_table(heads[:fit], [line[:fit] for line in cells], left=0)
    if len(rows) > _MOST_ROWS:
        print(f"and {len(rows) - _MOST_ROWS} more settings in the file")
    for note in answer.notes[:_MOST_ROWS]:
        show_words(note)
    name = load_config(animal / "config.yaml" if animal.is_dir() else animal).name
    for file in save_answer(answer, name, out):
        print(file)
    lost = sum(not np.isfinite(each.position).all() for each in answer.recordings)
    if lost:
        warn(f"{lost} of {len(answer.rows)} settings diverged. Their rows have no numbers")


def values_of(words: Sequence[str]) -> dict[str, list[Any]]:
    """Return the values of knobs such as ``u=0.2,0.6``, ``u=0.2:1:9`` and ``cut=none,tail1``.

    Raises:
        UsageError: a word has another form, or a knob is given twice.
    """
    found: dict[str, list[Any]] = {}
    for word in words:
        name, equals, text = word.partition("=")
        if not (name and equals and text):
            raise UsageError(f"lab: {word!r} is not KNOB=VALUES, such as u=0.2,0.6 or u=0.2:1:9")
        if name in found:
            raise UsageError(f"lab: {name} is given twice")
        if ":" in text:
            found[name] = _numbers(f"lab: {name}", text)
            continue
        found[name] = text.split(",")
        for i, part in enumerate(found[name]):
            with contextlib.suppress(ValueError):
                found[name][i] = float(part)
    return found


def short_heads(keys: Sequence[str]) -> list[str]:
    """Return the last parts of keys of a configuration, enough of them to tell the keys apart."""
    ends = [[".".join(key.split(".")[i:]) for i in range(key.count("."), -1, -1)] for key in keys]
    return [
        next(
            (end for end in own if not end[0].isdigit() and sum(end in each for each in ends) == 1),
            own[-1],
        )
        for own in ends
    ]
