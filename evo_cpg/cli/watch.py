"""`evo-cpg watch`: follow a run while it evolves.

The command reads the files that the trainer writes after every generation, and requests nothing of
the trainer. It runs at the lowest priority. It writes one file to the run folder, the picture of
the newest champion.
"""

import contextlib
import math
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from evo_cpg.cli.errors import message_for, warn
from evo_cpg.cli.options import Run
from evo_cpg.cli.streams import is_read

if TYPE_CHECKING:
    from rich.console import Console

    from evo_cpg.training.checkpoint import Champion, Checkpoint
    from evo_cpg.training.run_folder import RunFolder

PICTURE = "watch.png"
# Interval between two checks of the folder, s.
LOOK = 1.0
# Least time between two pictures, s, and largest fraction of the time spent on pictures.
_SELDOM, _LARGEST_FRACTION = 10.0, 0.2
# Niceness of this process: the trainer has priority on the cores.
_NICE = 15


class Standing(NamedTuple):
    """State of a run.

    Attributes:
        checkpoint: newest checkpoint, or None before the first generation is done.
        generations: requested number of generations in all.
        choosing: whether the champion is chosen with fresh noise after the last generation.
        changed: time of the last change to metrics.csv, s since the epoch, or None if unknown.
    """

    checkpoint: "Checkpoint | None"
    generations: int
    choosing: bool
    changed: float | None

    @property
    def finished(self) -> bool:
        """Return whether all generations are done and the champion is chosen."""
        if self.checkpoint is None or self.checkpoint.generation < self.generations:
            return False
        return not self.choosing or bool(self.checkpoint.chosen)


def watch(
    run: Run,
    once: Annotated[
        bool, typer.Option("--once", help="Print the present state, then exit.")
    ] = False,
    picture: Annotated[
        bool, typer.Option(help="Draw the newest champion into RUN/watch.png.")
    ] = True,
) -> None:
    """Follow a run while it evolves."""
    from rich.console import Console
    from rich.live import Live

    from evo_cpg.cli.watched import panel
    from evo_cpg.training.run_folder import RunFolder, RunFolderError

    folder = RunFolder(run)
    # `require` would finish interrupted writes, which only the trainer may do.
    if not folder.config.is_file():
        raise RunFolderError(f"{run} is not a run folder (it has no config.yaml)")
    lower_priority()
    draw = _Pictures(folder).draw if picture else lambda champion, standing: None
    console = Console()
    if once or not console.is_terminal:
        _in_lines(folder, console, draw, once)
        return
    with Live(console=console, refresh_per_second=4, screen=False) as live:
        seen = None
        while True:
            now = standing(folder, seen)
            if now is not seen:
                live.update(panel(folder, now, console.width), refresh=True)
                seen = now
            _newest(now, draw)
            if now.finished:
                return
            live.update(panel(folder, now, console.width))
            time.sleep(LOOK)


def lower_priority() -> None:
    """Lower the priority of this process below other processes, particularly the trainer.

    If the system has a scheduling class for idle cores, use it: a nice process still takes some
    time of busy cores.
    """
    if hasattr(os, "nice"):
        with contextlib.suppress(OSError):
            os.nice(max(0, _NICE - os.nice(0)))
    if hasattr(os, "SCHED_IDLE"):
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))


def standing(folder: "RunFolder", before: Standing | None = None) -> Standing:
    """Return the state of a run, or ``before`` if nothing is new.

    Args:
        folder: folder of the run.
        before: state that was seen last, if any.
    """
    done = folder.newest
    if before is not None and before.checkpoint:
        same = before.checkpoint.generation == done
        # The last generation has a second checkpoint, with the chosen champion.
        if same and (done < before.generations or before.finished):
            return before
    # The trainer may delete a checkpoint during the read. Then a newer checkpoint exists.
    checkpoint = folder.load()
    changed = None
    if checkpoint is not None:
        with contextlib.suppress(OSError):
            changed = folder.metrics.stat().st_mtime
    return Standing(checkpoint, *_plan(folder), changed)


