"""Standard output and error that never end a command.

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
    """A descriptor that keeps the first error of a write, and raises none.

    Attributes:
        error: the first; None before.
    """

    error: OSError | None = None

    def write(self, data, /) -> int:
        try:
            return super().write(data)
        except OSError as error:
            self.error = self.error or error
            return memoryview(data).nbytes


def protect() -> None:
    """Replace the standard streams of this process by such that never raise."""
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
        descriptor: to write to.
        like: the stream that it replaces, for its encoding; None if that was closed.
    """
    # Python makes standard error unbuffered rather than line-buffered if PYTHONUNBUFFERED is set.
    by_line = getattr(like, "line_buffering", True) or getattr(like, "write_through", False)
    return io.TextIOWrapper(
        io.BufferedWriter(_Raw(descriptor, "wb", closefd=False)),
        encoding=getattr(like, "encoding", None) or "utf-8",
        errors=_ESCAPE,
        line_buffering=by_line,
    )


def output_error() -> OSError | None:
    """Return why standard output was lost; None if it was not, or if its reader has left."""
    error = _error()
    return None if error is None or error.errno == errno.EPIPE else error


def is_read() -> bool:
    """Return whether standard output may still have a reader; only writing shows it."""
    error = _error()
    return error is None or error.errno != errno.EPIPE


def _error() -> OSError | None:
    sys.stdout.flush()
    raw = getattr(getattr(sys.stdout, "buffer", None), "raw", None)
    return raw.error if isinstance(raw, _Raw) else None


def _occupy(descriptor: int) -> None:
    """Make sure that no file of ours gets the number of a stream that was closed.

    Libraries print to these numbers, which would write into the file.
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
    """Write a byte of a file's name as it is, and escape other characters."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    code = ord(error.object[error.start])
    if 0xDC80 <= code <= 0xDCFF:
        return bytes([code - 0xDC00]), error.start + 1
    character = error.object[error.start]
    return character.encode("ascii", "backslashreplace").decode(), error.start + 1


codecs.register_error(_ESCAPE, _escape)
