"""The command that makes films: render."""

import math
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from evo_cpg.api.record import Life, lives_again
from evo_cpg.cli.champions import (
    REPLAY_TOLERANCE,
    champion_motion,
    open_champion,
    require_trial,
)
from evo_cpg.cli.errors import UsageError
from evo_cpg.cli.pictures import of_trial, pixels_of
from evo_cpg.cli.progress import working
from evo_cpg.files import make_folder
from evo_cpg.training.checkpoint import Champion
from evo_cpg.training.devices import available_cores
from evo_cpg.training.experiment import Experiment
from evo_cpg.training.lineage import champion_at, telling
from evo_cpg.training.run_folder import RunFolder, RunFolderError

if TYPE_CHECKING:
    from evo_cpg.view.panel import Panel
    from evo_cpg.view.signals import Signals

# Animals side by side: of a lineage where nothing is said, and at most.
_SHOWN, _MOST = 4, 9


class Film(NamedTuple):
    """How a film is made, see `evo-cpg render --help`."""

    output: Path | None
    size: str | None
    sheet: str | None
    camera: str
    fps: float
    speed: float
    seconds: float | None
    signals: bool
    titles: Sequence[str] = ()
    cores: int | None = None


def render_run(
    run: Path,
    film: Film,
    number: int | None,
    trial: int,
    cell: str | None,
    lineage: str | None,
    beside: Sequence[Path],
) -> None:
    """`evo-cpg render`.

    Args:
        run: the run folder.
        film: how it is made.
        number: whose champion, where the folder holds several runs; None for the best.
        trial: in which of its trials, from 0.
        cell: of the run's map, whose elite is wanted instead.
        lineage: generations whose champions are wanted side by side, ``auto``, or None.
        beside: other run folders, whose champions are wanted beside that of the first.

    Raises:
        UsageError: an option is wrong, or two do not go together.
    """
    moments = None if film.sheet is None else _moments(film.sheet)
    several = lineage is not None or bool(beside)
    pixels = pixels_of(film.size or ("640x360" if several or moments else "1280x720"))
    if lineage is not None and (cell is not None or beside):
        other = "--cell" if cell is not None else "--beside"
        raise UsageError(f"--lineage: the champions of a run on its way; leave {other} out")
    if film.titles and lineage is not None:
        raise UsageError("--title: of a lineage every one has its generation and fitness")
    if film.titles and len(film.titles) != 1 + len(beside):
        raise UsageError(
            f"--title: {len(film.titles)} for {1 + len(beside)} animals; give one for each"
        )
    if len(beside) >= _MOST:
        raise UsageError(f"--beside: {len(beside) + 1} runs are too many; {_MOST} have room")
    wanted = None if lineage is None else _generations(lineage)
    from evo_cpg.view.film import film_path, side_by_side

    name = "champion" if cell is None else f"cell_{cell.replace(',', '_')}"
    name = name if lineage is None else "lineage"
    name += "" if number is None else f"_run{number}"
    name += of_trial(trial) + ("_beside_others" if beside else "")
    name += ("" if film.camera == "follow" else f"_{film.camera}") + "_signals" * film.signals
    name += ".mp4" if moments is None else "_sheet.png"
    settings = {
        "size": pixels,
        "fps": film.fps,
        "seconds": film.seconds,
        "speed": film.speed,
        "camera": film.camera,
        "sheet": moments,
    }
    RunFolder(run).require()
    # The folder of films is made where there is one to put there.
    film_path(film.output or run / name, **settings, signals=film.signals)
    if lineage is not None:
        panels = _lineage(run, wanted, number, trial, film.signals)
    else:
        panels = []
        for place in (run, *beside):
            which = number if place == run else None
            panels.append(_panel(place, which, trial, cell, film.signals))
    if film.titles:
        panels = [
            shown._replace(title=title) for shown, title in zip(panels, film.titles, strict=True)
        ]
    path = film.output or make_folder(run / "videos") / name
    with working("rendering", counted=True) as work:
        made = side_by_side(
            panels,
            path,
            **settings,
            processes=film.cores or available_cores(),
            progress=work.reached,
        )
    print(made)


def _panel(run: Path, number: int | None, trial: int, cell: str | None, signals: bool) -> "Panel":
    """The champion of a run, or the elite of a cell."""
    from evo_cpg.view.panel import panel_of
    from evo_cpg.view.units import told

    strip = None
    if signals:
        experiment, champion, _, folder = open_champion(run, number, cell)
        require_trial(experiment, folder, trial)
        (life,) = _replayed(experiment, [champion], folder, trial)
        recording, strip = life.recording, _signals(experiment, life)
    else:
        experiment, champion, recording, _ = champion_motion(run, number, trial, cell)
    if cell is None:
        return panel_of(experiment, recording, experiment.name, strip)
    # Of an elite the map keeps what it is told apart by, and nothing else.
    title = f"{experiment.name}, cell {cell}"
    return panel_of(experiment, recording, title, strip, told(champion.terms))


