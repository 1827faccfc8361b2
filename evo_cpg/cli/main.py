"""`evo-cpg`: one command for everything that a user does.

Every command imports what it needs only when it runs: `--help` must be quick, and training must
not load VTK.
"""

import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from evo_cpg.cli import streams
from evo_cpg.cli.completion import complete_config
from evo_cpg.cli.configs import app as configs_app
from evo_cpg.cli.errors import told
from evo_cpg.cli.exit_codes import ExitCode
from evo_cpg.cli.interrupts import interrupts_delivered, leave_at_once, waits_for_threads
from evo_cpg.cli.options import (
    Cell,
    Config,
    Cores,
    Distributed,
    Hosts,
    JoinTimeout,
    Local,
    Number,
    Overrides,
    Overwrite,
    Patience,
    Process,
    Run,
    Strict,
    Tensorboard,
    Trial,
    View,
    What,
    find_config_or_folder,
)

# What these evolve is in a folder, even if nobody can be told which.
_EVOLVING = frozenset({"train", "resume", "refine", "sweep", "reproduce"})


class _Commands(TyperGroup):
    """The commands; what Typer says of a wrong option is in its words, but not in Pydantic's."""

    def invoke(self, ctx: typer.Context) -> Any:
        """Parse what is asked of a command, and do it."""
        try:
            return super().invoke(ctx)
        except typer.BadParameter as error:
            error.message = error.message.removeprefix("Value error, ")
            raise


app = typer.Typer(
    name="evo-cpg",
    cls=_Commands,
    help="Evolve the motion of virtual creatures.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
app.add_typer(configs_app, name="configs")


def _show_version(wanted: bool) -> bool:
    if wanted:
        from evo_cpg.api.version import version

        print(version())
        raise typer.Exit
    return wanted


def _trust(wanted: bool) -> bool:
    if wanted:
        from evo_cpg.config.trust import trust

        trust()
    return wanted


@app.callback()
def options(
    trust: Annotated[
        bool,
        typer.Option(
            "--trust",
            callback=_trust,
            help="The configuration is yours: it may run code beside it and name files anywhere.",
        ),
    ] = False,
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_show_version, is_eager=True, help="Show the version and exit."
        ),
    ] = False,
) -> None:
    """Evolve the motion of virtual creatures."""


@app.command()
def train(
    config: Config,
    overrides: Overrides = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Run folder; runs/NAME by default.")
    ] = None,
    cores: Cores = None,
    strict: Strict = False,
    earlier: Annotated[
        Path | None,
        typer.Option(
            "--from", metavar="RUN", help="Begin with what evolved in an earlier run (same plan)."
        ),
    ] = None,
    what: Annotated[
        What, typer.Option("--start", help="Of it, the champion or the population.")
    ] = What.CHAMPION,
    distributed: Distributed = False,
    hosts: Hosts = None,
    process: Process = None,
    local: Local = None,
    join_timeout: JoinTimeout = 60.0,
    patience: Patience = None,
    tensorboard: Tensorboard = False,
) -> None:
    """Evolve a population and keep the champion."""
    from evo_cpg.cli.distributed import Distribution

    def check() -> None:
        from evo_cpg.config.load import load_config

        load_config(config, overrides or [])

    asked = Distribution(distributed, hosts, process, local, join_timeout, patience).checked()
    asked.start_local(cores, check)
    from evo_cpg.cli.training import start_run

    start_run(config, overrides or [], out, cores, strict, earlier, what.value, asked, tensorboard)


@app.command()
def resume(
    run: Run,
    generations: Annotated[
        int | None, typer.Option(min=1, help="Evolve up to this many generations in all.")
    ] = None,
    cores: Cores = None,
    distributed: Distributed = False,
    hosts: Hosts = None,
    process: Process = None,
    local: Local = None,
    join_timeout: JoinTimeout = 60.0,
    patience: Patience = None,
    tensorboard: Tensorboard = False,
) -> None:
    """Go on with a run from its newest checkpoint."""
    from evo_cpg.cli.distributed import Distribution

    def check() -> None:
        from evo_cpg.training.run_folder import RunFolder

        with RunFolder(run).locked():
            RunFolder(run).require()

    asked = Distribution(distributed, hosts, process, local, join_timeout, patience).checked()
    asked.start_local(cores, check)
    from evo_cpg.cli.training import resume_run

    resume_run(run, generations, cores, asked, tensorboard)


