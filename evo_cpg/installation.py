"""Installed versions of packages, and the command that installs an extra."""

import json
import os
import shlex
import sys
from importlib import metadata
from pathlib import Path
from urllib.parse import urlsplit
from urllib.request import url2pathname

from evo_cpg.system import working_folder

_NAME = "evo-cpg"


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
    checkout = _editable()
    if checkout is None:
        return f"{pip} {_quoted(f'{_NAME}[{extra}]')}"
    constraints = os.path.join(checkout, "constraints.txt")
    if os.path.isfile(constraints):
        pip += f" -c {_quoted(_shown(constraints))}"
    return f"{pip} -e {_quoted(f'{_shown(checkout)}[{extra}]')}"


def _editable() -> str | None:
    """Return the source folder of an editable installation, or None for another installation."""
    try:
        text = metadata.distribution(_NAME).read_text("direct_url.json") or ""
        origin = json.loads(text)
        if origin["dir_info"]["editable"]:
            return url2pathname(urlsplit(origin["url"]).path)
    except (KeyError, OSError, TypeError, ValueError, metadata.PackageNotFoundError):
        pass
    return None


def _quoted(word: str) -> str:
    """Return a word quoted for the shell of this system."""
    return f'"{word}"' if os.name == "nt" else shlex.quote(word)


def _shown(path: str) -> str:
    """Return a path, relative if it lies in the working folder."""
    here = working_folder()
    if here is None or not Path(path).is_relative_to(here):
        return path
    return str(Path(path).relative_to(here))
