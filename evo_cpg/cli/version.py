"""Which program this is."""

import subprocess
from importlib import metadata
from pathlib import Path

import evo_cpg


def version() -> str:
    """Name and version and, in a checkout, the commit."""
    words = f"evo-cpg {metadata.version('evo-cpg')}"
    commit = _commit(Path(evo_cpg.__file__).parents[1])
    return f"{words} ({commit})" if commit else words


def _commit(checkout: Path) -> str | None:
    """Short name of a checkout's commit, with "-dirty" where files were changed since.

    None where it is no checkout, or there is no git.
    """
    # An installed package may lie in a folder that is somebody else's checkout.
    if not (checkout / ".git").exists():
        return None
    command = ["git", "-C", str(checkout), "describe", "--always", "--dirty", "--exclude", "*"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip() or None
