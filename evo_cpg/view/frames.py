"""The frames of a film, a still or a sheet: which instants they show, and how they are laid out.

Frames are rendered larger than the film and averaged down by ffmpeg, which smooths edges, thin
lines and text.
"""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from evo_cpg.view.captions import heading
from evo_cpg.view.clip import Clip, sample
from evo_cpg.view.offscreen import canvas
from evo_cpg.view.output import GUTTER, SettingError, oversampling
from evo_cpg.view.panel import Panel
from evo_cpg.view.signals import LOWEST, SHARE, Strip
from evo_cpg.view.stage import Stage, seen_world, set_scene

# Pixels rendered per pixel of the result, a side. On one core of a software renderer a frame of
# 1280 x 720 costs 46 ms at 1.25, 58 ms at 1.5, which looks hardly better, and 100 ms at 2.
_FILM_OVERSAMPLING = 1.25
_STILL_OVERSAMPLING = 3.0
# On a sheet of several animals: the heading of a moment, and what sets moments apart, pixels.
_HEAD, _GAP = 40, 24
# Columns of so many animals side by side; of more the square root, rounded up.
_COLUMNS = (1, 1, 2, 3, 2)


class Plan(NamedTuple):
    """What is to be drawn; another process can be told of it.

    Attributes:
        panels: the animals, row by row.
        size: width and height of each animal's picture, pixels.
        fps: frames per second of the film.
        seconds: recorded time to show, s; all of it if None. Of a still: the instant it shows, the
            middle if None.
        speed: recorded seconds per second of film.
        camera: one of `evo_cpg.view.camera.CAMERAS`.
        still: one instant.
        sheet: columns and rows of moments; None for a film or a still.
        columns: of animals; None for as many as rows, or one more, and for one on a sheet.
    """

    panels: tuple[Panel, ...]
    size: tuple[int, int]
    fps: float
    seconds: float | None
    speed: float
    camera: str
    still: bool
    sheet: tuple[int, int] | None
    columns: int | None


