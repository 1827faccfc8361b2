"""State of a run, read from the files that the trainer writes after every generation."""

import contextlib
import time
from typing import NamedTuple

import numpy as np

from evo_cpg.io.load import load_config
from evo_cpg.training.checkpoint import Checkpoint
from evo_cpg.training.run_folder import RunFolder, RunFolderError

# A run without a new generation for this time, s, and for this number of usual generations, is
# said to be quiet.
_QUIET_SECONDS, _QUIET_GENERATIONS = 60.0, 10
# Number of the last rows whose median is the usual time of a generation.
_ROWS = 20


class Standing(NamedTuple):
    """State of a run.

    Attributes:
        checkpoint: newest checkpoint, or None before the first generation is done.
        generations: requested number of generations in all.
        choosing: whether the champion is chosen with fresh noise after the last generation.
        changed: time of the last change to metrics.csv, s since the epoch, or None if unknown.
    """

    checkpoint: Checkpoint | None
    generations: int
    choosing: bool
    changed: float | None

    @property
    def finished(self) -> bool:
        """Return whether all generations are done and the champion is chosen."""
        if self.checkpoint is None or self.checkpoint.generation < self.generations:
            return False
        return not self.choosing or bool(self.checkpoint.chosen)

    @property
    def left(self) -> int:
        """Number of generations that are not done yet."""
        return self.generations - (self.checkpoint.generation if self.checkpoint else 0)

    @property
    def seconds(self) -> float:
        """Usual time of a generation, s. There must be one."""
        assert self.checkpoint is not None
        return float(np.median([row["seconds"] for row in self.checkpoint.history[-_ROWS:]]))

    @property
    def quiet(self) -> str | None:
        """Time since the last generation, in words, if it is unusually long. Otherwise None."""
        if self.changed is None or not self.left:
            return None
        since = time.time() - self.changed
        usual = max(_QUIET_SECONDS, _QUIET_GENERATIONS * self.seconds)
        return duration(since) if since > usual else None


def standing(folder: RunFolder, before: Standing | None = None) -> Standing:
    """Return the state of a run, or ``before`` if nothing is new."""
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
    # The configuration is read each time, because `resume` may change it.
    config = load_config(folder.config)
    return Standing(checkpoint, config.evolution.generations, not config.silent, changed)


def require_run(folder: RunFolder) -> None:
    """Check that a folder holds a run, and change nothing in it.

    `RunFolder.require` would finish interrupted writes, which only the trainer may do.

    Raises:
        RunFolderError: there is no run.
    """
    if folder.config.is_file():
        return
    within = ""
    with contextlib.suppress(OSError):
        runs = sorted(each.parent for each in folder.path.glob("*/config.yaml"))
        within = f". It holds runs, such as {runs[0]}" if runs else ""
    raise RunFolderError(f"{folder.path} is not a run folder (it has no config.yaml){within}")


def duration(seconds: float) -> str:
    """Return a time in words."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    if seconds < 6000:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"
