"""Commands that draw: `render`, `plot`, `preview`, and the page of `model`."""

import itertools
import math
import re
from pathlib import Path
from typing import Annotated

import typer

import evo_cpg as evo
from evo_cpg.cli.errors import require_none
from evo_cpg.cli.evolve import show_address
from evo_cpg.cli.options import (
    Browser,
    Cell,
    Config,
    Cores,
    Crowd,
    Number,
    Overrides,
    Port,
    Run,
    Strict,
    Trial,
    View,
    Wall,
    complete_config,
    find_run,
)
from evo_cpg.errors import UsageError

# Largest number of animals side by side.
_MOST = 9


def render(
    run: Run,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="A .mp4, .webp, .gif or .png file (default: in RUN/videos), or FOLDER/%04d.png "
            "for one picture per frame. With --wall also a .html file.",
        ),
    ] = None,
    size: Annotated[
        str | None,
        typer.Option(
            help="WIDTHxHEIGHT in pixels (default: 1280x720, or 640x360 for each picture of a "
            "sheet and each of several animals, or 1920x1080 for a story)."
        ),
    ] = None,
    sheet: Annotated[
        str | None,
        typer.Option(
            metavar="COLUMNSxROWS",
            help="Draw one picture with this many moments of the film, such as 4x3. Several "
            "animals stand in columns.",
        ),
    ] = None,
    title: Annotated[
        list[str] | None,
        typer.Option(metavar="TEXT", help="Caption of the champion, then of each --beside animal."),
    ] = None,
    camera: Annotated[View, typer.Option(help="Position of the camera.")] = View.FOLLOW,
    signals: Annotated[
        bool,
        typer.Option("--signals", help="Also show joint angles, their commands and footfalls."),
    ] = False,
    lineage: Annotated[
        str | None,
        typer.Option(
            metavar="GENERATIONS",
            help="Show the champions of these generations side by side, such as 0,5,20,49, or "
            "auto for four of them. The first generation is 0. If body plans evolve, ancestors "
            "shows the champion's line of descent in one shot, in which limbs grow.",
        ),
    ] = None,
    beside: Annotated[
        list[Path] | None,
        typer.Option(metavar="RUN", help="Also show the champion of this run. Repeatable."),
    ] = None,
    crowd: Crowd = None,
    wall: Wall = None,
    story: Annotated[
        bool,
        typer.Option(
            "--story",
            help="Tell the run in 15 s: the first generation as a crowd, later ones, the champion "
            "in slow motion.",
        ),
    ] = False,
    fps: Annotated[float, typer.Option(min=1, max=240, help="Frames per second.")] = 30.0,
    speed: Annotated[float, typer.Option(min=0.01, help="Speed of the film (1: real time).")] = 1.0,
    seconds: Annotated[
        float | None, typer.Option(min=0.1, help="Show only the first seconds of the trial.")
    ] = None,
    number: Number = None,
    trial: Trial = 0,
    cell: Cell = None,
    cores: Cores = None,
) -> None:
    """Film the champion of a run, or an elite of its map of gaits."""
    from evo_cpg.api.ancestors import ancestors_panel
    from evo_cpg.api.film import (
        IN_FILM,
        champion_panel,
        crowd_panel,
        lineage_panels,
        wall_page,
        wall_panel,
    )
    from evo_cpg.api.progress import working
    from evo_cpg.api.runs import open_champion, suffix, writing
    from evo_cpg.files import make_folder
    from evo_cpg.training.devices import available_cores
    from evo_cpg.training.run_folder import RunFolder
    from evo_cpg.view.film import Film, film_path, side_by_side

    alone = {
        "--lineage": lineage, "--beside": beside, "--signals": signals, "--cell": cell,
    }  # fmt: skip
    titles, others = title or [], [find_run(each) for each in beside or []]
    if story:
        fixed = {
            "--sheet": sheet, "--crowd": crowd is not None, "--wall": wall is not None,
            "--seconds": seconds,
            "--camera": camera != View.FOLLOW, "--fps": fps != 30, "--speed": speed != 1,
        }  # fmt: skip
        require_none("--story", alone | fixed)
        if len(titles) > 1:
            raise UsageError(f"--title: {len(titles)} titles for one story. Give one")
        pixels = _pair_of("--size", size or "1920x1080", 9)
        with writing(run, output):
            given = output, pixels, (titles or [None])[0], number, trial, cores
            print(evo.story(run, *given))
        return
    if lineage is not None:
        require_none("--lineage", {"--cell": cell, "--beside": others, "--title": titles})
    if crowd is not None:
        require_none("--crowd", {**alone, "--wall": wall is not None})
    as_page = wall is not None and output is not None and output.suffix == ".html"
    if wall is not None:
        sheets = as_page and sheet is not None
        require_none("--wall", {**alone, "--camera": camera != View.FOLLOW, "--sheet": sheets})
    if titles and len(titles) != 1 + len(others):
        raise UsageError(f"--title: {len(titles)} for {1 + len(others)} animals. Give one for each")
    if len(others) >= _MOST:
        raise UsageError(f"--beside: {len(others) + 1} runs are too many. Allowed: up to {_MOST}")
    moments = None if sheet is None else _pair_of("--sheet", sheet, 2)
    several = lineage not in (None, "ancestors") or bool(others) or moments is not None
    pixels = _pair_of("--size", size or ("640x360" if several else "1280x720"), 9)
    generations = None
    if lineage not in (None, "auto", "ancestors"):
        if not re.fullmatch(r"\d{1,9}(,\d{1,9})*", lineage):
            raise UsageError(
                f"--lineage: {lineage!r} is neither auto, ancestors nor a list of generations, "
                "such as 0,5,20,49"
            )
        generations = [int(part) for part in lineage.split(",")]
        if len(generations) > _MOST:
            raise UsageError(
                f"--lineage: {len(generations)} generations are too many. Allowed: up to {_MOST}"
            )
    film_of = {
        "ancestors": lineage == "ancestors", "lineage": lineage is not None,
        f"crowd{crowd}": crowd is not None, f"wall_{wall}": wall is not None,
    }  # fmt: skip
    name = next((word for word, chosen in film_of.items() if chosen), "champion")
    name += suffix(number, trial, cell) + "_beside_others" * bool(others)
    name += f"_{camera}" * (camera != View.FOLLOW) + "_signals" * signals
    name += ".mp4" if moments is None else "_sheet.png"
    with writing(run, output):
        film = Film(pixels, fps, seconds, speed, camera.value, moments)
        RunFolder(run).require()
        if as_page:
            assert wall is not None and output is not None
            opened, name = open_champion(run, number, trial), (titles or [None])[0]
            print(wall_page(opened, wall, trial, film, output, name))
            return
        # Check the path before making the folder of films.
        film_path(output or run / name, film, signals)
        if wall is not None:
            panels = [wall_panel(open_champion(run, number, trial), wall, trial, film, IN_FILM)]
        elif crowd is not None:
            opened = open_champion(run, number, trial)
            panels = [crowd_panel(opened, crowd, trial, film)]
        elif lineage == "ancestors":
            require_none("--lineage ancestors", {"--signals": signals})
            panels = [ancestors_panel(open_champion(run, number, trial), trial)]
        elif lineage is not None:
            panels = lineage_panels(run, generations, number, trial, signals)
        else:
            panels = [champion_panel(run, number, trial, cell, signals)]
            panels += [champion_panel(other, None, trial, cell, signals) for other in others]
        if titles:
            panels = [one._replace(title=words) for one, words in zip(panels, titles, strict=True)]
        path = output or make_folder(run / "videos") / name
        with working("rendering", counted=True) as work:
            processes = cores or available_cores()
            made = side_by_side(panels, path, film, processes=processes, progress=work.reached)
    print(made)