@app.command()
def sweep(
    config: Annotated[
        Path,
        typer.Argument(
            metavar="CONFIG",
            help="A YAML configuration file or the name of a shipped one; or a sweep, to go on "
            "with it.",
            callback=find_config_or_folder,
            autocompletion=complete_config,
        ),
    ],
    overrides: Overrides = None,
    grid: Annotated[
        list[str] | None,
        typer.Option(
            "--grid",
            metavar="KEY=A,B,...",
            help="Values of a key; of several, every combination.",
        ),
    ] = None,
    settings: Annotated[
        Path | None,
        typer.Option(
            "--settings", metavar="FILE", help="A YAML file, {name: {key: value, ...}, ...}."
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder; runs/CONFIG_sweep by default.")
    ] = None,
    only: Annotated[
        list[str] | None, typer.Option("--only", metavar="NAME", help="Only this setting.")
    ] = None,
    cores: Cores = None,
    jobs: Annotated[
        str | None,
        typer.Option(
            metavar="N|slurm",
            help="What shares no program as jobs: N processes here at a time, or jobs of SLURM.",
        ),
    ] = None,
    job_option: Annotated[
        list[str] | None,
        typer.Option(
            "--job-option",
            metavar="KEY=VALUE",
            help="With --jobs slurm, a parameter of submitit, such as slurm_partition=long, "
            "timeout_min=600, cpus_per_task=8 or mem_gb=4.",
        ),
    ] = None,
) -> None:
    """Evolve under many settings and compare what comes of them."""
    from evo_cpg.cli.sweep import run_sweep

    given = config, overrides or [], grid or [], settings, out, cores, only or []
    if not run_sweep(*given, jobs, job_option or []):
        raise typer.Exit(ExitCode.FAULT)


@app.command()
def reproduce(
    study: Annotated[
        str | None,
        typer.Argument(
            metavar="STUDY",
            help="One of iwadate2010, fukui2003, salamander, hexapod, starfish, turtle, search,"
            " benchmarks.",
        ),
    ] = None,
    parts: Annotated[
        list[str] | None,
        typer.Argument(metavar="[PART]...", help="Parts of it; all by default."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="Folder; docs/reproduction/STUDY of a clone, else reproduction/STUDY.",
        ),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Scaled down: does everything run? No results.")
    ] = False,
    listed: Annotated[
        bool, typer.Option("--list", help="Show the studies, their parts, and how each was made.")
    ] = False,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Throw finished runs of these parts away first.")
    ] = False,
    cores: Cores = None,
) -> None:
    """Make the tables and pictures of a study anew."""
    from evo_cpg.cli.reproduce import reproduce_study

    reproduce_study(study, parts or [], out, quick, listed, fresh, cores)


@app.command()
def refine(
    run: Run,
    keys: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[KEY]...",
            help="Numbers of the configuration to refine with the genes, such as "
            "controller.cpg.time_scale.",
        ),
    ] = None,
    rounds: Annotated[int, typer.Option(min=1, help="Rounds of climbing and choosing.")] = 5,
    steps: Annotated[int, typer.Option(min=1, help="Moves of each lane in a round.")] = 20,
    number: Number = None,
    seed: Annotated[int, typer.Option(min=0, help="Of what the lanes draw.")] = 0,
    cores: Cores = None,
) -> None:
    """Polish the champion of a run along the slope of its fitness."""
    from evo_cpg.cli.refine import refine_run

    refine_run(run, keys or [], rounds, steps, number, seed, cores)


