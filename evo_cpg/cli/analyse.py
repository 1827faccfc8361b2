"""The command that makes a page of a run: analyse."""

import sys
from pathlib import Path

from evo_cpg.api.analyse import page, page_path
from evo_cpg.api.load import changed_config
from evo_cpg.api.training import require_configured
from evo_cpg.cli.champions import open_champion, require_trial
from evo_cpg.cli.errors import UsageError, require_free
from evo_cpg.cli.progress import working
from evo_cpg.files import write_text

_SUFFIXES = (".html", ".htm")


def analyse_run(
    run: Path, output: Path | None, number: int | None, trial: int, overwrite: bool
) -> None:
    """`evo-cpg analyse`.

    Args:
        run: the run folder.
        output: the page; in the run folder if None.
        number: whose champion, where the folder holds several runs; None for the best.
        trial: in which of its trials, from 0.
        overwrite: replace a page that was asked for by name.

    Raises:
        UsageError: the page cannot be written there, or there is no such trial.
    """
    if output is not None:
        _require_place(output, overwrite)
    experiment, champion, _, folder = open_champion(run, number)
    require_configured(folder)
    require_trial(experiment, folder, trial)
    changed = changed_config(folder)
    if changed:
        print(f"evo-cpg: warning: {run}: {changed}", file=sys.stderr)
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
