"""Arguments and options that several commands share."""

import enum
import re
from pathlib import Path
from typing import Annotated

import typer

from evo_cpg.cli.completion import complete_config, complete_folder
from evo_cpg.cli.errors import UsageError


class What(enum.StrEnum):
    """What a run begins with."""

    CHAMPION = "champion"
    POPULATION = "population"


class View(enum.StrEnum):
    """From where a film shows the animal; those of `evo_cpg.view.camera.CAMERAS`."""

    FOLLOW = "follow"
    SIDE = "side"
    TOP = "top"
    ORBIT = "orbit"


def _find_config(given: Path) -> Path:
    from evo_cpg.config.shipped import find_config

    return find_config(given)


def find_config_or_folder(given: Path) -> Path:
    """The file of a configuration, or a folder: a run or a sweep."""
    from evo_cpg.config.shipped import find_config

    return find_config(given, folders=True)


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
    Path,
    typer.Argument(
        metavar="RUN", help="A run folder made by `train`.", autocompletion=complete_folder
    ),
]
Overrides = Annotated[
    list[str] | None,
    typer.Argument(metavar="[KEY=VALUE]...", help="Settings to change, such as seed=3."),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace the file if it exists.")]
Number = Annotated[
    int | None,
    typer.Option("--run", min=0, help="Of several runs side by side, which; the best by default."),
]
Trial = Annotated[
    int,
    typer.Option("--trial", min=0, help="Of the champion's trials, which; counted from 0."),
]
Cell = Annotated[
    str | None,
    typer.Option(
        "--cell",
        help="Instead of the champion the elite of this cell of the run's map, such as 3,0,7: a "
        "number for each axis, from 0.",
    ),
]
Strict = Annotated[
    bool, typer.Option("--strict", help="Refuse values that are allowed but hardly meant.")
]
Cores = Annotated[int | None, typer.Option(min=1, help="Cores to use; all by default.")]
Distributed = Annotated[
    bool,
    typer.Option(
        "--distributed",
        help="Evolve with other processes: those of SLURM or Open MPI, of --hosts or of --local.",
    ),
]
Hosts = Annotated[
    str | None,
    typer.Option(
        metavar="HOST[:PORT],HOST,...",
        help="Hosts of the processes, or a file with one on each line; the first leads.",
    ),
]
Process = Annotated[
    int | None,
    typer.Option(
        min=0, help="Which of --hosts this process is, from 0; by the name of its host by default."
    ),
]
Local = Annotated[int | None, typer.Option(min=1, help="Start so many processes on this machine.")]
JoinTimeout = Annotated[
    float, typer.Option(min=0.1, help="Seconds that the processes may take to come together.")
]
Patience = Annotated[
    float | None,
    typer.Option(
        min=0,
        help="Seconds, beyond twice what its own part took, that a process waits for the others; "
        "20 by default.",
    ),
]
Tensorboard = Annotated[
    bool,
    typer.Option("--tensorboard", help="Write RUN/tensorboard, with the columns of metrics.csv."),
]
Folder = Annotated[
    Path | None, typer.Option("--out", "-o", help="Folder for the files; RUN by default.")
]


def of_trial(trial: int) -> str:
    """Return what is added to the name of a picture for any trial but the first."""
    return f"_trial{trial}" if trial else ""


def pixels_of(size: str) -> tuple[int, int]:
    """Return width and height from ``WIDTHxHEIGHT``.

    Raises:
        UsageError: the text has another form.
    """
    match = re.fullmatch(r"(\d{1,9})x(\d{1,9})", size)
    if not match:
        raise UsageError(f"--size: {size!r} is not WIDTHxHEIGHT, such as 1280x720")
    return int(match[1]), int(match[2])