@app.command()
def render(
    run: Run,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="A .mp4, .webp, .gif or .png file, in RUN/videos by default; or FOLDER/%04d.png "
            "for a picture of every frame.",
        ),
    ] = None,
    size: Annotated[
        str | None,
        typer.Option(
            help="WIDTHxHEIGHT in pixels: 1280x720, or 640x360 for each of a sheet and of animals "
            "side by side."
        ),
    ] = None,
    sheet: Annotated[
        str | None,
        typer.Option(
            metavar="COLUMNSxROWS",
            help="One picture of so many moments of the film, such as 4x3; of several animals "
            "each moment is a column of them.",
        ),
    ] = None,
    title: Annotated[
        list[str] | None,
        typer.Option(metavar="TEXT", help="Caption of the champion, then of every one beside it."),
    ] = None,
    camera: Annotated[View, typer.Option(help="From where the animal is seen.")] = View.FOLLOW,
    signals: Annotated[
        bool,
        typer.Option("--signals", help="Show joint angles, what drives them, and footfalls, too."),
    ] = False,
    lineage: Annotated[
        str | None,
        typer.Option(
            metavar="GENERATIONS",
            help="Side by side those who were champion in these generations, such as 0,5,20,49; "
            "auto for four.",
        ),
    ] = None,
    beside: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="RUN", help="Another run, whose champion is shown beside; repeatable."
        ),
    ] = None,
    fps: Annotated[float, typer.Option(min=1, max=240, help="Frames per second.")] = 30.0,
    speed: Annotated[float, typer.Option(min=0.01, help="Speed of the film; 1 is real.")] = 1.0,
    seconds: Annotated[
        float | None, typer.Option(min=0.1, help="Show only the first seconds of the trial.")
    ] = None,
    number: Number = None,
    trial: Trial = 0,
    cell: Cell = None,
    cores: Cores = None,
) -> None:
    """Film the champion of a run, or anybody on its map of behaviour."""
    from evo_cpg.cli.render import Film, render_run
    from evo_cpg.cli.writing import writing

    film = Film(output, size, sheet, camera.value, fps, speed, seconds, signals, title or [], cores)
    with writing(run, output, "--output"):
        render_run(run, film, number, trial, cell, lineage, beside or [])


@app.command()
def plot(
    run: Run,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder; RUN/plots by default.")
    ] = None,
    number: Number = None,
    trial: Trial = 0,
    cell: Cell = None,
) -> None:
    """Plot the fitness over the generations, the champion's joint signals and path, and the map."""
    from evo_cpg.cli.pictures import plot_run
    from evo_cpg.cli.writing import writing

    with writing(run, output, "--output"):
        plot_run(run, output, number, trial, cell)


@app.command()
def analyse(
    run: Run,
    output: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="A .html file; RUN/analysis.html by default."),
    ] = None,
    number: Number = None,
    trial: Trial = 0,
    overwrite: Overwrite = False,
) -> None:
    """Make a page of a run: the champion in 3D, its gait in numbers and charts."""
    from evo_cpg.cli.analyse import analyse_run
    from evo_cpg.cli.writing import writing

    with writing(run, output, "--out"):
        analyse_run(run, output, number, trial, overwrite)


@app.command()
def watch(
    run: Run,
    once: Annotated[bool, typer.Option("--once", help="Look once, and end.")] = False,
    picture: Annotated[
        bool, typer.Option(help="Draw the newest champion into RUN/watch.png.")
    ] = True,
) -> None:
    """Look on while a run evolves: curves, and a picture of the newest champion."""
    from evo_cpg.cli.watch import watch_run

    watch_run(run, once, picture)


@app.command("probe")
def probe_(
    run: Run,
    bearings: Annotated[
        str | None,
        typer.Option(
            help="Of the light to the left, in degrees: START:STOP:COUNT, -75:75:11 by default, "
            "or a list such as -60,0,60."
        ),
    ] = None,
    distances: Annotated[
        str | None,
        typer.Option(help="Of the light, in m, likewise; that of the config by default."),
    ] = None,
    trials: Annotated[
        bool, typer.Option("--trials", help="Take the situations of the config instead.")
    ] = False,
    blind: Annotated[bool, typer.Option("--blind", help="Let all light sensors give 0.")] = False,
    reach: Annotated[
        float,
        typer.Option(min=0, help="Share of the distance that may be left of a light reached."),
    ] = 0.2,
    number: Number = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder for the files; RUN by default.")
    ] = None,
) -> None:
    """Put the champion into situations that it never saw."""
    from evo_cpg.cli.probe import probe_run
    from evo_cpg.cli.writing import writing

    with writing(run, out, "--out"):
        probe_run(run, bearings, distances, trials, blind, reach, number, out)


