"""What the operating system may not tell or give, and what stands for it then.

A process in a container or a job may have no home folder, no folder for temporary files, and no
working folder. The program goes on without what it does not need.
"""

import atexit
import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import IO


def home_folder() -> Path | None:
    """Return the user's home folder; None where the system knows none."""
    try:
        return Path.home()
    except RuntimeError:
        return None


def working_folder() -> Path | None:
    """Return the working folder; None where it was deleted."""
    try:
        return Path.cwd()
    except OSError:
        return None


def with_working_folder(folders: Iterable[Path]) -> list[Path]:
    """Return some folders, then the working folder where there is one."""
    here = working_folder()
    return [*folders, here] if here else [*folders]


def resolved(path: Path) -> Path:
    """Return a path without links and relative parts; the same where the system cannot tell."""
    try:
        return path.resolve()
    except (OSError, RuntimeError):
        # The working folder was deleted, or links go round in circles.
        return path


def named(text: str) -> Path:
    """Return the path that a text in a file names. Such names are UTF-8, whatever the locale."""
    try:
        return Path(os.fsdecode(text.encode("utf-8", "surrogateescape")))
    except UnicodeError:
        # No file can have this name, as whoever opens it finds.
        return Path(text)


def name_of(path: Path) -> str:
    """Return the text by which a file names a path; see `named`."""
    return os.fsencode(path).decode("utf-8", "surrogateescape")


def as_utf8(argument: str) -> str:
    """Return an argument of the command line with the UTF-8 in it read, whatever the locale."""
    return argument.encode("utf-8", "surrogateescape").decode("utf-8", "surrogateescape")


def is_writable(folder: Path) -> bool:
    """Return whether this process can make files in a folder."""
    return os.path.isdir(folder) and os.access(folder, os.W_OK | os.X_OK)


def scratch_file() -> IO[bytes]:
    """Open a temporary file; where none can be made, one that is always empty."""
    try:
        return tempfile.TemporaryFile()
    except OSError:
        return open(os.devnull, "r+b")


def lend_matplotlib_a_folder() -> None:
    """Let Matplotlib keep its files elsewhere if the home folder is missing or read-only.

    Matplotlib cannot be imported without a home folder. Call this before importing Matplotlib.
    """
    home = home_folder()
    if "MPLCONFIGDIR" in os.environ or (home is not None and is_writable(home)):
        return
    with contextlib.suppress(OSError):
        folder = tempfile.mkdtemp(prefix="evo_cpg_matplotlib_")
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        os.environ["MPLCONFIGDIR"] = folder


def described_by(file: Path) -> str:
    """Return what a file of the system says, such as those in ``/proc``; "" where it cannot."""
    try:
        return file.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
