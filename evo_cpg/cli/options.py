"""Arguments and options that several commands share, with their completions and checks."""

import contextlib
import enum
import os
from pathlib import Path
from typing import Annotated

import typer

from evo_cpg.cli.terminal import warn
from evo_cpg.errors import UsageError, question, similar

_CONFIG = "config.yaml"
_RUNS = Path("runs")


class What(enum.StrEnum):
    """Choice of the initial genomes of a run."""

    CHAMPION = "champion"
    POPULATION = "population"


class View(enum.StrEnum):
    """Positions of the camera, as in `evo_cpg.view.camera.CAMERAS`."""

    FOLLOW = "follow"
    SIDE = "side"
    TOP = "top"
    ORBIT = "orbit"


def _find_config(given: Path) -> Path:
    from evo_cpg.io.shipped import find_config

    config = given / _CONFIG
    if os.path.isfile(config):
        raise UsageError(
            f"{given} is a run folder. `evo-cpg resume {given}` continues the run. Its "
            f"configuration is {config}"
        )
    return find_config(given)


def find_config_or_folder(given: Path) -> Path:
    """Return the file of a configuration, or the folder of a run or sweep."""
    from evo_cpg.io.shipped import find_config

    if len(given.parts) > 1 and not given.suffix and not os.path.exists(given):
        return find_run(given)
    return find_config(given, folders=True)


def find_run(given: Path) -> Path:
    """Return a run folder, or explain what its name means instead.

    Raises:
        UsageError: there is no such folder, or it holds runs, or it is a file of a run.
    """
    if _is_run(given):
        return given
    if not os.path.exists(given):
        runs = {run.name: run for place in (_RUNS, given.parent) for run in _runs_in(place)}
        near = question([str(runs[name]) for name in similar(given.name, runs)])
        hint = near or f"`evo-cpg train CONFIG --out {given}` makes a run there"
        raise UsageError(f"{given}: there is no such folder. {hint}")
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


def _runs_in(place: Path) -> list[Path]:
    try:
        return [each for each in sorted(place.iterdir()) if _is_run(each)]
    except (OSError, ValueError):
        return []


def run_folder(given: Path | None) -> Path | None:
    """Return a run folder, or explain what its name means instead."""
    return given and find_run(given)


def name_replaced(overrides: list[str] | None) -> list[str] | None:
    """Return the overrides, with a warning for each that a later one replaces."""
    from evo_cpg.io.keys import replaces

    given = [(override.partition("=")[0], override) for override in overrides or []]
    for i, (key, override) in enumerate(given):
        for other, _ in given[:i]:
            if replaces(key, other):
                warn(f"{other} is given twice. Only the last value counts: {override}")
    return overrides


def on_cluster(where: str | None) -> contextlib.AbstractContextManager:
    """Return a context that evaluates populations on a cluster, if one is given."""
    if where is None:
        return contextlib.nullcontext()
    from evo_cpg.api.cluster import cluster

    return cluster(where)


def complete_config(incomplete: str) -> list[str]:
    """Return names of shipped configurations, configuration files and folders that match."""
    from evo_cpg.io.shipped import shipped_names

    names = [name for name in shipped_names() if name.startswith(incomplete)]
    with contextlib.suppress(OSError):
        folder, slash, _ = incomplete.rpartition("/")
        for path in sorted(Path(folder + slash or ".").iterdir()):
            shown = f"{path}/" if path.is_dir() else str(path)
            if shown.startswith(incomplete) and shown.endswith(("/", ".yaml", ".yml")):
                names.append(shown)
    return names


Config = Annotated[
    Path,
    typer.Argument(
        metavar="CONFIG",
        help="A YAML configuration file, or the name of one that `evo-cpg configs` lists.",
        callback=_find_config,
        autocompletion=complete_config,
    ),
]
Run = Annotated[
    Path, typer.Argument(metavar="RUN", help="A run folder made by `train`.", callback=run_folder)
]
Overrides = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="KEY=VALUE", help="Settings to change, such as seed=3.", callback=name_replaced
    ),
]
Port = Annotated[
    int, typer.Option(min=0, max=65535, help="Port of the page (default: a free one).")
]
Browser = Annotated[
    bool, typer.Option("--browser/--no-browser", help="Open the page in the browser.")
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace the file if it exists.")]
Number = Annotated[
    int | None,
    typer.Option(
        "--run", min=0, help="Number of one of several runs side by side (default: the best)."
    ),
]
Trial = Annotated[
    int, typer.Option("--trial", min=0, help="Trial of the champion, counted from 0.")
]
Cell = Annotated[
    str | None,
    typer.Option(
        "--cell",
        help="Use the elite of this cell of the run's map, not the champion: a number for "
        "each axis, from 0, such as 3,0,7.",
    ),
]


Strict = Annotated[
    bool, typer.Option("--strict", help="Refuse values that are allowed but not plausible.")
]
Cores = Annotated[int | None, typer.Option(min=1, help="Cores to use (default: all).")]
CoresOfRun = Annotated[
    int | None, typer.Option("--cores", min=1, help="Cores to use (default: as in training).")
]
ClusterOption = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        metavar="CLUSTER",
        help="Evaluate on a Dask cluster: a number of workers to start here, an address such as "
        "tls://host:8786, or a scheduler file.",
    ),
]
Crowd = Annotated[
    int | None,
    typer.Option(
        min=0,
        metavar="GENERATION",
        help="Show all animals of this generation together: the leader in colours, the others as "
        "ghosts. The first generation is 0.",
    ),
]
Wall = Annotated[
    int | None,
    typer.Option(
        min=0,
        metavar="GENERATION",
        help="Show animals of this generation in a grid, each with its own body: the fittest of "
        "each line of descent first. A .html file is a page for the browser.",
    ),
]
Folder = Annotated[
    Path | None, typer.Option("--out", "-o", help="Folder for the files (default: RUN).")
]
