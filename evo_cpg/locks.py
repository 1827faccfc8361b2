"""Locks on folders: one process at a time changes the contents of a folder.

The lock belongs to an open file, so the system releases the lock when its process ends or is
killed. The file, ``.lock``, names the holder of the lock. The holder deletes the file when it
releases the lock. A file that a killed process left behind locks nothing.

On a file system without locks, a lock has no effect.
"""

import contextlib
import json
import os
import platform
import shlex
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from evo_cpg.errors import UserError
from evo_cpg.files import OutputError, cannot_write, make_folder

FILE = ".lock"
"""Name of the file, in the folder that it locks."""

# Largest number of characters of a command line that a message shows.
_LONGEST = 120
# Largest number of bytes of the lock file that are read.
_MOST = 1 << 14

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
    with contextlib.ExitStack() as stack:
        if make:
            stack.enter_context(_made(folder))
        descriptor = stack.enter_context(_taken(folder))
        _name_holder(descriptor)
        name = os.path.realpath(folder)
        _held.add(name)
        stack.callback(_held.discard, name)
        yield


def holds(folder: Path) -> bool:
    """Return whether this process has locked a folder."""
    return os.path.realpath(folder) in _held


@contextlib.contextmanager
def _made(folder: Path) -> Iterator[None]:
    # Unlike methods of Path, these functions raise no error for names that no folder can have.
    if os.path.exists(folder) and not os.path.isdir(folder):
        raise OutputError(f"{folder} is a file. Choose another --out")
    missing = [each for each in (folder, *folder.parents) if not os.path.exists(each)]
    make_folder(folder)
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            for each in missing:
                each.rmdir()


@contextlib.contextmanager
def _taken(folder: Path) -> Iterator[int]:
    """Open the lock file and lock it, and release the lock after the block."""
    path = folder / FILE
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
    try:
        yield descriptor
    finally:
        _release(descriptor, path)


def _open(path: Path) -> int:
    try:
        return os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        # A read-only file of another user can be locked nevertheless.
        with contextlib.suppress(OSError):
            return os.open(path, os.O_RDONLY)
        raise cannot_write(path.parent, error) from None


def _name_holder(descriptor: int) -> None:
    command = [Path(sys.argv[0]).name if sys.argv else "", *sys.argv[1:]]
    if command[0] == "__main__.py":
        command[0] = "evo-cpg"
    holder = {
        "process": os.getpid(),
        "host": platform.node(),
        "command": shlex.join(command)[:_LONGEST],
        "since": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
    }
    # The lock does not need the text, which a full disk cannot store.
    with contextlib.suppress(OSError):
        os.ftruncate(descriptor, 0)
        os.lseek(descriptor, 0, os.SEEK_SET)
        os.write(descriptor, json.dumps(holder).encode())


def _holder(descriptor: int) -> str:
    """Return a description of the holder of a lock."""
    try:
        os.lseek(descriptor, 0, os.SEEK_SET)
        holder = json.loads(os.read(descriptor, _MOST))
        words = (
            f"process {int(holder['process'])} on {holder['host']} (`{holder['command']}`, since "
            f"{holder['since']})"
        )
    except (KeyError, OSError, RecursionError, TypeError, ValueError):
        return "another process"
    # Other users can write the file, so limit the description to one line of moderate length.
    return "".join(each if each.isprintable() else "?" for each in words[: 3 * _LONGEST])


if sys.platform == "win32":
    import msvcrt

    # No process can read a locked byte, so this byte lies beyond the text.
    _PLACE = 1 << 20

    def _lock_alone(descriptor: int) -> bool:
        """Lock a file, or return False if another process has locked it."""
        os.lseek(descriptor, _PLACE, os.SEEK_SET)
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except PermissionError:
            return False
        except OSError:
            return True
        return True

    def _release(descriptor: int, path: Path) -> None:
        # Windows does not delete an open file.
        os.close(descriptor)
        with contextlib.suppress(OSError):
            path.unlink()

else:
    import fcntl

    def _lock_alone(descriptor: int) -> bool:
        """Lock a file, or return False if another process has locked it."""
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        except OSError:
            # The file system has no locks.
            return True
        return True

    def _release(descriptor: int, path: Path) -> None:
        # Delete the file while no other process can lock it.
        with contextlib.suppress(OSError):
            path.unlink()
        os.close(descriptor)
