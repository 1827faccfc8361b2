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
from typing import TYPE_CHECKING, Annotated, Any

import typer

from evo_cpg.cli.completion import complete_folder
from evo_cpg.cli.errors import UsageError, message_for, tell, warn
from evo_cpg.cli.interrupts import wait_for_no_thread
from evo_cpg.cli.options import Browser, Port
from evo_cpg.cli.streams import is_read

if TYPE_CHECKING:
    from rich.console import Console

    from evo_cpg.live.replays import Replays
    from evo_cpg.live.standing import Standing
    from evo_cpg.training.checkpoint import Champion
    from evo_cpg.training.run_folder import RunFolder

PICTURE = "watch.png"
# Interval between two checks of the folder, s.
LOOK = 1.0
# Least time between two pictures, s, and largest fraction of the time spent on pictures.
_SELDOM, _LARGEST_FRACTION = 10.0, 0.2
# Niceness of this process: the trainer has priority on the cores.
_NICE = 15


def watch(
    run: Annotated[
        Path,
        typer.Argument(
            metavar="RUN",
            help="A run folder made by `train`.",
            autocompletion=complete_folder,
        ),
    ],
    once: Annotated[
        bool, typer.Option("--once", help="Print the present state, then exit.")
    ] = False,
    picture: Annotated[
        bool, typer.Option(help="Draw the newest champion into RUN/watch.png.")
    ] = True,
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
    if page:
        if once:
            raise UsageError("--once and --page exclude each other. Leave out one of them")
        _on_a_page(run, port, browser)
        return
    from rich.console import Console
    from rich.live import Live

    from evo_cpg.cli.run_names import find_run
    from evo_cpg.cli.watched import panel
    from evo_cpg.live.standing import require_run, standing
    from evo_cpg.training.run_folder import RunFolder

    folder = RunFolder(find_run(run))
    require_run(folder)
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


def _on_a_page(run: Path, port: int, browser: bool) -> None:
    """Serve the live page until Control-C."""
    from evo_cpg.live.following import Following
    from evo_cpg.live.page.server import LiveServer
    from evo_cpg.system import resolved
    from evo_cpg.training.run_folder import RunFolder
    from evo_cpg.view.page.server import opened

    followed = Following(RunFolder(run), lambda words: print(words, flush=True))
    # A thread may compile for long, or wait in JAX.
    wait_for_no_thread()
    with LiveServer(followed, resolved(run).name, port) as server:
        print(f"{run}: open this address in a browser of this machine")
        print(server.address)
        print("Control-C ends the program.", flush=True)
        if browser and not opened(server.address):
            tell(f"No browser was found. Open the address yourself. {server.reach}.")
        followed.start()
        with contextlib.suppress(KeyboardInterrupt):
            server.serve_forever()
        followed.close()


def _in_lines(
    folder: "RunFolder", console: "Console", draw: "Callable[[Champion, Standing], Any]", once: bool
) -> None:
    """Print a line for each generation, for a log or pipe."""
    from evo_cpg.live.standing import standing

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


def _line(row: dict[str, float], now: "Standing") -> str:
    run = f"  run {int(row['run'])}" if "run" in row else ""
    return (
        f"{int(row['generation']) + 1:4d}/{now.generations} generations{run}  "
        f"champion {row['champion']:8.4f}  best {row['best']:8.4f}  mean {row['mean']:8.4f}  "
        f"{row['seconds']:6.2f} s"
    )


def _newest(now: "Standing", draw: "Callable[[Champion, Standing], Any]") -> Path | None:
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
        self._replays: Replays | None = None

    def draw(self, champion: "Champion", now: "Standing") -> Path | None:
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

    def _make(self, champion: "Champion", now: "Standing") -> Path:
        from evo_cpg.cli.building import build
        from evo_cpg.live.replays import Replays
        from evo_cpg.training.checkpoint import history_columns
        from evo_cpg.view.watch_picture import watch_picture

        assert now.checkpoint is not None
        self._replays = self._replays or Replays(self._folder, build)
        experiment = self._replays.experiment
        return watch_picture(
            experiment,
            self._replays.champion(champion),
            history_columns(now.checkpoint.history),
            f"{experiment.name}: champion of generation {champion.generation} (the first is 0), "
            f"fitness {champion.fitness:.4f}",
            self._folder.path / PICTURE,
        )
