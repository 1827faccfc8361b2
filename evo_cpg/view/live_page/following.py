"""A run that a live page follows: one thread reads its folder, another replays its animals."""

import contextlib
import os
import threading
from collections.abc import Callable

import numpy as np

from evo_cpg.errors import UserError
from evo_cpg.io.trust import is_trusted, trusting
from evo_cpg.training.checkpoint import history_columns
from evo_cpg.training.run_folder import RunFolder
from evo_cpg.view.legible import UNITS, in_words
from evo_cpg.view.live_page.replaying import Answer, Numbered, Pace, Replaying
from evo_cpg.view.live_page.standing import Standing, duration, require_run, standing
from evo_cpg.view.plots import fitness_figure
from evo_cpg.view.run_page.charts import chart
from evo_cpg.view.run_page.html import number

# Interval between two checks of the folder, s, and between two pieces of replays, s.
_LOOK, _PAUSE = 1.0, 0.2
# Least time between two drawings of the curves, s.
_SELDOM = 3.0
# Niceness of the replays: the trainer has priority, but they go on if it keeps all cores busy.
_NICE = 10
# Largest number of the champion's terms that are shown.
_TERMS = 4
# Size of the curves, inches: their letters are legible on a phone.
_SIZE = (4.8, 3.4)
_CAPTION = "Fitness over the generations, and number of individuals that diverged or broke a rule."
_DELETED = "deleted", "The run folder was deleted. The page keeps what it shows"


class Following:
    """A run that a page follows.

    Args:
        folder: folder of the run, which may not exist yet.
        say: called with a line whenever the run begins, ends or is deleted.

    Raises:
        RunFolderError: the folder holds something else.
    """

    def __init__(self, folder: RunFolder, say: Callable[[str], object] = lambda words: None):
        # A run may begin where nothing is, or where the trainer prepares it.
        may_begin = not folder.path.exists()
        if folder.path.is_dir():
            names = (each.name for each in folder.path.iterdir())
            may_begin = all(name.startswith(".") or name == folder.start.name for name in names)
        if not may_begin:
            require_run(folder)
        self._folder, self._say = folder, say
        # Threads do not inherit it.
        self._trusted = is_trusted()
        self._ended = threading.Event()
        self._status = ("", "")
        self._numbers: list[tuple[str, str]] = []
        self._chart, self._drawing = Numbered(), Pace(_SELDOM)
        self._now: Standing | None = None
        self._drawn: Standing | None = None
        self._replaying = Replaying(folder)
        self.look()

    def start(self) -> None:
        """Follow the run in threads until `close`."""

        def follow() -> None:
            with trusting(self._trusted):
                while not self._ended.wait(_LOOK):
                    self.look()

        def replay() -> None:
            # On Linux it holds for this thread and the threads that it starts.
            if hasattr(os, "nice"):
                with contextlib.suppress(OSError):
                    os.nice(_NICE)
            with trusting(self._trusted):
                while not self._ended.wait(_PAUSE):
                    self.replay()

        for each in (follow, replay):
            threading.Thread(target=each, daemon=True).start()

    def close(self) -> None:
        """End the threads after their present work."""
        self._ended.set()

    def answer(self, chart: int, motion: int, wall: int, tiles: int) -> Answer:
        """Return the state of the run, and what is new on the page.

        Args:
            chart: number of the curves that the page shows, or 0.
            motion: number of the champion's motion that it shows, or 0.
            wall: number of the wall that it shows, or 0.
            tiles: number of individuals on this wall.
        """
        kind, words = self._status
        filled = self._replaying.wall
        found = filled.content.get("tiles", [])
        fresh = found[tiles:] if filled.number == wall else found
        return {
            "status": {"kind": kind, "words": words},
            "numbers": self._numbers,
            "chart": self._chart.since(chart),
            "motion": self._replaying.motion.since(motion),
            "wall": {**filled.content, "number": filled.number, "tiles": fresh} if fresh else None,
        }

    def look(self) -> None:
        """Read the folder once."""
        before, self._status = self._status, self._read()
        kind, words = self._status
        if kind != before[0]:
            self._say(f"{self._folder.path}: {words}")

    def replay(self) -> None:
        """Replay an animal, if one is due."""
        now = self._now
        if now is not None and now.checkpoint is not None:
            self._replaying.work(now.checkpoint, now.finished)

    def _read(self) -> tuple[str, str]:
        """Read the folder. Return the kind of its state, and a sentence about it."""
        now = None
        try:
            if self._folder.config.is_file():
                self._now = now = standing(self._folder, self._now)
        except (UserError, OSError) as error:
            # It may have been deleted meanwhile.
            if self._folder.config.is_file():
                return "wrong", str(error)
        if now is None:
            began, self._now = self._now is not None, None
            if began or self._status[0] == "deleted":
                return _DELETED
            return "waiting", "There is no run yet. The page waits for it"
        if now.checkpoint is None or not now.checkpoint.history:
            return "waiting", "No generation is finished yet"
        history, champion = now.checkpoint.history, now.checkpoint.champion
        rows = [row for row in history if row["generation"] == history[-1]["generation"]]
        # The most important numbers come first.
        found = [(f"{now.checkpoint.generation} of {now.generations}", "generations")]
        if champion is not None:
            found.append((number(champion.worth), "champion's fitness"))
            for name, value in list(champion.terms.items())[:_TERMS]:
                found.append((f"{number(value)} {UNITS.get(name, '')}".rstrip(), in_words(name)))
        found.append((number(np.mean([row["mean"] for row in rows])), "mean fitness"))
        found.append((f"{now.seconds:.3g} s", "per generation"))
        self._numbers = found
        if now is not self._drawn and (self._drawing.due or now.finished):
            self._drawn = now
            with self._drawing.working():
                figure = fitness_figure(history_columns(now.checkpoint.history))
                figure.set_size_inches(_SIZE)
                drawn = {"html": chart(figure, _CAPTION)}
                self._chart = Numbered(self._chart.number + 1, drawn)
        if now.finished:
            return "finished", "All generations are done. Control-C ends the program of this page"
        if not now.left:
            return "running", "All generations are done. The champion is being chosen"
        if now.quiet:
            return "running", f"No new generation for {now.quiet}"
        return "running", f"Evolving, about {duration(now.left * now.seconds)} to go"
