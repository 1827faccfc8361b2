"""Check the name of a run folder, and name the nearest run for a wrong one."""

import os
from pathlib import Path

from evo_cpg.cli.errors import UsageError
from evo_cpg.errors import question, similar

_CONFIG = "config.yaml"
_RUNS = Path("runs")


def find_run(given: Path) -> Path:
    """Return a run folder, or explain what its name means instead.

    Raises:
        UsageError: there is no such folder, or it holds runs, or it is a file of a run.
    """
    if _is_run(given):
        return given
    if not os.path.exists(given):
        raise UsageError(f"{given}: there is no such folder. {_hint(given)}")
    owner = next((folder for folder in given.parents if _is_run(folder)), None)
    if owner is not None:
        raise UsageError(f"{given} is a part of a run. Give the run folder, {owner}")
    if runs := _runs_in(given):
        raise UsageError(f"{given} is not a run folder. It holds runs, such as {runs[0]}")
    # The command itself reports another folder, after errors in its options.
    return given


def _is_run(folder: Path) -> bool:
    # Unlike the methods of `Path`, this function accepts names that no file can have.
    return os.path.isfile(folder / _CONFIG)


def _hint(given: Path) -> str:
    """Return a sentence with the nearest runs, the newest run, or the command that makes one."""
    runs = {run.name: run for place in (_RUNS, given.parent) for run in _runs_in(place)}
    near = similar(given.name, runs)
    if near:
        return "D" + question([str(runs[name]) for name in near])[1:]
    from evo_cpg.io.shipped import shipped_names

    if str(given) in shipped_names():
        return f"It is a configuration. `evo-cpg train {given}` makes the run runs/{given}"
    if runs:
        newest = max(runs.values(), key=lambda run: os.path.getmtime(run / _CONFIG))
        return f"The newest run is {newest}"
    return f"`evo-cpg train CONFIG --out {given}` makes a run there"


def _runs_in(place: Path) -> list[Path]:
    try:
        return [each for each in sorted(place.iterdir()) if _is_run(each)]
    except (OSError, ValueError):
        return []
