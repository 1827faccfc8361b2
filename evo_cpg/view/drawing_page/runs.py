"""Motions of the drawn animal: a try of some seconds, and a run of evolution in a process."""

import contextlib
import csv
import itertools
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from evo_cpg.analysis.laboratory.ask import Subject, ask
from evo_cpg.creature.creature import length_of
from evo_cpg.errors import UserError
from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import complete_config, load_config
from evo_cpg.io.trust import is_trusted
from evo_cpg.simulation.recording import Recording
from evo_cpg.training.devices import use_cores
from evo_cpg.training.run_folder import RunFolder
from evo_cpg.view.drawing_page.document import Data, EditError
from evo_cpg.view.drawing_page.swim import RATE, STEPS, Swim, swim
from evo_cpg.view.run_page.viewer_data import packed
from evo_cpg.view.scene import quaternions, sample

How = Literal["rest", "drive"]

# Duration of a try, s. A swim takes longer (`STEPS`).
SECONDS = 5.0
_SHORT = 32767
# Knobs of the laboratory: without motors, or with the largest drive of the cord.
_KNOBS: dict[str, dict[str, list[Any]]] = {"rest": {"passive": ["*"]}, "drive": {"u": [1.0]}}
# Sections that a try needs. Other sections may not fit its controller, which has a rhythm.
_SECTIONS = ("name", "creature", "world", "simulation", "engine")


# Columns of metrics.csv that the page draws.
_CURVES = ("generation", "best", "mean")
# Time that a process gets to end, s.
_PATIENCE = 10.0
# Time in which the live page must start, s.
_START = 120.0
# Number of characters of its output that are shown.
_SHOWN = 2000


def simulate(data: Data, source: Path, how: How) -> dict[str, Any]:
    """Simulate an animal, and return its motion as JSON.

    It is at ``rest`` without motors. On ``drive``, the newborn brain moves it to a light. On the
    ground, its spinal cord gets a constant drive instead.

    Raises:
        UserError: the animal is wrong, or cannot be driven.
    """
    if how not in _KNOBS:
        raise EditError(f"{how!r}: choose rest or drive")
    given = {key: data[key] for key in _SECTIONS if key in data}
    world, controller, task = (data.get(key) for key in ("world", "controller", "task"))
    on_ground = isinstance(world, dict) and world.get("ground") is not None
    swims = how == "drive" and not on_ground
    if swims:
        given |= {"controller": {"type": "body_brain"}, "simulation": STEPS}
        if isinstance(task, dict) and task.get("type", "reach_light") == "reach_light":
            given["task"] = task
    elif isinstance(controller, dict) and controller.get("type", "brain_cpg") == "brain_cpg":
        given["controller"] = controller
    config = complete_config(given, source)
    if len(config.creature.copies()) < 2:
        raise EditError("a body without joints has nothing to try. Add a part first")
    use_cores()
    if swims:
        parts = build_experiment(config, source)
        moved = swim(parts.simulation, float(length_of(parts.creature)))
    else:
        (moved,) = ask(Subject(config, source), _KNOBS[how], SECONDS).recordings
    if not np.isfinite(moved.position).all():
        raise EditError("the motion diverged: a motor may be too strong for its body")
    if isinstance(moved, Swim):
        return packed_motion(moved.names, moved.position, moved.rotation) | {"light": moved.light}
    return motion(moved, [body.name for body in config.creature.build().bodies])


def motion(recording: Recording, names: Sequence[str]) -> dict[str, Any]:
    """Return a recording of named bodies as JSON."""
    clip = sample(recording, RATE)
    return packed_motion(names, clip.position, clip.rotation)


def packed_motion(
    names: Sequence[str],
    position: Float[np.ndarray, "t b 3"],
    rotation: Float[np.ndarray, "t b 3 3"],
) -> dict[str, Any]:
    """Return positions (m) and rotations of named bodies, `RATE` frames per second, as JSON."""
    return {
        "rate": RATE,
        "count": len(position),
        "names": list(names),
        "place": packed(position, "<f4"),
        "turn": packed(quaternions(rotation) * _SHORT, "<i2"),
    }