def _pair_of(option: str, text: str, digits: int) -> tuple[int, int]:
    """Return the two positive numbers of a text such as ``1280x720``.

    Raises:
        UsageError: the text has another form, or a number has more digits.
    """
    match = re.fullmatch(rf"([1-9]\d{{0,{digits - 1}}})x([1-9]\d{{0,{digits - 1}}})", text)
    if not match:
        raise UsageError(f"{option}: {text!r} is not two numbers such as 1280x720")
    return int(match[1]), int(match[2])


def plot(
    run: Run,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder (default: RUN/plots).")
    ] = None,
    number: Number = None,
    trial: Trial = 0,
    cell: Cell = None,
) -> None:
    """Plot fitness, joint signals, path, map and family tree."""
    from evo_cpg.analysis.chains import axis_signs, joint_rows
    from evo_cpg.api.ancestors import family_pictures
    from evo_cpg.api.runs import motion_of, open_champion, suffix, writing
    from evo_cpg.files import make_folder
    from evo_cpg.io.run import gait_map
    from evo_cpg.view.figure import save_figure
    from evo_cpg.view.plots import fitness_figure, joint_signals_figure, path_figure
    from evo_cpg.view.search_plots import map_figure

    with writing(run, output):
        opened = open_champion(run, number, trial, cell)
        recording, experiment = motion_of(opened, trial), opened.on_course(trial).experiment
        simulation, place = experiment.simulation, output or make_folder(run / "plots")
        name, tree = suffix(number, trial, cell), simulation.world.tree
        history = opened.folder.history()
        history["best_so_far"] = history["champion"]
        print(save_figure(fitness_figure(history), place / "fitness.png"))
        if recording.dof_names:
            rows = joint_rows(tree)
            figure = joint_signals_figure(
                recording,
                chains=rows,
                signs=axis_signs(tree, rows),
                title=experiment.name,
                signal=simulation.controller.signal_label,
            )
            print(save_figure(figure, place / f"joint_signals{name}.png"))
        figure = path_figure(recording, experiment.creature.root_index)
        print(save_figure(figure, place / f"path{name}.png"))
        checkpoint, own = opened.folder.load(), opened.champion.run
        found = checkpoint and gait_map(opened.experiment, checkpoint, own)
        if found:
            title = experiment.name + (f", run {own}" if experiment.runs > 1 else "")
            figure = map_figure(found.axes, found.fitness, title)
            print(save_figure(figure, place / f"map{suffix(number)}.png"))
        if opened.experiment.simulation.plans is not None:
            print(*family_pictures(opened, place), sep="\n")


