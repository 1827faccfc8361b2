"""`evo-cpg analyse`: a page about a run."""

from pathlib import Path
from typing import Annotated

import typer

from evo_cpg.cli.errors import UsageError, require_free, warn
from evo_cpg.cli.options import Number, Overwrite, Run, Trial
from evo_cpg.cli.writing import writes_to_run

_SUFFIXES = (".html", ".htm")


@writes_to_run("output", "--out")
def analyse(
    run: Run,
    output: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="A .html file; RUN/analysis.html by default."),
    ] = None,
    number: Number = None,
    trial: Trial = 0,
    overwrite: Overwrite = False,
) -> None:
    """Make a page of a run: the champion in 3D, its gait in numbers and charts."""
    from evo_cpg.api.analyse import page, page_path
    from evo_cpg.api.load import changed_config
    from evo_cpg.api.training import require_configured
    from evo_cpg.cli.champions import open_champion, require_trial
    from evo_cpg.cli.progress import working
    from evo_cpg.files import write_text

    if output is not None:
        _require_place(output, overwrite)
    experiment, champion, _, folder = open_champion(run, number)
    require_configured(folder)
    require_trial(experiment, folder, trial)
    changed = changed_config(folder)
    if changed:
        warn(f"{run}: {changed}")
    path = output or page_path(folder, trial, number)
    with working("replaying the champion") as work:
        text = page(experiment, champion, folder, trial, number, work.doing)
    write_text(path, text)
    print(path)


def _require_place(output: Path, overwrite: bool) -> None:
    if output.suffix.lower() not in _SUFFIXES:
        raise UsageError(f"--out: {output} is not the name of a page; let it end in .html")
    if not output.parent.is_dir():
        raise UsageError(f"--out: there is no folder {output.parent}; create it first")
    if output.is_dir():
        raise UsageError(f"--out: {output} is a folder; give the name of a file")
    require_free(output, overwrite)
