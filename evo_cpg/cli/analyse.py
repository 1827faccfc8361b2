"""`evo-cpg analyse`: write a page about a run."""

from pathlib import Path
from typing import Annotated

import typer

from evo_cpg.cli.errors import require_free, warn
from evo_cpg.cli.options import Crowd, Number, Overwrite, Run, Trial, Which
from evo_cpg.cli.writing import writes_to_run


@writes_to_run("output", "--out")
def analyse(
    run: Run,
    output: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="A .html file (default: RUN/analysis.html)."),
    ] = None,
    number: Number = None,
    trial: Trial = 0,
    crowd: Crowd = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a page about a run, and print the numbers of its gait."""
    from evo_cpg.api.analyse import numbers_path, write_page
    from evo_cpg.api.display import working
    from evo_cpg.cli.champions import open_champion
    from evo_cpg.cli.measured_gait import show_numbers
    from evo_cpg.view.output import output_path

    if output is not None:
        output = output_path(output, (".html", ".htm"))
        for path in (output, numbers_path(output)):
            require_free(path, overwrite)
    opened = open_champion(run, Which(number, trial))
    together = None
    if crowd is not None:
        from evo_cpg.cli.filmed import crowd_panel
        from evo_cpg.view.film import Film

        together = crowd_panel(opened, crowd, trial, Film())
    with working("replaying the champion") as work:
        written = write_page(opened, trial, number, output, work.doing, warn, together)
    show_numbers(written.measured.quantities)
    print(written.numbers)
    print(written.page)
