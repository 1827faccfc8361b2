"""`evo-cpg fit`: estimate parameters from a recorded motion."""

from pathlib import Path
from typing import Annotated

import typer

from evo_cpg.cli.errors import require_free
from evo_cpg.cli.options import Config, Overwrite, run_folder


def fit(
    config: Config,
    data: Annotated[Path, typer.Argument(metavar="DATA.csv", help="A recorded motion.")],
    keys: Annotated[
        list[str],
        typer.Argument(
            metavar="KEY[=START]...",
            help="Numbers to estimate, such as world.water.form_drag or initial.velocity.x.",
        ),
    ],
    settings: Annotated[
        list[str] | None, typer.Option("--set", help="KEY=VALUE to set without estimating it.")
    ] = None,
    run: Annotated[
        Path | None,
        typer.Option(
            "--run", help="A run folder, whose champion moves the joints.", callback=run_folder
        ),
    ] = None,
    noise: Annotated[
        list[str] | None,
        typer.Option(
            help="Standard deviation of a kind of column: position= (m), attitude= or angle= (rad) "
            "(default: estimated)."
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="A .yaml file for the fitted configuration.")
    ] = None,
    plot: Annotated[
        Path | None, typer.Option("--plot", help="Draw data and fit: a .png, .svg or .pdf file.")
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Estimate numbers of a config from a recorded motion."""
    from evo_cpg.cli.fitted import fit_motion
    from evo_cpg.view.output import PLOT_SUFFIXES, output_path

    for file, suffixes in ((out, (".yaml", ".yml")), (plot, PLOT_SUFFIXES)):
        if file is not None:
            require_free(output_path(file, suffixes), overwrite)
    fit_motion(config, data, keys, settings or [], run, noise or [], out, plot)
