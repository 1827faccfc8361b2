"""Disk cache of compiled programs, so that an experiment starts quickly the second time.

Every later command that needs an already compiled program loads it: `train` with another seed,
`resume`, `render` or `verify`. JAX keeps XLA's programs under a key of program, options and
version. Native code is kept next to them (`evo_cpg.native.backend.machine`). Machine code for one
processor may not run on another. A cluster may share the home folder, so each kind of processor has
a folder of its own.

`JAX_COMPILATION_CACHE_DIR` names another folder. `JAX_ENABLE_COMPILATION_CACHE=false` switches
the cache off.
"""

import contextlib
import hashlib
import os
import platform
from pathlib import Path

import jax

from evo_cpg.native.backend.machine import keep_code_in
from evo_cpg.system import described_by, home_folder, is_writable

# Largest size of the cache, bytes. The oldest programs are deleted. A program has 1 to 4 MB.
_MOST = 1 << 30

# Programs that compile faster are not kept, s.
_LEAST_SECONDS = 0.5


def keep_compiled_programs() -> Path | None:
    """Make JAX keep compiled programs. Call this before JAX runs anything.

    Returns:
        The folder, or None if none can be made, the cache is off, or the user has chosen one.
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
    # In a read-only folder JAX would warn about each program.
    if not is_writable(folder):
        return None
    jax.config.update("jax_compilation_cache_dir", str(folder))
    keep_code_in(folder)
    return folder


def compiled_folder() -> Path | None:
    """Return the folder for compiled programs, which may not exist yet. None without a home."""
    own = jax.config.values["jax_compilation_cache_dir"]
    if own:
        return Path(own)
    home = home_folder()
    cache = os.environ.get("XDG_CACHE_HOME") or (home and home / ".cache")
    return Path(cache) / "evo_cpg" / "compiled" / _processor() if cache else None


def _processor() -> str:
    """Return a short name of the kind of processor, equal for compatible processors."""
    kind = [platform.system(), platform.machine(), platform.processor()]
    lines = described_by(Path("/proc/cpuinfo")).splitlines()
    kind += sorted({line for line in lines if line.startswith(("flags", "Features", "model"))})
    return hashlib.sha256("\n".join(kind).encode()).hexdigest()[:16]


def _prune(folder: Path, most: int) -> None:
    """Delete the oldest files until the rest take up at most ``most`` bytes."""
    found = []
    for file in folder.iterdir():
        # Another process may have renamed or deleted the file.
        with contextlib.suppress(FileNotFoundError):
            found.append((file, file.stat()))
    total = 0
    for file, status in sorted(found, key=lambda pair: pair[1].st_mtime, reverse=True):
        total += status.st_size
        if total > most:
            file.unlink(missing_ok=True)
