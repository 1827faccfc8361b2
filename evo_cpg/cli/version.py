"""Which program this is."""

import platform
import subprocess
import warnings
from importlib import metadata
from pathlib import Path

import evo_cpg


def version() -> str:
    """Version and, in a checkout, commit; then what results depend on: Python, JAX, the engine."""
    words = f"evo-cpg {metadata.version('evo-cpg')}"
    commit = _commit(Path(evo_cpg.__file__).parents[1])
    return "\n".join(
        [
            f"{words} ({commit})" if commit else words,
            f"Python {platform.python_version()} on {platform.system()} {platform.machine()}",
            f"JAX {metadata.version('jax')}",
            f"engine: {_engine()}",
        ]
    )


def _engine() -> str:
    """What computes trials on this machine, and why where it is the slower."""
    from evo_cpg.fusion.engine import Engine, described

    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        found = described(Engine())
    if found["engine"] == "native":
        return f"native code, {found['instructions']}, LLVM {found['llvm']}"
    return "; ".join(["plain JAX", *(str(warning.message) for warning in told)])


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
