"""`evo-cpg watch`: follow a run while it evolves.

It reads what the trainer writes after every generation, and requests nothing of the trainer. It
writes one file to the run folder, the picture of the newest champion, at the lowest priority.
"""

import contextlib
import math
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from evo_cpg.cli.errors import told, warn
from evo_cpg.cli.options import Run
from evo_cpg.cli.streams import is_read

if TYPE_CHECKING:
    from rich.console import Console

    from evo_cpg.training.checkpoint import Champion, Checkpoint
    from evo_cpg.training.run_folder import RunFolder

PICTURE = "watch.png"
# Between two looks at the folder, s.
LOOK = 1.0
# A picture is made at most so often, s, and takes at most this share of the time.
_SELDOM, _SHARE = 10.0, 0.2
# The trainer has the first claim on the cores.
_NICE = 15


class Standing(NamedTuple):
    """How a run stands.

    Attributes:
        checkpoint: the newest; None before the first generation is done.
        generations: that are wanted in all.
        choosing: whether the champion is chosen in fresh draws of chance when they are done.
        changed: when the checkpoint was written, s since the epoch; None without one.
    """

    checkpoint: "Checkpoint | None"
    generations: int
    choosing: bool
    changed: float | None

    @property
    def finished(self) -> bool:
        """Whether all generations are done, and the champion known."""
        if self.checkpoint is None or self.checkpoint.generation < self.generations:
            return False
        return not self.choosing or bool(self.checkpoint.chosen)


def watch(
    run: Run,
    once: Annotated[bool, typer.Option("--once", help="Look once, then exit.")] = False,
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
    # `require` would put in order what was interrupted, which is for the trainer to do.
    if not folder.config.is_file():
        raise RunFolderError(f"{run} is not a run folder (it has no config.yaml)")
    give_way()
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


def give_way() -> None:
    """Let everybody else have the cores first, the trainer above all.

    Where the system knows work for idle cores only, it is that; being nice still takes a share.
    """
    if hasattr(os, "nice"):
        with contextlib.suppress(OSError):
            os.nice(max(0, _NICE - os.nice(0)))
    if hasattr(os, "SCHED_IDLE"):
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))


def standing(folder: "RunFolder", before: Standing | None = None) -> Standing:
    """How the run stands; what was read before where nothing is new.

    Args:
        folder: of the run.
        before: the last that was seen.
    """
    done = folder.newest
    if before is not None and before.checkpoint:
        same = before.checkpoint.generation == done
        # Of the last generation comes a second checkpoint, which knows who was chosen.
        if same and (done < before.generations or before.finished):
            return before
    # The trainer may take a checkpoint away while it is read, and then there is a newer one.
    checkpoint = folder.load()
    changed = None
    if checkpoint is not None:
        with contextlib.suppress(OSError):
            changed = folder.metrics.stat().st_mtime
    return Standing(checkpoint, *_plan(folder), changed)


def _plan(folder: "RunFolder") -> tuple[int, bool]:
    """Generations, as the configuration has them (`resume` writes it anew); is there chance?"""
    from evo_cpg.config.load import load_config

    config = load_config(folder.config)
    return config.evolution.generations, not config.noise.silent


def _in_lines(
    folder: "RunFolder", console: "Console", draw: "Callable[[Champion, Standing], Any]", once: bool
) -> None:
    """Elsewhere than on a terminal: a line for every generation."""
    seen: Standing | None = None
    told = 0
    while True:
        now = standing(folder, seen)
        if now is not seen or once:
            history = now.checkpoint.history if now.checkpoint else []
            for row in [row for row in history if row["generation"] >= told]:
                print(_line(row, now), flush=True)
            if history:
                told = int(history[-1]["generation"]) + 1
            elif once:
                print(f"{folder.path}: not one generation is finished", flush=True)
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
    """Pictures of champions, one after the other, not too often.

    Args:
        folder: of the run.
    """

    def __init__(self, folder: "RunFolder"):
        self._folder = folder
        self._drawn: tuple[float, ...] | None = None
        self._next = -math.inf
        self._built: Any = None

    def draw(self, champion: "Champion", now: Standing) -> Path | None:
        """Draw a champion that was not drawn before, if it is time; the picture's path."""
        which = (champion.run, champion.generation, champion.fitness)
        began = time.monotonic()
        if which == self._drawn or (began < self._next and not now.finished):
            return None
        self._drawn = which
        try:
            made = self._make(champion, now)
        except OSError as error:
            # Who looks on may have no permission to write there.
            warn(f"no picture: {told(error)}")
            self._next = math.inf
            return None
        took = time.monotonic() - began
        self._next = time.monotonic() + max(_SELDOM, took / _SHARE)
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
        """The experiment and its compiled replay, on one core."""
        from evo_cpg.api.load import class_folders
        from evo_cpg.cli.building import build
        from evo_cpg.config.load import load_config
        from evo_cpg.training.devices import use_cores
        from evo_cpg.training.replay import compile_replay

        use_cores(1)
        config = load_config(self._folder.config)
        experiment = build(config, self._folder.config, class_folders(self._folder))
        devices = self._folder.read_meta().get("devices", 1)
        return experiment, compile_replay(experiment, devices)
