"""`evo-cpg lab`: ask an animal a question without evolution."""

from pathlib import Path
from typing import Annotated

import typer

from evo_cpg.cli.completion import complete_config
from evo_cpg.cli.options import Number, Overwrite, find_config_or_folder


def lab(
    animal: Annotated[
        Path,
        typer.Argument(
            metavar="ANIMAL",
            help="A run folder, a YAML configuration file, or the name of one that `evo-cpg "
            "configs` lists.",
            callback=find_config_or_folder,
            autocompletion=complete_config,
        ),
    ],
    knobs: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="KNOB=VALUES",
            help="What to vary: a list such as u=0.2,0.6 or u=0.2:1:9 (START:STOP:COUNT). Knobs: "
            "u (drive), b (adaptation), turn, cut, behind, undriven, feedback, silence, passive, "
            "stiffness, size, viscosity, gravity, current, tow, bend, degrees, ratio, and keys of "
            "the configuration such as world.water.density.",
        ),
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(
            min=0.1,
            help="Duration of each trial, of which the second half is measured (default: from the "
            "configuration).",
        ),
    ] = None,
    number: Number = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", help="Folder for the files (default: lab/NAME, lab/NAME_2...)."
        ),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Ask an animal a question without evolution."""
    from evo_cpg.cli.answers import ask_animal

    ask_animal(animal, knobs or [], seconds, number, out, overwrite)
