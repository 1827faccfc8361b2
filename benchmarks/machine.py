"""The machine: its processor, its float32 peak, and the memory of a process."""

import contextlib
import datetime
import os
import platform
import resource
import sys
import threading
from collections.abc import Callable, Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from benchmarks.timing import seconds

_PACKAGES = ("jax", "jaxlib", "numpy", "mujoco", "mujoco-mjx", "brax", "evosax")
# Rows of the square matrices whose product is timed, and how often: large enough for the peak,
# small enough for a tenth of a second.
_MATRIX, _ATTEMPTS = 1024, 8
# How often the memory of other processes is looked at, s.
_LOOK_AGAIN = 0.02


def describe(cores: int, peak: float) -> dict[str, Any]:
    """Where, when and with which versions was measured.

    Args:
        cores: that were used.
        peak: of `matrix_product_rate`, 1/s.
    """
    return {
        "processor": _processor(),
        "cores": cores,
        "float32_peak": peak,
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "python": platform.python_version(),
        "versions": {name: _version(name) for name in _PACKAGES},
    }


def matrix_product_rate() -> float:
    """Float32 operations per second of a matrix product on every device at once, 1/s.

    The best of several: it stands for what the machine can do, as a yardstick for the rest.
    """
    one = jnp.ones((_MATRIX, _MATRIX), jnp.float32)
    matrices = [jax.device_put(one, device) for device in jax.devices()]
    product = jax.jit(jnp.matmul)

    def all_at_once() -> None:
        jax.block_until_ready([product(matrix, matrix) for matrix in matrices])

    all_at_once()
    best = min(seconds(all_at_once) for _ in range(_ATTEMPTS))
    return len(matrices) * 2 * _MATRIX**3 / best


def peak_memory() -> int:
    """Most memory that this process ever held at once, bytes.

    Linux's `ru_maxrss` starts with what the parent held when it started this process; the peak in
    /proc starts anew.
    """
    peak = _peak_of("self")
    if peak is not None:
        return peak
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most if sys.platform == "darwin" else most * 1024


@contextlib.contextmanager
def children_watched() -> Iterator[Callable[[], int | None]]:
    """Watch the processes that this one starts within the block.

    Yields:
        A function that returns the peak resident memory of the largest of them, bytes; None where
        the system does not tell, or there was none.
    """
    peaks: dict[str, int] = {}
    own = _command_of("self")
    done = threading.Event()

    def watch() -> None:
        while not done.wait(_LOOK_AGAIN):
            for child in _children():
                # Until a child has its own program, its command and its memory are ours.
                if _command_of(child) != own:
                    peaks[child] = _peak_of(child) or peaks.get(child, 0)

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield lambda: max([*peaks.values()], default=0) or None
    finally:
        done.set()
        thread.join()


def _children() -> list[str]:
    """Return the numbers of the processes that this one has started, where the system tells."""
    found = []
    for file in Path("/proc/self/task").glob("*/children"):
        with contextlib.suppress(OSError):
            found += file.read_text().split()
    return found


def _command_of(process: str) -> bytes:
    """Return the command line of a process; empty where the system does not tell."""
    with contextlib.suppress(OSError):
        return Path(f"/proc/{process}/cmdline").read_bytes()
    return b""


def _peak_of(process: str) -> int | None:
    """Return the peak resident memory of a process, bytes; None where the system does not tell."""
    with contextlib.suppress(OSError):
        for line in Path(f"/proc/{process}/status").read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    return None


def _processor() -> str:
    if os.path.exists("/proc/cpuinfo"):
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            for line in file:
                if line.startswith("model name"):
                    return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None
