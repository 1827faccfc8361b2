"""Access to folders, files and packages of the system that may be missing, with replacements.

A process in a container or a job may have no home folder, no folder for temporary files, and no
working folder. The program continues without the folders that it does not need.
"""

import atexit
import contextlib
import json
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
from urllib.parse import urlsplit
from urllib.request import url2pathname

_NAME = "evo-cpg"


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
    """Return the command that installs an extra, in a checkout as an editable installation.

    Args:
        extra: name of the extra in ``pyproject.toml``, such as ``mujoco``.
    """
    pip = f"{_quoted(_shown(sys.executable or 'python'))} -m pip install"
    # The source folder, if the installation is editable.
    checkout = None
    wrong = KeyError, OSError, TypeError, ValueError, metadata.PackageNotFoundError
    with contextlib.suppress(*wrong):
        origin = json.loads(metadata.distribution(_NAME).read_text("direct_url.json") or "")
        if origin["dir_info"]["editable"]:
            checkout = url2pathname(urlsplit(origin["url"]).path)
    if checkout is None:
        return f"{pip} {_quoted(f'{_NAME}[{extra}]')}"
    constraints = os.path.join(checkout, "constraints.txt")
    if os.path.isfile(constraints):
        pip += f" -c {_quoted(_shown(constraints))}"
    return f"{pip} -e {_quoted(f'{_shown(checkout)}[{extra}]')}"


def _quoted(word: str) -> str:
    """Return a word quoted for the shell of this system."""
    return f'"{word}"' if os.name == "nt" else shlex.quote(word)


def _shown(path: str) -> str:
    """Return a path, relative if it lies in the working folder."""
    here = working_folder()
    if here is None or not Path(path).is_relative_to(here):
        return path
    return str(Path(path).relative_to(here))