@app.command()
def sensitivity(
    run: Run,
    keys: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[KEY]...",
            help="Numbers of its configuration, such as world.water.form_drag, or genes; "
            "all by default but shapes in water.",
        ),
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(min=0, help="Of the trial, from its start; all by default.")
    ] = None,
    shapes: Annotated[
        bool, typer.Option("--shapes", help="Also those that change surfaces in water: slow.")
    ] = False,
    number: Number = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder for the files; RUN by default.")
    ] = None,
) -> None:
    """Tell what the champion's speed and fitness depend on, parameter by parameter."""
    from evo_cpg.cli.sensitivity import show_sensitivities
    from evo_cpg.cli.writing import writing

    with writing(run, out, "--out"):
        show_sensitivities(run, keys or [], out, seconds, number, shapes)


@app.command()
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
    from evo_cpg.cli.fit import fit_data

    fit_data(config, data, keys, settings or [], run, noise or [], out, plot, overwrite)


@app.command()
def preview(
    config: Config,
    overrides: Overrides = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="A .png file; NAME.png by default.")
    ] = None,
    size: Annotated[str, typer.Option(help="WIDTHxHEIGHT in pixels.")] = "1280x720",
    strict: Strict = False,
) -> None:
    """Draw the creature of a config at rest."""
    from evo_cpg.cli.pictures import preview_config

    preview_config(config, overrides or [], output, size, strict)


@app.command()
def verify(run: Run, cores: Cores = None) -> None:
    """Replay the champion and compare it with what was recorded."""
    from evo_cpg.cli.verify import verify_run

    verify_run(run, cores)


@app.command()
def audit(
    run: Run,
    limits: Annotated[
        list[str] | None,
        typer.Argument(metavar="[LIMIT=VALUE]...", help="Limits to change, such as half_step=0.8."),
    ] = None,
    number: Number = None,
    every: Annotated[
        bool, typer.Option("--all", help="Of several runs side by side, all champions.")
    ] = False,
    cell: Cell = None,
) -> None:
    """Ask whether the champion's gait is one, or a trick of the simulation."""
    from evo_cpg.cli.audit import audit_run
    from evo_cpg.cli.writing import writing

    with writing(run):
        audit_run(run, limits or [], number, every, cell)


@app.command()
def validate(
    configs: Annotated[
        list[str],
        typer.Argument(
            metavar="CONFIG... [KEY=VALUE]...",
            help="YAML configuration files or names of shipped ones, and settings to change in "
            "all of them.",
            autocompletion=complete_config,
        ),
    ],
    strict: Strict = False,
) -> None:
    """Check configuration files without running them."""
    from evo_cpg.cli.validate import validate_configs

    validate_configs(configs, strict)


@app.command()
def cpg(
    config: Config,
    overrides: Overrides = None,
    gain: Annotated[
        float | None,
        typer.Option(min=0, help="Adaptation gain b; the middle of its range by default."),
    ] = None,
    tonic_input: Annotated[
        float | None, typer.Option(min=0, help="Tonic input u; the largest by default.")
    ] = None,
    frequency: Annotated[
        float | None, typer.Option(help="Look for settings that give this frequency, in Hz.")
    ] = None,
    lag: Annotated[
        float | None,
        typer.Option(
            help="Look for settings that give this mean lag along a chain, in degrees; "
            "negative from tail to head."
        ),
    ] = None,
    chain: Annotated[
        str | None,
        typer.Option(
            metavar="JOINT", help="Mean the longest chain through this oscillator, not of all."
        ),
    ] = None,
) -> None:
    """Show the rhythm of a config's oscillators, or settings that give a wanted one."""
    if frequency is not None or lag is not None or chain is not None:
        from evo_cpg.cli.wanted import find_rhythm

        find_rhythm(config, overrides or [], gain, tonic_input, frequency, lag, chain)
        return
    from evo_cpg.cli.rhythm import show_rhythm

    show_rhythm(config, overrides or [], gain, tonic_input)


