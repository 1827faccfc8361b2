"""`evo-cpg audit`: check whether a champion exploits the simulation."""

from typing import Annotated

import typer

from evo_cpg.cli.errors import UsageError
from evo_cpg.cli.options import Cell, Number, Run, Which
from evo_cpg.cli.writing import writes_to_run


@writes_to_run()
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
    from evo_cpg.analysis.verdict import limits_from
    from evo_cpg.cli.audited import audit_champions

    # Check the limits before the slow steps.
    limits_from(limits or [])
    for option, value in (("--run", number), ("--cell", cell)):
        if every and value is not None:
            raise UsageError(f"--all and {option} exclude each other. Give only one of them")
    audit_champions(run, limits or [], Which(number, cell=cell), every)
