"""Which program this is."""

import platform
import warnings
from importlib import metadata

from evo_cpg.api.commit import commit


def version() -> str:
    """Version and, in a checkout, commit; then what results depend on: Python, JAX, the engine."""
    words, made_by = f"evo-cpg {metadata.version('evo-cpg')}", commit()
    return "\n".join(
        [
            f"{words} ({made_by})" if made_by else words,
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
