"""Commands that evolve: `train`, `resume`, `sweep` and `refine`, and `watch`, which follows a run.

`watch` reads the files that the trainer writes after every generation. It writes nothing to the run
folder.
"""

import contextlib
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import evo_cpg as evo
from evo_cpg.cli.errors import require_none
from evo_cpg.cli.interrupts import wait_for_no_thread
from evo_cpg.cli.options import (
    Browser,
    ClusterOption,
    Config,
    Cores,
    CoresOfRun,
    Number,
    Overrides,
    Port,
    Run,
    Strict,
    What,
    complete_config,
    find_config_or_folder,
    find_run,
    on_cluster,
    run_folder,
)
from evo_cpg.cli.terminal import is_read, show_table, tell, warn
from evo_cpg.errors import ClusterError, UsageError

if TYPE_CHECKING:
    from evo_cpg.api.training import Trained
    from evo_cpg.view.live_page.standing import Standing

# Interval between two checks of the folder that `watch` follows, s.
LOOK = 1.0

# Largest number of rows of a table on a terminal. The file has all rows.
_MOST_ROWS = 30

# Results below this p value are marked.
_SURE = 0.05


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
    cluster: ClusterOption = None,
) -> None:
    """Evolve a population and keep the champion."""
    from evo_cpg.api.advice import about_oscillators
    from evo_cpg.api.experiment import Experiment
    from evo_cpg.api.runs import build, read_config
    from evo_cpg.training import devices

    given = read_config(config, overrides or [], strict)
    # Set the number of cores first: finding a place to stand on uneven ground starts JAX.
    devices.use_cores(cores)
    experiment = Experiment(build(given, config), given, config)
    run = out or Path("runs") / given.name
    for line in about_oscillators(experiment.parts.simulation):
        warn(f"{config}: {line}")
    with _continuation(f"resume {run}", cluster, run / "config.yaml"), on_cluster(cluster):
        trained = evo.train(experiment, run, start=earlier, what=what.value)
    _show_champion(trained)


def resume(
    run: Run,
    generations: Annotated[
        int | None, typer.Option(min=1, help="Continue to this total number of generations.")
    ] = None,
    cores: CoresOfRun = None,
    cluster: ClusterOption = None,
) -> None:
    """Continue a run from its newest checkpoint."""
    with _continuation(f"resume {run}", cluster, run / "config.yaml"), on_cluster(cluster):
        trained = evo.resume(run, generations, cores=cores)
    if not trained.was_finished:
        _show_champion(trained)
        return
    done = int(trained.history[-1]["generation"]) + 1
    tell(
        f"{run} is finished: all {done} generations are done, and the champion is in "
        f"{run / 'champion.npz'}. To continue, give a larger total, such as `evo-cpg resume {run} "
        f"--generations {2 * done}`"
    )
    print(run)


@contextlib.contextmanager
def _continuation(command: str, cluster: str | None, started: Path):
    """Name the command that continues, if this one is interrupted or loses its cluster."""
    on = f" --cluster {cluster}" if cluster else ""
    words = f"Continue with `evo-cpg {command}{on}`"
    try:
        yield
    except KeyboardInterrupt:
        if started.is_file():
            tell(f"interrupted. {words}")
        raise
    except ClusterError as error:
        raise ClusterError(f"{error}. {words}" if started.is_file() else str(error)) from error


def _show_champion(trained: "Trained") -> None:
    from evo_cpg.analysis.verdict import shown

    terms = ", ".join(f"{name} {value:.3g}" for name, value in trained.terms.items())
    # The progress line counts generations that are done. Their numbers begin with 0.
    origin = f"generation {trained.generation} (the first is 0)"
    if any("run" in row for row in trained.history):
        origin += f" of run {trained.run}"
    fitness = f"fitness {trained.fitness:.4f}"
    if trained.expected is not None:
        fitness += f" in training, mean {trained.expected:.4f} over {trained.draws} new draws"
    tell(f"champion of {origin}: {fitness} ({terms})")
    audit, seen = f"`evo-cpg audit {trained.folder}`", trained.half_step
    if trained.skipped:
        wait_for_no_thread()
        tell(f"skipped: the champion was not tested at half the step. {audit} tests it")
    elif seen is not None and seen.passed is not None:
        kept = f"at half the physics step it keeps {shown(seen.measured, '%')} of its displacement"
        if not seen.passed:
            causes = "the step length" + (" or the noise" if trained.expected is not None else "")
            kept = f"warning: {kept} ({seen.detail}). It may exploit {causes}"
        tell(f"{kept}. For a full test, run {audit}")
    print(trained.folder)