@app.command()
def export(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="CONFIG_OR_RUN",
            help="A configuration file, the name of a shipped one, or a run folder.",
            callback=find_config_or_folder,
            autocompletion=complete_config,
        ),
    ],
    output: Annotated[
        Path,
        typer.Argument(
            metavar="OUT",
            help="A .xml file for a MuJoCo model; of a run also a .glb, .csv or .npz file for the "
            "motion.",
        ),
    ],
    number: Number = None,
    trial: Trial = 0,
    cell: Cell = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a creature as a MuJoCo model, or a run's motion as a 3D scene or a table."""
    from evo_cpg.cli.exchange import export

    export(source, output, overwrite, number, trial, cell)


@app.command("import")
def import_(
    model: Annotated[
        Path, typer.Argument(metavar="MODEL.xml", help="An MJCF file, read by MuJoCo.")
    ],
    output: Annotated[Path, typer.Argument(metavar="OUT.yaml", help="The creature to write.")],
    motor_gain: Annotated[
        float | None,
        typer.Option(help="Make velocity servos of torque motors, with this gain in N m s/rad."),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a MuJoCo model as a creature, if creatures can be like that."""
    from evo_cpg.cli.exchange import import_model

    import_model(model, output, motor_gain, overwrite)


@app.command()
def bench(
    cases: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[CASE]...",
            help="swimmer, salamander-water, salamander-land, quadruped, cpg, brain, ga, "
            "generation, gradient, bodies, large-creatures, engines, scaling or startup; all by "
            "default.",
        ),
    ] = None,
    sizes: Annotated[
        str | None,
        typer.Option(help="Individuals, such as 1,15,200; each case has its own by default."),
    ] = None,
    json: Annotated[
        Path | None, typer.Option("--json", help="Also write the rows to this file.")
    ] = None,
    plot: Annotated[
        Path | None, typer.Option("--plot", help="Draw the rates: a .png, .svg or .pdf file.")
    ] = None,
    compare: Annotated[
        Path | None,
        typer.Option("--compare", help="An earlier --json file; exit code 3 if anything lost."),
    ] = None,
    tolerance: Annotated[
        float, typer.Option(min=0, max=1, help="Share that may be lost before that.")
    ] = 0.1,
    limit: Annotated[
        float, typer.Option(min=1, help="Seconds that a peer written in JAX may compile.")
    ] = 120.0,
    quick: Annotated[
        bool, typer.Option("--quick", help="One size, short calls, few repeats: a first look.")
    ] = False,
) -> None:
    """Measure this program beside its peers on this machine."""
    from evo_cpg.cli.bench import run_suite

    run_suite(cases or [], sizes, json, plot, compare, tolerance, limit, quick)


def _command() -> str:
    """Name of the command that this process was started with."""
    return next((word for word in sys.argv[1:] if not word.startswith("-")), "")


def main() -> None:
    """Run the command line.

    Errors that are the user's or the system's become one or two lines and exit code 2.
    """
    try:
        with interrupts_delivered():
            app()
    except KeyboardInterrupt:
        raise SystemExit(ExitCode.INTERRUPTED) from None
    except Exception as error:
        words = told(error)
        if words is None:
            raise
        print(f"evo-cpg: {words}", file=sys.stderr)
        raise SystemExit(ExitCode.WRONG_INPUT) from None


def program() -> None:
    """`main` as a process: after an interrupt nobody waits for what still compiles."""
    streams.protect()
    try:
        main()
    except SystemExit as stop:
        if stop.code == ExitCode.INTERRUPTED:
            leave_at_once(ExitCode.INTERRUPTED)
        error = streams.output_error()
        if error is not None:
            words = f"cannot write to standard output ({error.strerror or error})"
            print(f"evo-cpg: {words}", file=sys.stderr)
            if not stop.code and _command() not in _EVOLVING:
                raise SystemExit(ExitCode.WRONG_INPUT) from None
        if not waits_for_threads() and isinstance(stop.code, int | None):
            leave_at_once(stop.code or 0)
        raise
