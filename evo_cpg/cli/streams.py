"""Standard output and error streams that never end a command.

If a disk is full or a pipe is closed, output is lost and the work continues. Characters that the
locale lacks are escaped.
"""

import codecs
import contextlib
import errno
import io
import os
import sys
from typing import TextIO

_ESCAPE = "evo_cpg.escape"


class _Raw(io.FileIO):
    """Descriptor that keeps the first write error and raises none.

    Attributes:
        error: first write error, or None before.
    """

    error: OSError | None = None

    def write(self, data, /) -> int:
        try:
            return super().write(data)
        except OSError as error:
            self.error = self.error or error
            return memoryview(data).nbytes


def protect() -> None:
    """Replace the standard output and error of this process by streams that never raise."""
    for descriptor in (0, 1, 2):
        _occupy(descriptor)
    for name, descriptor in (("stdout", 1), ("stderr", 2)):
        before = getattr(sys, name)
        with contextlib.suppress(OSError, AttributeError):
            before.flush()
        setattr(sys, name, opened(descriptor, before))


def opened(descriptor: int, like: TextIO | None) -> TextIO:
    """Open a descriptor for text, as a stream that never raises.

    Args:
        descriptor: descriptor to write to.
        like: stream to replace, for its encoding, or None if the stream was closed.
    """
    # If PYTHONUNBUFFERED is set, Python's streams are not buffered. Buffer them by line here.
    by_line = getattr(like, "line_buffering", True) or getattr(like, "write_through", False)
    return io.TextIOWrapper(
        io.BufferedWriter(_Raw(descriptor, "wb", closefd=False)),
        encoding=getattr(like, "encoding", None) or "utf-8",
        errors=_ESCAPE,
        line_buffering=by_line,
    )


def output_error() -> OSError | None:
    """Return the write error of standard output, or None without an error, or for a closed pipe."""
    error = _error()
    return None if error is None or error.errno == errno.EPIPE else error


def is_read() -> bool:
    """Return whether standard output may still have a reader. Only a write detects a loss."""
    error = _error()
    return error is None or error.errno != errno.EPIPE


def _error() -> OSError | None:
    sys.stdout.flush()
    raw = getattr(getattr(sys.stdout, "buffer", None), "raw", None)
    return raw.error if isinstance(raw, _Raw) else None


def _occupy(descriptor: int) -> None:
    """Open the null device at the number of a closed stream.

    Otherwise a file of ours could get the number, and libraries that print to it would write into
    the file.
    """
    try:
        os.fstat(descriptor)
    except OSError:
        null = os.open(os.devnull, os.O_RDWR)
        if null != descriptor:
            os.dup2(null, descriptor)
            os.close(null)
        os.set_inheritable(descriptor, True)


def _escape(error: UnicodeError) -> tuple[str | bytes, int]:
    """Encode a character that the encoding lacks. Bytes of file names stay, others are escaped."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    code = ord(error.object[error.start])
    if 0xDC80 <= code <= 0xDCFF:
        return bytes([code - 0xDC00]), error.start + 1
    character = error.object[error.start]
    return character.encode("ascii", "backslashreplace").decode(), error.start + 1


codecs.register_error(_ESCAPE, _escape)
