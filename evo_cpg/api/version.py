"""Version of this program, and commit of its checkout."""

import os
import platform
import subprocess
import warnings
from collections.abc import Sequence
from pathlib import Path

import evo_cpg
from evo_cpg.installation import version_of


def version() -> str:
    """Return the program's version and commit, and the versions of Python, JAX and the engine."""
    words, made_by = f"evo-cpg {version_of('evo-cpg')}", commit()
    return "\n".join(
        [
            f"{words} ({made_by})" if made_by else words,
            f"Python {platform.python_version()} on {platform.system()} {platform.machine()}",
            f"JAX {version_of('jax')}",
            f"engine: {_engine()}",
        ]
    )


def checkout() -> Path | None:
    """Return the folder of this program's checkout, or None if it was installed."""
    folder = Path(evo_cpg.__file__).parents[1]
    # Look only in this folder: an installed package may lie deeper in a checkout of another
    # project.
    return folder if os.path.exists(folder / ".git") else None


def commit() -> str | None:
    """Return the commit of this program's checkout, see `commit_of`."""
    folder = checkout()
    return folder and commit_of(folder)


def program_commit() -> str | None:
    """Return `commit`. "-dirty" means changes of the program, configurations or benchmarks only."""
    folder = checkout()
    return folder and commit_of(folder, ("evo_cpg", "configs", "benchmarks", "pyproject.toml"))


def commit_of(folder: Path, paths: Sequence[str] = (".",)) -> str | None:
    """Return the short name of a checkout's commit, with "-dirty" if files have changed.

    Return None if the folder is no checkout or git is missing.

    Args:
        folder: folder of the checkout.
        paths: paths in the checkout whose changes count.
    """
    if not os.path.exists(folder / ".git"):
        return None
    try:
        name = _git(folder, "rev-parse", "--short", "HEAD")
        changed = _git(folder, "status", "--porcelain", "--untracked-files=no", "--", *paths)
    except (OSError, subprocess.CalledProcessError):
        return None
    return f"{name}-dirty" if changed else name


def _engine() -> str:
    """Return the engine of this machine, with the reason if it is plain JAX, the slower one."""
    from evo_cpg.native.engine import Engine, described

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            found = described(Engine())
        except (AssertionError, RuntimeError):
            # JAX 0.10 raises these errors if it finds no device of the requested platform.
            platforms = os.environ.get("JAX_PLATFORMS", "")
            return f"none: JAX finds no device for JAX_PLATFORMS={platforms}"
    if found["engine"] == "native":
        return f"native code, {found['instructions']}, LLVM {found['llvm']}"
    return "; ".join(["plain JAX", *(str(warning.message) for warning in caught)])


def _git(folder: Path, *arguments: str) -> str:
    command = ["git", "-C", str(folder), *arguments]
    done = subprocess.run(command, capture_output=True, check=True)
    return done.stdout.decode(errors="replace").strip()
