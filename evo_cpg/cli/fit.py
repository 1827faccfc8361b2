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
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="A .yaml file for the fitted configuration.")
    ] = None,
    plot: Annotated[
        Path | None, typer.Option("--plot", help="Draw data and fit: a .png, .svg or .pdf file.")
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Estimate numbers of a config from a recorded motion."""
    from evo_cpg.api.fit import fit as fit_motion
    from evo_cpg.cli.terminal import show_table
    from evo_cpg.files import write_text
    from evo_cpg.io.load import dump_config
    from evo_cpg.view.figure import save_figure
    from evo_cpg.view.output import PLOT_SUFFIXES, output_path
    from evo_cpg.view.plots import fit_figure

    for file, suffixes in ((out, (".yaml", ".yml")), (plot, PLOT_SUFFIXES)):
        if file is not None:
            require_free(output_path(file, suffixes), overwrite)
    found = fit_motion(config, data, keys, settings or [], run=run)
    result, recording = found.fit, found.recording
    columns = found.names, found.start, result.values, result.lower, result.upper
    rows = [
        (name, f"{first:.4g}", f"{value:.5g}", f"{low:.5g} to {high:.5g}")
        for name, first, value, low, high in zip(*columns, strict=True)
    ]
    show_table(("parameter", "start", "estimate", "95 % interval"), rows)
    print(f"noise: {result.noise:.3g} m or rad ({result.freedom} degrees of freedom)")
    for words in found.warnings:
        print(f"warning: {words}")
    if out is not None:
        write_text(out, dump_config(found.config))
        print(out)
    if plot is not None:
        figure = fit_figure(recording.time, recording.columns, recording.data, result.model)
        print(save_figure(figure, plot))
