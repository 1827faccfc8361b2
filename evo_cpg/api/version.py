"""Which program this is."""

import os
import platform
import warnings

from evo_cpg.api.commit import commit
from evo_cpg.installation import version_of


def version() -> str:
    """Version and, in a checkout, commit; then what results depend on: Python, JAX, the engine."""
    words, made_by = f"evo-cpg {version_of('evo-cpg')}", commit()
    return "\n".join(
        [
            f"{words} ({made_by})" if made_by else words,
            f"Python {platform.python_version()} on {platform.system()} {platform.machine()}",
            f"JAX {version_of('jax')}",
            f"engine: {_engine()}",
        ]
    )


def _engine() -> str:
    """What computes trials on this machine, and why where it is the slower."""
    from evo_cpg.fusion.engine import Engine, described

    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            found = described(Engine())
        except (AssertionError, RuntimeError):
            # What JAX 0.10 raises where it has no such device.
            wanted = os.environ.get("JAX_PLATFORMS", "")
            return f"none: JAX finds no device for JAX_PLATFORMS={wanted}"
    if found["engine"] == "native":
        return f"native code, {found['instructions']}, LLVM {found['llvm']}"
    return "; ".join(["plain JAX", *(str(warning.message) for warning in told)])
