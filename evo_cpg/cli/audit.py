"""`evo-cpg audit`: check whether a champion exploits the simulation."""

from typing import Annotated

import typer

from evo_cpg.cli.errors import UsageError
from evo_cpg.cli.options import Cell, Number, Run
from evo_cpg.cli.writing import writes_to_run


@writes_to_run()
def audit(
    run: Run,
    limits: Annotated[
        list[str] | None,
        typer.Argument(metavar="[LIMIT=VALUE]...", help="Limits to change, such as half_step=0.8."),
    ] = None,
    number: Number = None,
    every: Annotated[
        bool, typer.Option("--all", help="Of several runs side by side, all champions.")
    ] = False,
    cell: Cell = None,
) -> None:
    """Ask whether the champion's gait is one, or a trick of the simulation."""
    from evo_cpg.api.audit import audits
    from evo_cpg.api.load import class_folders
    from evo_cpg.api.training import require_configured
    from evo_cpg.cli.audited import (
        champions_of,
        draw_audit,
        read_limits,
        say_verdict,
        show_checks,
        show_opinions,
        show_summary,
        write_audit,
    )
    from evo_cpg.cli.champions import open_champion
    from evo_cpg.cli.progress import working
    from evo_cpg.config.load import load_config

    # Before anything that takes long.
    read_limits(limits or [])
    if every and number is not None:
        raise UsageError("--all and --run: give one of them")
    if every and cell is not None:
        raise UsageError("--all and --cell: give one of them")
    experiment, champion, _, folder = open_champion(run, number, cell)
    require_configured(folder)
    config = load_config(folder.config)
    asked = read_limits(limits or [], config.audit.limits())
    champions = [champion]
    if every:
        champions = champions_of(folder)
    with working("auditing: compiling for each of several simulations") as work:

        def tell(what: str, done: int, total: int) -> None:
            work.doing(f"auditing, {done + 1} of {total}: {what}")

        beside = class_folders(folder)
        made = audits(experiment, champions, asked, config, folder.config, beside, tell)
    for each, done in zip(champions, made, strict=True):
        name = "audit" if cell is None else f"audit_cell_{cell.replace(',', '_')}"
        name += f"_run{each.run}" if every or number is not None else ""
        write_audit(folder, name, each, done)
        if not every:
            show_checks(done.verdict.checks)
            if done.opinions:
                show_opinions(done.opinions)
            if done.missing:
                none = "one opinion is missing" if done.opinions else "no second opinion"
                print(f"{none}: {done.missing}")
        title = f"{experiment.name}: audit" + (f" of run {each.run}" if every else "")
        draw_audit(folder, name, title + ("" if cell is None else f" of cell {cell}"), done)
    if every:
        show_summary(champions, made)
    say_verdict(
        run, champions, made, "the champion" if cell is None else f"the elite of cell {cell}"
    )
