"""`evo-cpg render`: film champions."""

import re
from pathlib import Path
from typing import Annotated

import typer

from evo_cpg.cli.errors import UsageError
from evo_cpg.cli.options import BEST, Cores, Crowd, Run, View, Which, pixels_of, run_folders
from evo_cpg.cli.writing import writes_to_run

# Largest number of animals side by side.
_MOST = 9


@writes_to_run("output", "--output")
def render(
    run: Run,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="A .mp4, .webp, .gif or .png file (default: in RUN/videos), or FOLDER/%04d.png "
            "for one picture per frame.",
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
            "auto for four of them. The first generation is 0.",
        ),
    ] = None,
    beside: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="RUN",
            help="Also show the champion of this run. Repeatable.",
            callback=run_folders,
        ),
    ] = None,
    crowd: Crowd = None,
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
    which: Which = BEST,
    cores: Cores = None,
) -> None:
    """Film the champion of a run, or an elite of its map of gaits."""
    alone = {
        "--lineage": lineage, "--beside": beside, "--signals": signals, "--cell": which.cell,
    }  # fmt: skip
    if story:
        fixed = {
            "--sheet": sheet, "--crowd": crowd is not None, "--seconds": seconds,
            "--camera": camera != View.FOLLOW, "--fps": fps != 30, "--speed": speed != 1,
        }  # fmt: skip
        _require_none("--story", alone | fixed)
        if len(title or ()) > 1:
            raise UsageError(f"--title: {len(title or ())} titles for one story. Give one")
        _tell(run, output, pixels_of(size or "1920x1080"), (title or [None])[0], which, cores)
        return
    others = beside or []
    moments = None if sheet is None else _moments(sheet)
    several = lineage is not None or bool(others)
    pixels = pixels_of(size or ("640x360" if several or moments else "1280x720"))
    if lineage is not None and (which.cell is not None or others):
        wrong = "--cell" if which.cell is not None else "--beside"
        raise UsageError(f"--lineage and {wrong} exclude each other. Leave out one of them")
    if crowd is not None:
        _require_none("--crowd", alone)
    if title and lineage is not None:
        raise UsageError(
            "--title: animals of --lineage are captioned with generation and fitness. "
            "Leave --title out"
        )
    if title and len(title or ()) != 1 + len(others):
        raise UsageError(
            f"--title: {len(title or ())} for {1 + len(others)} animals. Give one for each"
        )
    if len(others) >= _MOST:
        raise UsageError(f"--beside: {len(others) + 1} runs are too many. Allowed: up to {_MOST}")
    generations = None if lineage is None else _generations(lineage)
    name = "lineage" if lineage is not None else which.of_cell.removeprefix("_") or "champion"
    name = name if crowd is None else f"crowd{crowd}"
    name += which.of_trial + ("_beside_others" if others else "")
    name += ("" if camera == "follow" else f"_{camera}") + "_signals" * signals
    name += ".mp4" if moments is None else "_sheet.png"
    from evo_cpg.api.display import working
    from evo_cpg.cli.champions import open_champion
    from evo_cpg.cli.filmed import champion_panel, crowd_panel, lineage_panels
    from evo_cpg.files import make_folder
    from evo_cpg.training.devices import available_cores
    from evo_cpg.training.run_folder import RunFolder
    from evo_cpg.view.film import Film, film_path, side_by_side

    film = Film(pixels, fps, seconds, speed, camera.value, moments)
    RunFolder(run).require()
    # Check the path before making the folder of films.
    film_path(output or run / name, film, signals)
    if crowd is not None:
        panels = [crowd_panel(open_champion(run, which), crowd, which.trial, film)]
    elif lineage is not None:
        panels = lineage_panels(run, generations, which, signals)
    else:
        panels = [champion_panel(run, which, signals)]
        beside_it = which._replace(number=None)
        panels += [champion_panel(other, beside_it, signals) for other in others]
    if title:
        panels = [one._replace(title=words) for one, words in zip(panels, title, strict=True)]
    path = output or make_folder(run / "videos") / name
    with working("rendering", counted=True) as work:
        made = side_by_side(
            panels, path, film, processes=cores or available_cores(), progress=work.reached
        )
    print(made)


def _tell(
    run: Path,
    output: Path | None,
    size: tuple[int, int],
    title: str | None,
    which: Which,
    cores: int | None,
) -> None:
    """Film the story of a run, by default into its videos, and print the path of the film."""
    from evo_cpg.api.story import film_of_run
    from evo_cpg.cli.champions import champion_motion
    from evo_cpg.cli.errors import warn
    from evo_cpg.files import make_folder
    from evo_cpg.training.devices import available_cores
    from evo_cpg.training.run_folder import RunFolder
    from evo_cpg.view.output import check_size, output_path

    RunFolder(run).require()
    check_size(size)
    name = f"story{which.of_trial}.mp4"
    path = output_path(output or make_folder(run / "videos") / name, (".mp4",))
    opened, recording = champion_motion(run, which)
    made = film_of_run(
        opened,
        recording,
        path,
        size,
        trial=which.trial,
        title=title,
        processes=cores or available_cores(),
        warn=warn,
    )
    print(made)


def _require_none(option: str, others: dict[str, object]) -> None:
    """Check that none of the options is given that do not fit another one.

    Raises:
        UsageError: one of them is given.
    """
    if found := next((name for name, given in others.items() if given), None):
        raise UsageError(f"{option} and {found} exclude each other. Leave out one of them")


def _generations(lineage: str) -> list[int] | None:
    """Return the requested generations, or None for ``auto``.

    Raises:
        UsageError: the text has another form, or names too many generations.
    """
    if lineage == "auto":
        return None
    if not re.fullmatch(r"\d{1,9}(,\d{1,9})*", lineage):
        raise UsageError(
            f"--lineage: {lineage!r} is neither auto nor a list of generations, such as 0,5,20,49"
        )
    found = [int(part) for part in lineage.split(",")]
    if len(found) > _MOST:
        raise UsageError(
            f"--lineage: {len(found)} generations are too many. Allowed: up to {_MOST}"
        )
    return found


def _moments(sheet: str) -> tuple[int, int]:
    match = re.fullmatch(r"([1-9]\d?)x([1-9]\d?)", sheet)
    if not match:
        raise UsageError(f"--sheet: {sheet!r} is not COLUMNSxROWS of at most 99, such as 4x3")
    return int(match[1]), int(match[2])