class Frames:
    """Frames, laid out and ready to be drawn in any order.

    Args:
        plan: what they show.

    Raises:
        SettingError: a sheet of more moments than the film has frames.

    Attributes:
        count: how many there are.
        size: width and height of the result, pixels.
        rendered: width and height of what is drawn, pixels.
        gap: between the moments of a sheet, pixels.
    """

    def __init__(self, plan: Plan):
        self._plan = plan
        rate, sheet = plan.fps / plan.speed, plan.sheet
        end = None if plan.still else plan.seconds
        self._clips = [sample(one.recording, plan.fps, plan.speed, end) for one in plan.panels]
        self._instants = [_instants(clip, plan.seconds, plan.still, sheet) for clip in self._clips]
        self.count = max(map(len, self._instants))
        still = plan.still or sheet is not None
        wanted = _STILL_OVERSAMPLING if still else _FILM_OVERSAMPLING
        self._scale = scale = oversampling(plan.size, wanted)
        self._one = width, height = plan.size[0] // 2 * 2, plan.size[1] // 2 * 2
        # Of several animals a sheet has a column for each moment, with a heading.
        self._grouped = sheet is not None and len(plan.panels) > 1
        self._columns, self._rows = _grid(
            len(plan.panels), 1 if self._grouped and plan.columns is None else plan.columns
        )
        head = _HEAD if self._grouped else 0
        self.size = (
            self._columns * (width + GUTTER) - GUTTER,
            self._rows * (height + GUTTER) - GUTTER + head,
        )
        self._head = round(head * scale)
        self._pitch = round((width + GUTTER) * scale), round((height + GUTTER) * scale)
        self.rendered = (
            (self._columns - 1) * self._pitch[0] + round(width * scale),
            (self._rows - 1) * self._pitch[1] + round(height * scale) + self._head,
        )
        self.gap = _GAP if self._grouped else GUTTER
        self._rate = rate

    @contextlib.contextmanager
    def drawn(self) -> Iterator[Callable[[int], np.ndarray]]:
        """Set the scenes.

        Yields:
            A function of a frame's number that draws it: ``(height, width, 3)`` bytes, bottom row
            first. What it returns may be overwritten by the next one.
        """
        # Filled where an animal is shown.
        picture = np.full((self.rendered[1], self.rendered[0], 3), 255, np.uint8)
        with contextlib.ExitStack() as stack:
            shows = [
                stack.enter_context(self._panel(panel, clip))
                for panel, clip in zip(self._plan.panels, self._clips, strict=True)
            ]

            def draw(number: int) -> np.ndarray:
                if self._grouped:
                    picture[-self._head :] = heading(
                        self._moment(number), self.rendered[0], self._head
                    )
                for i, (show, own) in enumerate(zip(shows, self._instants, strict=True)):
                    seen = show(own[min(number, len(own) - 1)])
                    if len(shows) == 1:
                        return seen
                    # The bottom row comes first.
                    below = (self._rows - 1 - i // self._columns) * self._pitch[1]
                    left = i % self._columns * self._pitch[0]
                    picture[below : below + len(seen), left : left + seen.shape[1]] = seen
                return picture

            yield draw

    def _moment(self, number: int) -> str:
        instants = {
            f"{clip.time[own[number]] - clip.time[0]:.1f} s"
            for clip, own in zip(self._clips, self._instants, strict=True)
        }
        # Recordings of different length have moments of their own.
        return instants.pop() if len(instants) == 1 else f"moment {number + 1}"

    @contextlib.contextmanager
    def _panel(self, panel: Panel, clip: Clip) -> Iterator[Callable[[int], np.ndarray]]:
        """An animal's picture, instant by instant: ``(height, width, 3)``, bottom row first."""
        creature, size, scale = panel.creature, self._one, self._scale
        look, surface = seen_world(creature, clip, panel.world, panel.ground, panel.surface)
        rendered = round(size[0] * scale), round(size[1] * scale)
        strip, above = None, size[1]
        if panel.signals is not None:
            above = size[1] - max(round(SHARE * size[1]), LOWEST)
            strip = Strip(panel.signals, look, (size[0], size[1] - above), scale)
        stage = Stage(
            look=look,
            title=creature.name if panel.title is None else panel.title,
            size=(size[0], above),
            oversampling=scale,
            rate=self._rate,
            speed=self._plan.speed,
            ground=panel.ground,
            surface=surface,
            camera=self._plan.camera,
            note=panel.note,
        )
        high = rendered[1] if strip is None else rendered[1] - strip.height
        with canvas((rendered[0], high)) as plotter:
            show = set_scene(plotter, creature, panel.recording, clip, stage)

            def draw(instant: int) -> np.ndarray:
                seen = show(instant)
                if strip is None:
                    return seen
                return np.concatenate([strip.at(clip.time[instant]), seen])

            yield draw


def _instants(
    clip: Clip, seconds: float | None, still: bool, sheet: tuple[int, int] | None
) -> Sequence[int]:
    """The frames of a clip that are shown: all, that of an instant, or those of a sheet."""
    if still:
        instant = np.median(clip.time) if seconds is None else clip.time[0] + seconds
        return [int(np.abs(clip.time - instant).argmin())]
    return range(len(clip.time)) if sheet is None else _moments(len(clip.time), sheet)


def _moments(frames: int, sheet: tuple[int, int]) -> list[int]:
    """The frames that a sheet of so many columns and rows shows."""
    columns, rows = sheet
    if min(sheet) < 1:
        raise SettingError(f"sheet is {columns}x{rows}; it needs a column and a row at least")
    if frames < columns * rows:
        raise SettingError(
            f"the film has {frames} frames, fewer than a sheet of {columns}x{rows} shows; "
            "more frames per second or fewer moments would do"
        )
    return np.linspace(0, frames - 1, columns * rows).round().astype(int).tolist()


def _grid(count: int, columns: int | None) -> tuple[int, int]:
    """Columns and rows of so many pictures."""
    if columns is None:
        columns = _COLUMNS[count] if count < len(_COLUMNS) else int(np.ceil(np.sqrt(count)))
    return columns, -(-count // columns)