def _lineage(
    run: Path, wanted: list[int] | None, number: int | None, trial: int, signals: bool
) -> "list[Panel]":
    """Those who were champion on the way, each with its generation and fitness."""
    from evo_cpg.view.panel import panel_of

    experiment, champion, _, folder = open_champion(run, number)
    require_trial(experiment, folder, trial)
    chosen, panels = _chosen(folder, champion, wanted), []
    for one in chosen:
        wrong = experiment.simulation.genome.misfit(one.genes)
        if wrong:
            raise RunFolderError(f"{folder.lineage}: generation {one.generation}: {wrong}")
    for one, life in zip(chosen, _replayed(experiment, chosen, folder, trial), strict=True):
        if not math.isclose(
            life.fitness, one.fitness, rel_tol=REPLAY_TOLERANCE, abs_tol=REPLAY_TOLERANCE
        ):
            print(
                f"evo-cpg: warning: {run}: the champion of generation {one.generation} comes to "
                f"{life.fitness:.4f} and not to {one.fitness:.4f} as recorded: {folder.config} or "
                "the machine is another one than it evolved with",
                file=sys.stderr,
            )
        title = f"generation {one.generation}: fitness {one.fitness:.3g}"
        if one.expected is not None:
            title = f"champion: fitness {one.expected:.3g} in fresh draws"
        shown = _signals(experiment, life) if signals else None
        panels.append(panel_of(experiment, life.recording, title, shown))
    return panels


def _chosen(folder: RunFolder, champion: Champion, wanted: list[int] | None) -> list[Champion]:
    """Champions of a run, in the order of generations, nobody twice.

    Args:
        folder: of the run.
        champion: in the end.
        wanted: generations; None for some that tell how it came to the champion.
    """
    run = champion.run
    lineage = [each for each in folder.load_lineage() if each.run == run]
    if not lineage:
        raise RunFolderError(f"{folder.lineage} knows no champion of run {run}")
    if wanted is None:
        if champion.expected is None:
            return telling(lineage, _SHOWN)
        # Who had the best score on the way need not be who was chosen in the end.
        places = (champion.generation, champion.index)
        others = [each for each in lineage if (each.generation, each.index) != places]
        return [*telling(others, _SHOWN - 1), champion]
    done = folder.newest
    found: list[Champion] = []
    for generation in sorted(set(wanted)):
        one = champion_at(lineage, generation)
        if generation >= max(done, lineage[-1].generation + 1):
            raise UsageError(
                f"--lineage: {folder.path} has done {done} generations; {done - 1} is the last"
            )
        if one is None:
            raise UsageError(
                f"--lineage: the first champion that {folder.path} knows is that of generation "
                f"{lineage[0].generation}"
            )
        if all(one is not other for other in found):
            found.append(one)
    return found


def _replayed(
    experiment: Experiment, champions: Sequence[Champion], folder: RunFolder, trial: int
) -> list[Life]:
    with working("replaying the champion"):
        return lives_again(experiment, champions, folder, trial)


def _signals(experiment: Experiment, life: Life) -> "Signals":
    """What the controller of an individual did, and its feet."""
    from evo_cpg.analysis.gait_numbers import gait_numbers
    from evo_cpg.view.signals import signals_of

    simulation = experiment.simulation
    word, _, unit = simulation.controller.signal_label.partition(" (")
    feet = gait_numbers(simulation, experiment.creature, life.frames, life.recording).feet
    names, touched = ((), None) if feet is None else (feet.names, feet.steady)
    return signals_of(life.recording, word, unit == "rad)", names, touched)


def _generations(lineage: str) -> list[int] | None:
    """What is asked for; None for a choice of ours."""
    if lineage == "auto":
        return None
    if not re.fullmatch(r"\d{1,9}(,\d{1,9})*", lineage):
        raise UsageError(
            f"--lineage: {lineage!r} is not auto and no list of generations, such as 0,5,20,49"
        )
    found = [int(part) for part in lineage.split(",")]
    if len(found) > _MOST:
        raise UsageError(f"--lineage: {len(found)} generations are too many; {_MOST} have room")
    return found


def _moments(sheet: str) -> tuple[int, int]:
    match = re.fullmatch(r"([1-9]\d?)x([1-9]\d?)", sheet)
    if not match:
        raise UsageError(f"--sheet: {sheet!r} is not COLUMNSxROWS of at most 99, such as 4x3")
    return int(match[1]), int(match[2])
