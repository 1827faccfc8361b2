"""`evo-cpg fit`: estimate parameters from a recorded motion."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from evo_cpg.cli.errors import UsageError, require_free, warn
from evo_cpg.cli.options import Config, Overwrite


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
        list[str] | None, typer.Option("--set", help="KEY=VALUE to change but not to estimate.")
    ] = None,
    run: Annotated[
        Path | None, typer.Option("--run", help="A run folder, whose champion moves the joints.")
    ] = None,
    noise: Annotated[
        list[str] | None,
        typer.Option(
            help="position=, attitude= or angle=: its standard deviation; else estimated."
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
    """Estimate numbers of a config from a recorded motion, with their uncertainty."""
    import numpy as np

    from evo_cpg.cli.champions import open_champion
    from evo_cpg.cli.fitted import (
        INITIAL,
        check_names,
        is_positive,
        number_in,
        report,
        require_many,
        search,
        trial_of,
    )
    from evo_cpg.cli.measured_motion import late_commands, read_motion
    from evo_cpg.cli.progress import working
    from evo_cpg.config.load import dump_config, load_config
    from evo_cpg.config.numbers import number_at, with_numbers
    from evo_cpg.config.parameters import parametrise
    from evo_cpg.files import write_text
    from evo_cpg.view.output import PLOT_SUFFIXES, output_path

    for file, suffixes in ((out, (".yaml", ".yml")), (plot, PLOT_SUFFIXES)):
        if file is not None:
            require_free(output_path(file, suffixes), overwrite)
    recording = read_motion(data)
    own = [text for text in settings or [] if not text.startswith(INITIAL)]
    whole = load_config(config, own)
    names = [key.partition("=")[0] for key in keys]
    start = {key.partition("=")[0]: number_in(key) for key in keys if "=" in key}
    begun = {text.partition("=")[0]: number_in(text) for text in settings or [] if text not in own}
    inner = tuple(name for name in names if not name.startswith(INITIAL))
    for name in inner:
        number_at(whole, name, config)
    both = [name for name in names if name in {text.partition("=")[0] for text in settings or []}]
    if both:
        raise UsageError(
            f"{both[0]}: is searched for and set; give its start as {both[0]}=VALUE alone"
        )
    _check_keys(names, run)
    genes = None
    if run is not None:
        if recording.targets:
            raise UsageError("--run: the champion moves the joints; leave out the target columns")
        # Before anything starts JAX.
        genes = np.asarray(open_champion(run)[1].genes, float)
    begins = with_numbers(whole, {k: v for k, v in start.items() if k in inner}, config)
    parameters = parametrise(trial_of(recording, begins), config, inner)
    simulation = parameters.experiment.simulation
    check_names(recording, simulation, [*begun, *set(names) - set(inner)], data)
    if genes is not None and (wrong := simulation.genome.misfit(genes)):
        raise UsageError(f"--run: the champion of {run} does not fit {config}: {wrong}")
    ordered = (*inner, *(name for name in names if name not in inner))
    values = [number_at(begins, name) for name in inner]
    values += [start.get(name, begun.get(name, 0.0)) for name in ordered[len(inner) :]]
    positive = np.array([is_positive(parameters, name) for name in ordered])
    numbers = np.isfinite(recording.data).sum()
    if numbers <= len(ordered):
        raise UsageError(f"{data}: {numbers} numbers cannot determine {len(ordered)} parameters")
    require_many(recording, len(ordered), noise or [], data)
    late = late_commands(recording, simulation)
    if late:
        warn(
            f"{data}: {late} commands come between two control steps, of which "
            f"there are {simulation.control_rate:g} a second, and take effect at the next"
        )
    with working("compiling the search") as work:
        result, shown = search(
            parameters,
            recording,
            ordered,
            np.array(values),
            positive,
            begun,
            genes,
            noise or [],
            work,
        )
    report(ordered, np.array(values), positive, result, recording)
    if out is not None:
        found = dict(zip(ordered, map(float, result.values), strict=True))
        fitted = with_numbers(whole, {k: v for k, v in found.items() if k in inner}, config)
        text = dump_config(fitted)
        write_text(out, text)
        print(out)
    if plot is not None:
        from evo_cpg.view.figure import save_figure
        from evo_cpg.view.parameter_plots import fit_figure

        figure = fit_figure(recording.time, recording.columns, recording.data, shown)
        print(save_figure(figure, plot))


def _check_keys(names: Sequence[str], run: Path | None) -> None:
    for i, name in enumerate(names):
        if name in names[:i]:
            raise UsageError(f"{name}: is given twice")
        if run is None and name.startswith("controller."):
            raise UsageError(
                f"{name}: the recorded commands move the joints, not the controller; "
                "--run RUN takes a champion's"
            )
