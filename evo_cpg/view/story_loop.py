"""A loop for a web page: parts of a story that dissolve into each other, in a small file."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np

from evo_cpg.view.legible import lettering
from evo_cpg.view.look import Look
from evo_cpg.view.output import film_writer, picture_of
from evo_cpg.view.story import DISSOLVE, FPS, blended, smoothly
from evo_cpg.view.story_text import Words, written

# Qualities of a loop, from the best one.
_QUALITIES = (75, 60, 48, 36)


class LoopPart(NamedTuple):
    """Part of a story that a loop shows.

    Attributes:
        first: first frame.
        end: frame after the last one. The part dissolves into the next one before it.
        words: texts of the part, with times of the film.
    """

    first: int
    end: int
    words: Sequence[Words]


class Loop:
    """A short loop of parts of a story, each of which dissolves into the next one.

    It begins with the first frame of the first part. The last part dissolves into this frame, so
    the first part should begin with a picture that stands still.

    Args:
        parts: the parts.
        look_at: function that returns the look of the world at a time of the film, s.
        size: width and height, pixels.
        file: empty scratch file for frames.
        every: frames of the film for each frame of the loop.
    """

    def __init__(
        self,
        parts: Sequence[LoopPart],
        look_at: Callable[[float], Look],
        size: tuple[int, int],
        file: IO[bytes],
        every: int = 2,
    ):
        self._parts, self._look_at, self._size = parts, look_at, size
        self._file, self._every = file, every
        self._shared = round(DISSOLVE * FPS / every)
        self._numbers: dict[int, int] = {}

    def take(self, number: int, frame: np.ndarray) -> None:
        """Keep a frame of the film if the loop shows it."""
        if any(number in self._shown(part) for part in self._parts):
            self._numbers[number] = len(self._numbers)
            self._file.seek(0, 2)
            self._file.write(picture_of(frame, self._size).tobytes())

    def write(self, path: Path, largest: int) -> int:
        """Write the loop as ``.webp``, in the best quality within a size of the file.

        Args:
            path: path of the file.
            largest: largest size, bytes. If even the lowest quality is larger, it is written.

        Returns:
            The quality, from 0 to 100.
        """
        for quality in _QUALITIES:
            with film_writer(path, self._size, self._size, FPS / self._every, quality) as write:
                for frame in self.frames():
                    write(frame)
            if path.stat().st_size <= largest:
                break
        return quality

    def frames(self) -> Iterator[np.ndarray]:
        """Return the frames with all dissolves and words, bottom row first."""
        shared, last = self._shared, len(self._parts) - 1
        for i, part in enumerate(self._parts):
            count, after = len(self._shown(part)), self._parts[(i + 1) % (last + 1)]
            for j in range(shared if i else 0, count):
                frame = self._worded(part, j)
                if (k := j - (count - shared)) >= 0:
                    # The last part turns into a picture that stands still.
                    then = self._worded(after, k if i < last else 0)
                    frame = blended(frame, then, smoothly((k + 1) / (shared + 1)))
                yield frame

    def _worded(self, part: LoopPart, number: int) -> np.ndarray:
        """Return a frame of a part with its words, by its number in the part."""
        shown = self._shown(part)[number]
        frame, time = np.ascontiguousarray(self._kept(shown)[::-1]), shown / FPS
        with lettering(frame) as draw:
            for words in part.words:
                written(draw, words, time, self._look_at(time), self._size)
        return frame

    def _shown(self, part: LoopPart) -> range:
        return range(part.first, part.end, self._every)

    def _kept(self, number: int) -> np.ndarray:
        width, height = self._size
        self._file.seek(self._numbers[number] * width * height * 3)
        pixels = np.frombuffer(self._file.read(width * height * 3), np.uint8)
        return pixels.reshape(height, width, 3)