def sweep(
    config: Annotated[
        Path,
        typer.Argument(
            metavar="CONFIG",
            help="A YAML configuration file, the name of a shipped one, or a sweep to continue.",
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
            help="Values of a key. Several keys give all combinations.",
        ),
    ] = None,
    settings: Annotated[
        Path | None,
        typer.Option(
            "--settings", metavar="FILE", help="A YAML file, {name: {key: value, ...}, ...}."
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder (default: runs/CONFIG_sweep).")
    ] = None,
    only: Annotated[
        list[str] | None, typer.Option("--only", metavar="NAME", help="Evolve only this setting.")
    ] = None,
    cores: Cores = None,
    cluster: ClusterOption = None,
) -> None:
    """Evolve with many settings and compare the results."""
    from evo_cpg.io.settings import read_settings

    axes: dict[str, list[Any]] = {}
    for word in grid or []:
        key, values = _axis(word)
        if key in axes:
            raise UsageError(f"--grid: {key} is given twice. Give all its values in one")
        axes[key] = values
    named = read_settings(settings) if settings else {}
    folder = config if config.is_dir() else out or Path("runs") / f"{config.stem}_sweep"
    started = folder / "sweep.json"
    with _continuation(f"sweep {folder}", cluster, started), on_cluster(cluster):
        found = evo.sweep(config, overrides or [], axes, named, out, only or [], cores)
    spreads = [
        (
            one.name,
            str(one.runs),
            f"{one.median:.4g}",
            f"{one.low:.4g} to {one.high:.4g}",
            f"{one.worst:.4g}",
            f"{one.best:.4g}",
        )
        for one in found.spreads[:_MOST_ROWS]
    ]
    heads = "setting", "runs", "median", "quartiles", "worst", "best"
    show_table(heads, spreads, title="fitness of the champions")
    tests = [
        (
            one.first,
            one.second,
            f"{one.wins:.0%}",
            f"{one.p_value:.3g}",
            f"{one.adjusted:.3g}" + (" *" if one.adjusted < _SURE else ""),
        )
        for one in sorted(found.comparisons, key=lambda one: one.adjusted)[:_MOST_ROWS]
    ]
    if tests:
        heads = "setting", "against", "wins", "p", "p corrected"
        title = "comparisons (Mann-Whitney test, Holm correction)"
        show_table(heads, tests, left=2, title=title)
    print(found.figure)
    print(found.folder)


def _axis(word: str) -> tuple[str, list[Any]]:
    """Return key and values of ``key=a,b,c``, of ``key=[a,b,c]`` or of ``key=[a,b],[c,d]``."""
    import yaml

    from evo_cpg.io.yaml_text import parse_yaml

    key, equals, text = word.partition("=")
    if not (key and equals and text):
        raise UsageError(f"--grid: {word!r} is not KEY=VALUE,VALUE,...")
    try:
        values = parse_yaml(f"[{text}]")
    except yaml.YAMLError:
        values = None
    if isinstance(values, list) and len(values) == 1 and isinstance(values[0], list):
        values = values[0]
    if not isinstance(values, list) or not values:
        raise UsageError(
            f"--grid: {text!r} is not a list of values, such as 1,2,3 or [0,1],[2,3] for vectors"
        )
    return key, values


def refine(
    run: Run,
    keys: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="KEY",
            help="Numbers of the configuration to refine together with the genes, such as "
            "controller.cpg.time_scale.",
        ),
    ] = None,
    rounds: Annotated[int, typer.Option(min=1, help="Rounds of ascent and selection.")] = 5,
    steps: Annotated[
        int, typer.Option(min=1, help="Gradient steps of each individual in a round.")
    ] = 20,
    number: Number = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random starts and step sizes.")] = 0,
    cores: CoresOfRun = None,
) -> None:
    """Improve the champion along the gradient of its fitness."""
    try:
        found = evo.refine(run, keys or [], rounds, steps, number, seed, cores)
    except KeyboardInterrupt:
        tell(f"interrupted. The gain so far is in {run}")
        raise
    if found.gained:
        for key, value in found.numbers.items():
            tell(f"{key}: {value:.6g}")
        terms = ", ".join(f"{name} {value:.3g}" for name, value in found.terms.items())
        tell(f"fitness {found.before:.4f} -> {found.fitness:.4f} ({terms})")
    print(found.folder)


def watch(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run folder made by `train`.")],
    once: Annotated[
        bool, typer.Option("--once", help="Print the present state, then exit.")
    ] = False,
    page: Annotated[
        bool,
        typer.Option(
            "--page",
            help="Show the run on a page in the browser: the champion in 3D, curves, and the "
            "population. RUN may not exist yet.",
        ),
    ] = False,
    port: Port = 0,
    browser: Browser = True,
) -> None:
    """Follow a run while it evolves."""
    from evo_cpg.training.run_folder import RunFolder

    if page:
        require_none("--page", {"--once": once})
        from evo_cpg.system import resolved
        from evo_cpg.view.live_page.following import Following
        from evo_cpg.view.live_page.server import live_server

        followed = Following(RunFolder(run), lambda words: print(words, flush=True))
        # A thread may compile for long, or wait in JAX.
        wait_for_no_thread()
        with live_server(followed, resolved(run).name, port) as server:
            show_address(run, server, browser)
            followed.start()
            with contextlib.suppress(KeyboardInterrupt):
                server.serve_forever()
            followed.close()
        return
    from evo_cpg.view.live_page.standing import require_run, standing

    folder = RunFolder(find_run(run))
    require_run(folder)
    seen: Standing | None = None
    printed = 0
    while True:
        now = standing(folder, seen)
        if now is not seen or once:
            history = now.checkpoint.history if now.checkpoint else []
            for row in [row for row in history if row["generation"] >= printed]:
                number = f"  run {int(row['run'])}" if "run" in row else ""
                print(
                    f"{int(row['generation']) + 1:4d}/{now.generations} generations{number}  "
                    f"champion {row['champion']:8.4f}  best {row['best']:8.4f}  "
                    f"mean {row['mean']:8.4f}  {row['seconds']:6.2f} s",
                    flush=True,
                )
            if history:
                printed = int(history[-1]["generation"]) + 1
            elif once:
                print(f"{folder.path}: no generation is finished yet", flush=True)
            seen = now
        if once or now.finished or not is_read():
            return
        time.sleep(LOOK)


def show_address(subject: Path, server: Any, browser: bool) -> None:
    """Print the address of a page, and open it in the browser if requested."""
    from evo_cpg.view.run_page.server import opened

    print(f"{subject}: open this address in a browser of this machine")
    print(server.address)
    print("Control-C ends the program.", flush=True)
    if browser and not opened(server.address):
        tell(f"No browser was found. Open the address yourself. {server.reach}.")
