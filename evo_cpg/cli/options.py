"""Arguments and options that several commands share."""

import enum
import os
import re
from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from evo_cpg.cli.completion import complete_config, complete_folder
from evo_cpg.cli.errors import UsageError, warn


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

    config = given / "config.yaml"
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
        from evo_cpg.cli.run_names import find_run

        return find_run(given)
    return find_config(given, folders=True)


def run_folder(given: Path | None) -> Path | None:
    """Return a run folder, or explain what its name means instead."""
    from evo_cpg.cli.run_names import find_run

    return given and find_run(given)


def run_folders(given: list[Path] | None) -> list[Path] | None:
    """Return run folders, or explain what a name means instead."""
    from evo_cpg.cli.run_names import find_run

    return given and [find_run(each) for each in given]


def name_replaced(overrides: list[str] | None) -> list[str] | None:
    """Return the overrides, with a warning for each that a later one replaces."""
    from evo_cpg.io.keys import replaces

    given = [(override.partition("=")[0], override) for override in overrides or []]
    for i, (key, override) in enumerate(given):
        for other, _ in given[:i]:
            if replaces(key, other):
                warn(f"{other} is given twice. Only the last value counts: {override}")
    return overrides


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
        metavar="RUN",
        help="A run folder made by `train`.",
        callback=run_folder,
        autocompletion=complete_folder,
    ),
]
Overrides = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="KEY=VALUE",
        help="Settings to change, such as seed=3.",
        callback=name_replaced,
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
    int,
    typer.Option("--trial", min=0, help="Trial of the champion, counted from 0."),
]
Cell = Annotated[
    str | None,
    typer.Option(
        "--cell",
        help="Use the elite of this cell of the run's map, not the champion: a number for "
        "each axis, from 0, such as 3,0,7.",
    ),
]


class Which(NamedTuple):
    """Options: a champion or elite of a run, and one of its trials.

    Attributes:
        number: number of one of several runs, or None for the best.
        trial: number of the trial, from 0.
        cell: cell of the run's map, such as ``3,0,7``, or None for the champion.
    """

    number: Number = None
    trial: Trial = 0
    cell: Cell = None

    @property
    def of_run(self) -> str:
        """Suffix for names of files about the run: ``_run1``."""
        return "" if self.number is None else f"_run{self.number}"

    @property
    def of_trial(self) -> str:
        """Suffix for names of files about the trial: ``_run1_trial2``."""
        return self.of_run + (f"_trial{self.trial}" if self.trial else "")

    @property
    def of_cell(self) -> str:
        """Suffix for names of files about the elite: ``_cell_3_0_7``."""
        return "" if self.cell is None else f"_cell_{self.cell.replace(',', '_')}"


BEST = Which()

Strict = Annotated[
    bool, typer.Option("--strict", help="Refuse values that are allowed but not plausible.")
]
Cores = Annotated[int | None, typer.Option(min=1, help="Cores to use (default: all).")]
CoresOfRun = Annotated[
    int | None, typer.Option("--cores", min=1, help="Cores to use (default: as in training).")
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
Folder = Annotated[
    Path | None, typer.Option("--out", "-o", help="Folder for the files (default: RUN).")
]


def pixels_of(size: str) -> tuple[int, int]:
    """Return width and height, pixels, from ``WIDTHxHEIGHT``.

    Raises:
        UsageError: the text has another form.
    """
    match = re.fullmatch(r"(\d{1,9})x(\d{1,9})", size)
    if not match:
        raise UsageError(f"--size: {size!r} is not WIDTHxHEIGHT, such as 1280x720")
    return int(match[1]), int(match[2])
