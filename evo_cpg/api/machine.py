"""Fingerprint of the machine: processor, cores and versions, which affect the bits of a run."""

import platform
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax

from evo_cpg.installation import version_of
from evo_cpg.native.engine import Engine, EngineWarning, described
from evo_cpg.system import described_by

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
    """Return the fingerprint of a machine and its software, for meta.json."""
    return {
        "versions": {package: version_of(package) for package in _PACKAGES},
        "python": platform.python_version(),
        "machine": platform.machine(),
        "processor": _processor(),
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
        f"{words}: then {_short(then)}, here {_short(here)}"
        for words, then, here in pairs
        if then is not None and then != here
    ]


def _processor() -> str:
    """Return the processor's name and model numbers, or its kind if the name is unknown."""
    parts = [line.partition(":") for line in described_by(Path("/proc/cpuinfo")).splitlines()]
    found = {name.strip(): value.strip() for name, _, value in parts}
    name = found.get("model name") or platform.processor() or platform.machine()
    numbers = [found[key] for key in ("cpu family", "model", "stepping") if key in found]
    return f"{name} {'.'.join(numbers)}".strip()


def _short(value: Any) -> str:
    return str(value)[:80]
