"""Compiled programs kept on disk, so that the second start of the same experiment is quick.

What is compiled for one experiment is loaded again by every later command that needs the same
program: another seed, `resume`, `render` or `verify`. JAX keeps what XLA makes, and knows by a key
over program, options and version what fits; native code is kept beside it
(`evo_cpg.fusion.backend.machine`). Machine code made for one processor may not run on
another, so each kind of processor has a folder of its own: a cluster may share the home folder.

`JAX_COMPILATION_CACHE_DIR` names another folder, `JAX_ENABLE_COMPILATION_CACHE=false` keeps
nothing.
"""

import contextlib
import hashlib
import os
import platform
from pathlib import Path

import jax

from evo_cpg.fusion.backend.machine import keep_code_in
from evo_cpg.system import described_by, home_folder, is_writable

# The oldest programs go when all take up more than this, bytes. One is 1 to 4 MB.
_MOST = 1 << 30

# Programs that compile faster are not worth keeping, s.
_LEAST_SECONDS = 0.5


def keep_compiled_programs() -> Path | None:
    """Make JAX keep what it compiles; call it before JAX runs anything.

    Returns:
        The folder; None where none can be made, or the user has chosen one.
    """
    jax.config.update("jax_persistent_cache_min_compile_time_secs", _LEAST_SECONDS)
    if not jax.config.values["jax_enable_compilation_cache"]:
        return None
    folder = compiled_folder()
    if folder is None:
        return None
    if jax.config.values["jax_compilation_cache_dir"]:
        keep_code_in(folder)
        return None
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _prune(folder, _MOST)
    except OSError:
        return None
    # Otherwise JAX would warn of each program that it cannot keep.
    if not is_writable(folder):
        return None
    jax.config.update("jax_compilation_cache_dir", str(folder))
    keep_code_in(folder)
    return folder


def compiled_folder() -> Path | None:
    """Return the folder for compiled programs, there or not; None without a home folder."""
    own = jax.config.values["jax_compilation_cache_dir"]
    if own:
        return Path(own)
    home = home_folder()
    cache = os.environ.get("XDG_CACHE_HOME") or (home and home / ".cache")
    return Path(cache) / "evo_cpg" / "compiled" / _processor() if cache else None


def _processor() -> str:
    """A short name for the kind of processor, the same for all that run the same machine code."""
    kind = [platform.system(), platform.machine(), platform.processor()]
    lines = described_by(Path("/proc/cpuinfo")).splitlines()
    kind += sorted({line for line in lines if line.startswith(("flags", "Features", "model"))})
    return hashlib.sha256("\n".join(kind).encode()).hexdigest()[:16]


def _prune(folder: Path, most: int) -> None:
    """Delete the files that were written first until the rest take up no more than ``most``."""
    found = []
    for file in folder.iterdir():
        # Another process may have renamed or deleted it meanwhile.
        with contextlib.suppress(FileNotFoundError):
            found.append((file, file.stat()))
    total = 0
    for file, text in sorted(found, key=lambda pair: pair[1].st_mtime, reverse=True):
        total += text.st_size
        if total > most:
            file.unlink(missing_ok=True)
