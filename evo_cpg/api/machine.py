"""Versions of this program, commit of its checkout, and fingerprint of the machine.

Processor, cores and versions affect the bits of a run.
"""

import os
import platform
import subprocess
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax

import evo_cpg
from evo_cpg.native.engine import Engine, EngineWarning, described
from evo_cpg.system import described_by, version_of

_PACKAGES = ("evo-cpg", "jax", "jaxlib", "equinox", "numpy")

# Names of the fingerprint's keys that affect rounding.
_ROUNDING = {
    "devices": "cores",
    "processor": "processor",
    "machine": "kind of machine",
    "engine": "engine",
    "instructions": "instruction set",
    "llvm": "LLVM",
}
_ROUNDING_PACKAGES = ("jax", "jaxlib", "numpy", "evo-cpg")


def version() -> str:
    """Return the program's version and commit, and the versions of Python, JAX and the engine.

    An engine of plain JAX, the slower one, has its reason beside it.
    """
    folder, words = checkout(), f"evo-cpg {version_of('evo-cpg')}"
    made_by = folder and commit_of(folder)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            found = described(Engine())
        except (AssertionError, RuntimeError):
            # JAX 0.10 raises these errors if it finds no device of the requested platform.
            platforms = os.environ.get("JAX_PLATFORMS", "")
            engine = f"none: JAX finds no device for JAX_PLATFORMS={platforms}"
        else:
            engine = "; ".join(["plain JAX", *(str(warning.message) for warning in caught)])
            if found["engine"] == "native":
                engine = f"native code, {found['instructions']}, LLVM {found['llvm']}"
    return "\n".join(
        [
            f"{words} ({made_by})" if made_by else words,
            f"Python {platform.python_version()} on {platform.system()} {platform.machine()}",
            f"JAX {version_of('jax')}",
            f"engine: {engine}",
        ]
    )


def checkout() -> Path | None:
    """Return the folder of this program's checkout, or None if it was installed."""
    folder = Path(evo_cpg.__file__).parents[1]
    # Look only in this folder: an installed package may lie deeper in a checkout of another
    # project.
    return folder if os.path.exists(folder / ".git") else None


def program_commit() -> str | None:
    """Return this program's commit.

    "-dirty" means changes of the program, configurations or benchmarks only.
    """
    folder = checkout()
    return folder and commit_of(folder, ("evo_cpg", "configs", "benchmarks", "pyproject.toml"))


def commit_of(folder: Path, paths: Sequence[str] = (".",)) -> str | None:
    """Return the short name of a checkout's commit, with "-dirty" if files in `paths` have changed.

    Return None if the folder is no checkout or git is missing.
    """
    if not os.path.exists(folder / ".git"):
        return None

    def git(*arguments: str) -> str:
        command = ["git", "-C", str(folder), *arguments]
        done = subprocess.run(command, capture_output=True, check=True)
        return done.stdout.decode(errors="replace").strip()

    try:
        name = git("rev-parse", "--short", "HEAD")
        changed = git("status", "--porcelain", "--untracked-files=no", "--", *paths)
    except (OSError, subprocess.CalledProcessError):
        return None
    return f"{name}-dirty" if changed else name


def warn_of_gpu() -> None:
    """Warn if JAX does not run on the processor, where native code is faster. This starts JAX."""
    if (backend := jax.default_backend()) != "cpu":
        warnings.warn(
            f"JAX runs on {backend}, so plain JAX computes everything. Native code on the CPU is "
            "faster: set the environment variable JAX_PLATFORMS=cpu before you import JAX",
            EngineWarning,
            stacklevel=2,
        )


def machine_fingerprint(engine: Engine, devices: int) -> dict[str, Any]:
    """Return the fingerprint of a machine and its software, for meta.json.

    The processor is its name with its model numbers, or its kind if the name is unknown.
    """
    parts = [line.partition(":") for line in described_by(Path("/proc/cpuinfo")).splitlines()]
    found = {name.strip(): value.strip() for name, _, value in parts}
    name = found.get("model name") or platform.processor() or platform.machine()
    numbers = [found[key] for key in ("cpu family", "model", "stepping") if key in found]
    return {
        "versions": {package: version_of(package) for package in _PACKAGES},
        "python": platform.python_version(),
        "machine": platform.machine(),
        "processor": f"{name} {'.'.join(numbers)}".strip(),
        "system": platform.platform(),
        "devices": devices,
    } | described(engine)


def machine_changes(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Return descriptions of the machine's changes that affect bits.

    Args:
        before: fingerprint from meta.json. Missing keys count as unchanged.
        now: `machine_fingerprint` of this machine.
    """
    pairs = [(words, before.get(key), now.get(key)) for key, words in _ROUNDING.items()]
    old = before.get("versions")
    if isinstance(old, dict):
        pairs += [(name, old.get(name), now["versions"][name]) for name in _ROUNDING_PACKAGES]
    return [
        f"{words}: then {str(then)[:80]}, here {str(here)[:80]}"
        for words, then, here in pairs
        if then is not None and then != here
    ]