class TrainingRun:
    """A process of `evo-cpg train`.

    Args:
        config: file of the configuration, which is saved.
        name: name of the run.
        generations: number of generations, or None for the configuration's number.
    """

    def __init__(self, config: Path, name: str, generations: int | None = None):
        folders = itertools.chain([name], (f"{name}_{i}" for i in itertools.count(2)))
        places = (config.parent / "runs" / folder for folder in folders)
        self.folder = next(place for place in places if not place.exists())
        command = ["train", str(config), "--out", str(self.folder)]
        if generations is not None:
            command.append(f"evolution.generations={generations}")
        self._is_stopping = False
        self._scratch = tempfile.TemporaryDirectory()
        self._output = Path(self._scratch.name) / "output.txt"
        self._watch_output = Path(self._scratch.name) / "watch.txt"
        self._process = _started(command, self._output)
        self._watching: subprocess.Popen | None = None

    @property
    def is_running(self) -> bool:
        """Whether the process still runs."""
        return self._process.poll() is None

    def state(self) -> dict[str, Any]:
        """Return the progress of the run, as JSON."""
        try:
            words = self._output.read_text(encoding="utf-8", errors="replace")
        except OSError:  # The run was closed at this moment.
            words = ""
        rows: list[dict[str, str]] = []
        metrics = self.folder / "metrics.csv"
        with contextlib.suppress(OSError), metrics.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        curves: dict[str, list[float]] = {name: [] for name in _CURVES if rows and name in rows[0]}
        for name, values in curves.items():
            for row in rows:
                # The trainer may not have written the last cell yet.
                with contextlib.suppress(TypeError, ValueError):
                    values.append(float(row[name]))
        return {
            "folder": str(self.folder),
            "running": self.is_running,
            "stopping": self._is_stopping,
            "code": self._process.poll(),
            "output": words[-_SHOWN:].strip(),
            "curves": curves,
        }

    def champion(self) -> dict[str, Any]:
        """Return the motion of the champion, as JSON.

        Raises:
            EditError: there is no champion yet.
        """
        try:
            _, recording, _ = RunFolder(self.folder).load_champion()
            config = load_config(RunFolder(self.folder).config)
        except UserError as error:
            raise EditError(f"there is no champion yet ({error})") from None
        if recording is None:
            raise EditError(
                "the run ended before the motion of its champion was recorded. "
                f"`evo-cpg resume {self.folder}` goes on"
            )
        return motion(recording, [body.name for body in config.creature.build().bodies])

    def watch(self) -> None:
        """Start `evo-cpg watch --page` for the run, if it does not serve the page yet."""
        if self._watching is None or self._watching.poll() is not None:
            self._watching = _started(["watch", str(self.folder), "--page"], self._watch_output)

    def live_page(self) -> str:
        """Wait until `watch` serves the page, and return its address.

        Raises:
            EditError: the program did not start.
        """
        until = time.monotonic() + _START
        words = ""
        with contextlib.suppress(OSError):  # The run may be closed meanwhile.
            while time.monotonic() < until and self._watching and self._watching.poll() is None:
                words = self._watch_output.read_text(encoding="utf-8", errors="replace")
                for line in words.splitlines(True):
                    if line.startswith("http://") and line.endswith("\n"):
                        return line.strip()
                time.sleep(0.1)
            words = self._watch_output.read_text(encoding="utf-8", errors="replace")
        why = f": {words[-_SHOWN:].strip()}" if words.strip() else ""
        raise EditError(f"the live page did not start{why}")

    def stop(self) -> None:
        """Interrupt the process as Control-C does, which keeps its generations.

        The process ends after the generation that it computes. It is killed if it takes longer.
        """
        if self.is_running and not self._is_stopping:
            self._is_stopping = True
            _release(self._process)
            threading.Thread(target=self._end, daemon=True).start()

    def close(self) -> None:
        """Stop the process and its live page, wait for their ends, and delete their output."""
        self.stop()
        self._end()
        if self._watching is not None:
            self._watching.kill()
            self._watching.wait()
            _release(self._watching)
        self._scratch.cleanup()

    def _end(self) -> None:
        """Wait for the end of the process, and kill it after some time."""
        _release(self._process)
        try:
            self._process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def _release(process: subprocess.Popen) -> None:
    """Close the input of a process, which then interrupts itself (`tethered`)."""
    if process.stdin is not None:
        process.stdin.close()


def _started(arguments: list[str], output: Path) -> subprocess.Popen:
    """Start `evo-cpg`, which ends with this program, and write its output to a file.

    A file object of our own would share its position with the process that writes.
    """
    trust = ["--trust"] if is_trusted() else []
    command = [sys.executable, "-m", "evo_cpg.view.drawing_page.tethered", *trust, *arguments]
    with output.open("wb") as file:
        return subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=file, stderr=subprocess.STDOUT
        )
