"""Check output paths of pictures and films before any work, and write the files whole."""

import contextlib
import os
import re
import subprocess
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import IO, cast

import imageio_ffmpeg
import numpy as np
from PIL import Image

from evo_cpg.errors import UserError
from evo_cpg.files import OutputError, beside, cannot_write, in_one_piece, require_place
from evo_cpg.system import scratch_file

# A palette for each frame. For one common palette, ffmpeg would hold the whole film in memory.
_GIF_PALETTE = "split[a][b];[a]palettegen=stats_mode=single[p];[b][p]paletteuse=new=1:dither=bayer"
_ENCODERS = {
    # Dark gradients show bands above a rate factor of 20. "veryfast" takes a third of the time
    # of "medium", and the files are about a tenth larger.
    ".mp4": "-c:v libx264 -pix_fmt yuv420p -crf 19 -preset veryfast -movflags +faststart",
    ".webp": "-c:v libwebp_anim -pix_fmt yuv420p -quality 60 -compression_level 5 -loop 0",
    ".gif": "-c:v gif -loop 0",
}
PICTURE_SUFFIXES = (".png",)
FILM_SUFFIXES = (*_ENCODERS, *PICTURE_SUFFIXES)
PLOT_SUFFIXES = (".png", ".svg", ".pdf")
# Smallest and largest side of a picture, and largest drawn side (the limit of software renderers),
# pixels. Most drawn pixels in all, for which VTK takes some 3 GB of memory.
_SMALLEST, _LARGEST, _LARGEST_DRAWN, _MOST_DRAWN = 16, 8192, 16384, 2**26


class SettingError(UserError, ValueError):
    """A size, a speed or a number of moments that a picture or film cannot have."""


def check_size(
    size: tuple[int, int], smallest: tuple[int, int] = (_SMALLEST, _SMALLEST), what: str = ""
) -> None:
    """Check that a picture can be drawn.

    Args:
        size: width and height, pixels.
        smallest: smallest width and height, pixels.
        what: reason for the smallest size, for the message.

    Raises:
        SettingError: the picture is too small, or too large.
    """
    width, height = size
    if width < smallest[0] or height < smallest[1]:
        limit = f"smallest{what} is {smallest[0]} x {smallest[1]}"
    elif max(size) > _LARGEST:
        limit = f"largest is {_LARGEST} x {_LARGEST}"
    else:
        return
    raise SettingError(f"size is {width} x {height} pixels, but the {limit}")


def oversampling(size: tuple[int, int], desired: float) -> float:
    """Return pixels drawn per pixel of a picture, along a side, within the drawable size.

    Args:
        size: width and height of the picture, pixels, as `check_size` allows them.
        desired: desired oversampling, at least 1.
    """
    width, height = size
    most = min(_LARGEST_DRAWN / max(size), (_MOST_DRAWN / (width * height)) ** 0.5)
    return min(desired, most)


def output_path(path: str | os.PathLike[str], suffixes: Sequence[str]) -> Path:
    """Return a path to which a file with one of some suffixes can be written, or replaced.

    Raises:
        OutputError: another suffix, a folder that does not exist, a folder in the file's place,
            or no permission.
    """
    path = Path(path)
    if path.suffix.lower() not in suffixes:
        named = f"ends in {path.suffix!r}" if path.suffix else "has no suffix"
        known = " or ".join(filter(None, (", ".join(suffixes[:-1]), suffixes[-1])))
        raise OutputError(f"cannot write {path}: the name {named}. Use {known}")
    return require_place(path)


def is_numbered(path: Path) -> bool:
    """Return whether a name such as ``%04d.png`` requests a picture of every frame."""
    return re.fullmatch(r"[^%]*%(0\d)?d[^%]*\.png", path.name, re.IGNORECASE) is not None


def picture_of(frame: np.ndarray, size: tuple[int, int]) -> Image.Image:
    """Return a picture of this width and height, averaged from the bytes of a frame.

    The frame is ``(height, width, 3)``, bottom row first as in OpenGL.
    """
    return Image.fromarray(frame[::-1]).resize(size, Image.Resampling.BOX)


def save_numbered(pictures: Iterable[Image.Image], path: Path) -> None:
    """Write pictures to files with numbers, all of them or none.

    Args:
        pictures: pictures, counted from 0.
        path: path such as ``frames/%04d.png``, checked by
            `evo_cpg.view.film.film_path`. The folder is new or empty.

    Raises:
        OutputError: the pictures cannot be written, for instance because the disk is full.
    """
    folder = path.parent.absolute()
    try:
        with beside(folder, folder=True) as kept:
            partial = kept / "frames"
            partial.mkdir()
            for number, picture in enumerate(pictures):
                picture.save(partial / (path.name % number))
            if folder.is_dir():
                folder.rmdir()
            os.rename(partial, folder)
    except OSError as error:
        raise cannot_write(path, error) from None


@contextlib.contextmanager
def film_writer(
    path: Path, size: tuple[int, int], rendered: tuple[int, int], fps: float
) -> Iterator[Callable[[np.ndarray], object]]:
    """Write frames to a film: H.264, WebP or GIF.

    Args:
        path: path checked by `output_path`. Its suffix decides the kind.
        size: width and height of the film, pixels. Even numbers for ``.mp4``.
        rendered: width and height of the frames, pixels. ffmpeg averages them down to ``size``.
        fps: frames per second.

    Yields:
        A function that takes one frame ``(height, width, 3)`` of bytes, bottom row first as
        OpenGL returns it.

    Raises:
        OutputError: ffmpeg failed, for instance because the disk is full.
    """
    suffix = path.suffix.lower()
    filters = f"vflip,scale={size[0]}:{size[1]}:flags=area"
    if suffix == ".gif":
        filters = f"{filters},{_GIF_PALETTE}"
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-y"]
    command += ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{rendered[0]}x{rendered[1]}"]
    command += ["-r", f"{fps:.6f}", "-i", "-", "-vf", filters, *_ENCODERS[suffix].split()]
    with in_one_piece(path) as partial, scratch_file() as complaints:
        # ffmpeg takes a relative path with a colon for a protocol.
        process = subprocess.Popen(
            [*command, str(partial.absolute())], stdin=subprocess.PIPE, stderr=complaints
        )
        try:
            with contextlib.suppress(BrokenPipeError), cast(IO[bytes], process.stdin) as pipe:
                yield lambda frame: pipe.write(frame.data)
        except BaseException:
            process.kill()
            raise
        finally:
            code = process.wait()
        if code != 0 or not partial.stat().st_size:
            complaints.seek(0)
            said = complaints.read().decode(errors="replace").split()
            reason = " ".join(said) or f"code {code}"
            raise OutputError(f"cannot write {path}: ffmpeg failed: {reason}")