def _plan(folder: "RunFolder") -> tuple[int, bool]:
    """Return the number of generations, and whether there is noise.

    Both are read each time, because `resume` may change the configuration.
    """
    from evo_cpg.config.load import load_run_config

    config = load_run_config(folder.config)
    return config.evolution.generations, not config.noise.silent


def _in_lines(
    folder: "RunFolder", console: "Console", draw: "Callable[[Champion, Standing], Any]", once: bool
) -> None:
    """Print a line for each generation, for a log or pipe."""
    seen: Standing | None = None
    printed = 0
    while True:
        now = standing(folder, seen)
        if now is not seen or once:
            history = now.checkpoint.history if now.checkpoint else []
            for row in [row for row in history if row["generation"] >= printed]:
                print(_line(row, now), flush=True)
            if history:
                printed = int(history[-1]["generation"]) + 1
            elif once:
                print(f"{folder.path}: no generation is finished yet", flush=True)
            seen = now
        made = _newest(now, draw)
        if made is not None:
            print(made, flush=True)
        if once or now.finished or not is_read():
            return
        time.sleep(LOOK)


def _line(row: dict[str, float], now: Standing) -> str:
    run = f"  run {int(row['run'])}" if "run" in row else ""
    return (
        f"{int(row['generation']) + 1:4d}/{now.generations} generations{run}  "
        f"champion {row['champion']:8.4f}  best {row['best']:8.4f}  mean {row['mean']:8.4f}  "
        f"{row['seconds']:6.2f} s"
    )


def _newest(now: Standing, draw: "Callable[[Champion, Standing], Any]") -> Path | None:
    champion = now.checkpoint.champion if now.checkpoint else None
    return None if champion is None else draw(champion, now)


class _Pictures:
    """Picture of the newest champion, drawn at a limited rate.

    Args:
        folder: folder of the run.
    """

    def __init__(self, folder: "RunFolder"):
        self._folder = folder
        self._drawn: tuple[float, ...] | None = None
        self._next = -math.inf
        self._built: Any = None

    def draw(self, champion: "Champion", now: Standing) -> Path | None:
        """Draw a new champion if a picture is due, and return the path of the picture, if any."""
        which = (champion.run, champion.generation, champion.fitness)
        began = time.monotonic()
        if which == self._drawn or (began < self._next and not now.finished):
            return None
        self._drawn = which
        try:
            made = self._make(champion, now)
        except OSError as error:
            # A user who only watches may have no permission to write there.
            warn(f"no picture: {message_for(error)}")
            self._next = math.inf
            return None
        took = time.monotonic() - began
        self._next = time.monotonic() + max(_SELDOM, took / _LARGEST_FRACTION)
        return made

    def _make(self, champion: "Champion", now: Standing) -> Path:
        if self._built is None:
            self._built = self._build()
        experiment, live = self._built
        from evo_cpg.training.checkpoint import history_columns
        from evo_cpg.view.watch_picture import watch_picture

        assert now.checkpoint is not None
        _, _, recording = live(champion)
        return watch_picture(
            experiment,
            recording,
            history_columns(now.checkpoint.history),
            f"{experiment.name}: champion of generation {champion.generation}, "
            f"fitness {champion.fitness:.4f}",
            self._folder.path / PICTURE,
        )

    def _build(self) -> tuple[Any, Any]:
        """Build the experiment and compile its replay, on one core."""
        from evo_cpg.api.opened import class_folders
        from evo_cpg.cli.building import build
        from evo_cpg.config.load import load_run_config
        from evo_cpg.training.devices import use_cores
        from evo_cpg.training.replay import compile_replay

        use_cores(1)
        config = load_run_config(self._folder.config)
        experiment = build(config, self._folder.config, class_folders(self._folder))
        devices = self._folder.read_meta().get("devices", 1)
        return experiment, compile_replay(experiment, devices)
