"""Sections on the origin of the champion: evolution, audit, and repetition."""

import hashlib
import shlex
from collections.abc import Mapping
from typing import Any

from evo_cpg.training.run_folder import refinements
from evo_cpg.view.plots import fitness_figure
from evo_cpg.view.run_page import charts
from evo_cpg.view.run_page.html import (
    Html,
    cell,
    join,
    listed,
    number,
    quantity,
    table,
    tag,
    without_folders,
)
from evo_cpg.view.run_page.subject import PageSubject, RecordedMotion


def evolution(subject: PageSubject, motion: RecordedMotion) -> Html:
    """Show fitness over the generations, and the champion's fitness and terms."""
    rows = [[name, number(value)] for name, value in subject.champion.items()]
    words = (
        f"The champion is from generation {subject.generation} (counted from 0) of "
        f"{subject.generations} finished generations. Its seed is {subject.seed}"
    )
    words += "." if subject.run is None else f", in run {subject.run}."
    if subject.trial is not None:
        words += f" The page shows trial {subject.trial}."
    return join(
        tag("p", words),
        charts.chart(
            fitness_figure(motion.history),
            "Fitness over the generations, and number of individuals that diverged or broke "
            "a rule.",
        ),
        table(["", "champion"], rows, numbers=(1,)),
        tag("p", "Fitness is maximised. The other rows are terms and measures of the trials, and "
            "under noise the mean fitness in new draws of the noise.", class_="note"),
    )  # fmt: skip


def audit(subject: PageSubject) -> Html:
    """Show verdict and checks of the audit, or the command that makes one."""
    found, command = subject.audit, tag("code", "evo-cpg audit RUN")
    look: Any = None
    if subject.half_step is not None:
        kept = f"{100 * subject.half_step:.3g} % of its displacement"
        look = tag("p", f"At half the physics step it keeps {kept}.")
    if found is None:
        return join(
            look, tag("p", "It was not audited. Run ", command, ", then make this page again "
                      "to show the verdict.")
        )  # fmt: skip
    passed = bool(found.get("passed"))
    verdict = tag("span", "passes" if passed else "does not pass",
                  class_="passed" if passed else "failed")  # fmt: skip
    old = None
    if subject.stale:
        old = tag("p", "This audit belongs to another champion. Run ", command,
                  " to audit this one.", class_="failed")  # fmt: skip
    reasons = [reason for reason in listed(found.get("reasons")) if isinstance(reason, str)]
    words, second = found.get("confirmation"), found.get("second_opinion")
    if not words and second and isinstance(second, str):
        words = f"no second opinion: {second}"
    rows = []
    for check in listed(found.get("checks")):
        if isinstance(check, Mapping):
            passed = check.get("passed")
            word = {True: "passed", False: "failed"}.get(passed) if passed is not None else ""
            limit = quantity(check.get("limit"), check.get("unit"))
            if limit:
                limit = f"{'at least' if check.get('least') else 'at most'} {limit}"
            measured = quantity(check.get("measured"), check.get("unit"))
            rows.append([check.get("question", ""), measured or "diverged", limit,
                         tag("span", word, class_=word)])  # fmt: skip
    return join(
        old,
        tag("p", "The champion ", verdict, " its audit", f" of {found.get('made', '')}",
            f"; {words}." if words else ".", *(
            [" ", "; ".join(reasons), "."] if reasons else [])),
        table(["check", "measured", "allowed", ""], rows, numbers=(1, 2)),
    )  # fmt: skip


def repetition(subject: PageSubject) -> Html:
    """Show commands, versions and the configuration."""
    run, meta = subject.folder, subject.meta
    commands = [
        "evo-cpg train config.yaml --out again",
        f"evo-cpg verify {shlex.quote(run)}",
        f"evo-cpg render {shlex.quote(run)}",
        f"evo-cpg analyse {shlex.quote(run)}",
    ]
    rows = [[key, cell(meta[key])] for key in ("started", "resumed", "finished") if key in meta]
    versions = meta.get("versions")
    if isinstance(versions, Mapping):
        said = ", ".join(f"{name} {version}" for name, version in versions.items())
        rows.append(["versions", f"Python {meta.get('python', '?')}, {said}"])
    for key in ("commit", "processor", "system", "engine", "instructions", "devices"):
        if key in meta:
            rows.append([key, cell(meta[key])])
    digest = hashlib.sha256(subject.config.encode()).hexdigest()
    rows.append(["configuration", f"SHA-256 {digest}"])
    command = meta.get("command")
    if isinstance(command, list):
        words = [without_folders(str(word)) for word in command]
        rows.append(["first command", f"evo-cpg {shlex.join(words)}"])
    refined, changes = [], None
    for one in refinements(meta):
        words = [without_folders(str(word)) for word in listed(one.get("command"))]
        gained = f"{cell(one.get('from'))} to {cell(one.get('to'))}"
        refined.append([cell(one.get("finished")), f"evo-cpg {shlex.join(words)}", gained])
    if refined:
        changes = join(
            tag("p", "After evolution, this champion was refined along the gradient of the "
                "fitness. The commands below repeat only the evolution, so their champion differs. "
                "The configuration below is the refined one. The run folder keeps the files from "
                "before the last successful refinement: config_before.yaml and "
                "champion_before.npz."),
            table(["refined", "command", "fitness"], refined),
        )  # fmt: skip
    return join(
        changes,
        tag("p", "Save the configuration below as ", tag("code", "config.yaml"), " and run these "
            "commands. The results are identical on the same processor, with the same versions and "
            "number of cores. Elsewhere numbers round differently, and evolution may find another "
            "champion. If the configuration names files, such as meshes, or own classes, you need "
            "them, too."),
        tag("pre", tag("code", "\n".join(commands))),
        table(["", ""], rows),
        tag("details", tag("summary", "The configuration"), tag("pre", tag("code",
            subject.config))),
    )  # fmt: skip
