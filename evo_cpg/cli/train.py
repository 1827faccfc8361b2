"""`evo-cpg train`: start a run."""

from pathlib import Path
from typing import Annotated

import typer

from evo_cpg.cli.options import Config, Cores, Overrides, Strict, What, run_folder


def train(
    config: Config,
    overrides: Overrides = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Run folder (default: runs/NAME).")
    ] = None,
    cores: Cores = None,
    strict: Strict = False,
    earlier: Annotated[
        Path | None,
        typer.Option(
            "--from",
            metavar="RUN",
            help="Start from an earlier run of the same creature and controller.",
            callback=run_folder,
        ),
    ] = None,
    what: Annotated[
        What,
        typer.Option("--start", help="Start from the champion or the whole population of RUN."),
    ] = What.CHAMPION,
) -> None:
    """Evolve a population and keep the champion."""
    from evo_cpg.cli.building import read_config
    from evo_cpg.cli.training import train_run
    from evo_cpg.system import named
    from evo_cpg.training.devices import use_cores

    given = read_config(config, overrides or [], strict)
    # Finding a place to stand on uneven ground starts JAX.
    devices = use_cores(cores)
    run = out or Path("runs") / named(given.name)
    start = None if earlier is None else (earlier, what.value)
    train_run(config, given, run, devices, start)
