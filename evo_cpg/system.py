"""Access to folders, files and packages of the system that may be missing, with replacements.

A process in a container or a job may have no home folder, no folder for temporary files, and no
working folder. The program continues without the folders that it does not need.
"""

import atexit
import contextlib
import os
import re
import shlex
import shutil
import sys
import tempfile
import textwrap
from importlib import metadata
from pathlib import Path
from typing import IO


def home_folder() -> Path | None:
    """Return the user's home folder, or None if the system has none."""
    try:
        return Path.home()
    except RuntimeError:
        return None


def working_folder() -> Path | None:
    """Return the working folder, or None if it was deleted."""
    try:
        return Path.cwd()
    except OSError:
        return None


def resolved(path: Path) -> Path:
    """Return a path without links and relative parts, or unchanged if it cannot be resolved."""
    try:
        return path.resolve()
    except (OSError, RuntimeError):
        # The working folder was deleted, or links go round in circles.
        return path


def is_writable(folder: Path) -> bool:
    """Return whether this process can make files in a folder."""
    return os.path.isdir(folder) and os.access(folder, os.W_OK | os.X_OK)


def scratch_file() -> IO[bytes]:
    """Open a temporary file, or the null device if no file can be made."""
    try:
        return tempfile.TemporaryFile()
    except OSError:
        return open(os.devnull, "r+b")


def lend_matplotlib_a_folder() -> None:
    """Set a temporary folder for Matplotlib if the home folder is missing or read-only.

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
    """Return the text of a system file, such as one in ``/proc``, or "" if it cannot be read."""
    try:
        return file.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def folded(words: str, stream: IO[str]) -> str:
    """Return text whose lines end between words if a stream is a terminal, else the same text.

    Commands in backticks stay on one line.
    """
    if stream is None or not stream.isatty():
        return words
    width = shutil.get_terminal_size().columns
    # A space that `textwrap` does not break.
    glued = re.sub(r"`[^`]*`", lambda command: command[0].replace(" ", "\0"), words)
    lines = (
        textwrap.wrap(line, width, break_long_words=False, break_on_hyphens=False) or [""]
        if len(line) > width
        else [line]
        for line in glued.split("\n")
    )
    return "\n".join(part for line in lines for part in line).replace("\0", " ")


def version_of(package: str) -> str:
    """Return the version of a package, or "unknown" if it has no metadata."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "unknown"


def command_for(extra: str) -> str:
    """Return the command that installs an extra of ``pyproject.toml``, such as ``mujoco``."""
    # An editable installation stays editable, because pip adds the extra to what is installed.
    return f"{shlex.quote(sys.executable or 'python')} -m pip install 'evo-cpg[{extra}]'"
