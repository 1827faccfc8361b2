"""Locks on folders: one process at a time changes the contents of a folder.

The lock belongs to an open file, so the system releases the lock when its process ends or is
killed. The file, ``.lock``, names the holder of the lock. The holder deletes the file when it
releases the lock. A file that a killed process left behind locks nothing.

On a file system without locks, a lock has no effect.
"""

import contextlib
import os
import platform
import shlex
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from evo_cpg.errors import UserError
from evo_cpg.files import OutputError, cannot_write, make_folder

# Error of a lock that another process has.
if sys.platform == "win32":
    import msvcrt

    _TAKEN = PermissionError
else:
    import fcntl

    _TAKEN = BlockingIOError

FILE = ".lock"
"""Name of the file, in the folder that it locks."""

# Largest number of characters of a command line that a message shows.
_LONGEST = 120
# Byte that Windows locks. No process can read a locked byte, so it lies beyond the text.
_PLACE = 1 << 20

# Folders that this process has locked, by their real paths.
_held: set[str] = set()


class LockedError(UserError):
    """Another process has locked a folder. The message names the process."""


@contextlib.contextmanager
def locked(folder: Path, make: bool = False) -> Iterator[None]:
    """Lock a folder against other processes during the ``with`` block.

    Args:
        folder: folder to lock.
        make: make a missing folder, and remove it after the block if it is empty.

    Raises:
        LockedError: another process holds the lock.
        OutputError: the folder cannot be written.
    """
    missing: list[Path] = []
    if make:
        # Unlike methods of Path, these functions raise no error for names that no folder can have.
        if os.path.exists(folder) and not os.path.isdir(folder):
            raise OutputError(f"{folder} is a file. Choose another --out")
        missing = [each for each in (folder, *folder.parents) if not os.path.exists(each)]
        make_folder(folder)
    path = folder / FILE
    try:
        while True:
            descriptor = _open(path)
            if not _lock_alone(descriptor):
                holder = _holder(descriptor)
                os.close(descriptor)
                raise LockedError(
                    f"{folder} is in use by {holder}. Wait until that process ends, or end it"
                )
            # The previous holder may have deleted the file meanwhile.
            with contextlib.suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(descriptor), os.stat(path)):
                    break
            os.close(descriptor)
        name = os.path.realpath(folder)
        try:
            command = [Path(sys.argv[0]).name if sys.argv else "", *sys.argv[1:]]
            if command[0] == "__main__.py":
                command[0] = "evo-cpg"
            since = time.strftime("%Y-%m-%dT%H:%M:%S%z")
            words = f"(`{shlex.join(command)[:_LONGEST]}`, since {since})"
            own = f"process {os.getpid()} on {platform.node()} {words}"
            # The lock does not need the text, which a full disk cannot store.
            with contextlib.suppress(OSError):
                os.ftruncate(descriptor, 0)
                os.lseek(descriptor, 0, os.SEEK_SET)
                os.write(descriptor, own.encode(errors="backslashreplace"))
            _held.add(name)
            yield
        finally:
            _held.discard(name)
            # Windows does not delete an open file. Elsewhere, delete the file while no other
            # process can lock it.
            if sys.platform == "win32":
                os.close(descriptor)
            with contextlib.suppress(OSError):
                path.unlink()
            if sys.platform != "win32":
                os.close(descriptor)
    finally:
        with contextlib.suppress(OSError):
            for each in missing:
                each.rmdir()


def holds(folder: Path) -> bool:
    """Return whether this process has locked a folder."""
    return os.path.realpath(folder) in _held


def _open(path: Path) -> int:
    try:
        return os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        # A read-only file of another user can be locked nevertheless.
        with contextlib.suppress(OSError):
            return os.open(path, os.O_RDONLY)
        raise cannot_write(path.parent, error) from None


def _holder(descriptor: int) -> str:
    """Return a description of the holder of a lock, as it wrote it into the file."""
    words = b""
    with contextlib.suppress(OSError):
        os.lseek(descriptor, 0, os.SEEK_SET)
        words = os.read(descriptor, 3 * _LONGEST)
    # Other users can write the file, so limit the description to one line of moderate length.
    shown = (each if each.isprintable() else "?" for each in words.decode(errors="replace"))
    return "".join(shown) or "another process"


def _lock_alone(descriptor: int) -> bool:
    """Lock a file, or return False if another process has locked it."""
    try:
        if sys.platform == "win32":
            os.lseek(descriptor, _PLACE, os.SEEK_SET)
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except _TAKEN:
        return False
    except OSError:
        # The file system has no locks.
        return True
    return True