def preview(
    config: Config,
    overrides: Overrides = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="A .png file (default: NAME.png).")
    ] = None,
    size: Annotated[str, typer.Option(help="WIDTHxHEIGHT in pixels.")] = "1280x720",
    strict: Strict = False,
) -> None:
    """Draw the creature of a config at rest."""
    from evo_cpg.api.progress import working
    from evo_cpg.api.runs import read_config
    from evo_cpg.io.build import build_creature, build_experiment
    from evo_cpg.io.schema.ground import PlaneConfig
    from evo_cpg.simulation.situation import starting_pose
    from evo_cpg.view.preview import preview as draw
    from evo_cpg.view.preview import preview_path

    pixels = _pair_of("--size", size, 9)
    given = read_config(config, overrides or [], strict)
    creature = build_creature(given, config)
    place = preview_path(output or Path(f"{creature.name}.png"), pixels)
    pose, land, water = None, given.world.ground, given.world.water
    ground = land is not None
    surface = None
    if water is not None:
        surface = math.inf if water.surface is None else water.surface
    on_shore = surface is not None and math.isfinite(surface)
    shaped = land is not None and (on_shore or bool(land.obstacles) or land.floor != PlaneConfig())
    if given.simulation.start_pose == "settled" or shaped:
        # Draw the initial pose, with obstacles and shore.
        names = [body.name for body in creature.bodies]
        with working("computing the initial pose"):
            simulation = build_experiment(given, config).simulation
            pose = starting_pose(simulation.situations[0], simulation.world.tree, names)
        contact_model = simulation.world.contact_model
        ground = contact_model.ground if contact_model is not None else False
    with working("drawing"):
        made = draw(creature, place, pixels, ground=ground, pose=pose, surface=surface)
    print(made)


def model(
    config: Annotated[
        Path | None,
        typer.Argument(
            metavar="CONFIG",
            help="A YAML configuration file, a new one, or the name of one that `evo-cpg configs` "
            "lists, which is copied (default: a new animal.yaml).",
            autocompletion=complete_config,
        ),
    ] = None,
    port: Port = 0,
    browser: Browser = True,
) -> None:
    """Draw a creature on a page in the browser."""
    from evo_cpg.api.advice import about_oscillators
    from evo_cpg.files import require_place
    from evo_cpg.io.shipped import find_config
    from evo_cpg.view.drawing_page.document import Document
    from evo_cpg.view.drawing_page.server import drawing_server
    from evo_cpg.view.drawing_page.session import DrawingSession

    if config is not None and config.exists():
        document = Document.open(config)
    elif config is not None and config.suffix in (".yaml", ".yml"):
        document = Document.new(require_place(config))
    else:
        # A new file, or the copy of a shipped one, has a name that is free.
        source = None if config is None else find_config(config)
        stem = "animal" if source is None else source.stem
        names = itertools.chain([stem], (f"{stem}{i}" for i in itertools.count(2)))
        place = next(path for name in names if not (path := Path(f"{name}.yaml")).exists())
        document = Document.new(place) if source is None else Document.copy_of(source, place)
    session = DrawingSession(document, about_oscillators)
    with drawing_server(session, port) as server:
        show_address(document.path, server, browser)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            pass
        finally:
            session.close()
    if document.is_changed and document.can_undo:
        print(f"Edits of {document.path} are not saved. `evo-cpg model` offers them again.")
