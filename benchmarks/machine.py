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
# Rows of the square matrices whose product is timed, and number of attempts. The matrices are large
# enough for the peak, and small enough for a tenth of a second.
_MATRIX, _ATTEMPTS = 1024, 8
# Interval between checks of the memory of child processes, s.
_LOOK_AGAIN = 0.02


def describe(cores: int, peak: float) -> dict[str, Any]:
    """Describe the machine, the time and the versions of a measurement.

    Args:
        cores: number of used cores.
        peak: result of `matrix_product_rate`, 1/s.
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
    """Return float32 operations per second of a matrix product on every device at once, 1/s.

    The best of several attempts counts, because it shows the limit of the machine.
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
    """Return the peak resident memory of this process, bytes.

    Linux's `ru_maxrss` starts with the parent's memory at the start of this process. The peak in
    /proc starts with this process.
    """
    peak = _peak_of("self")
    if peak is not None:
        return peak
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most if sys.platform == "darwin" else most * 1024


@contextlib.contextmanager
def monitored(*names: str) -> Iterator[dict[str, list[tuple[float, dict[str, Any]]]]]:
    """Yield the durations (s) and details of JAX's events of some names within the block."""
    found: dict[str, list[tuple[float, dict[str, Any]]]] = {name: [] for name in names}

    def note(event: str, duration_secs: float, **kwargs: str | int) -> None:
        if event in found:
            found[event].append((duration_secs, kwargs))

    jax.monitoring.register_event_duration_secs_listener(note)
    try:
        yield found
    finally:
        jax.monitoring.unregister_event_duration_listener(note)


@contextlib.contextmanager
def children_watched() -> Iterator[Callable[[], int | None]]:
    """Watch the processes that this one starts within the block.

    Yields:
        A function that returns the peak resident memory of the largest child, bytes, or None if it
        is unknown or there was no child.
    """
    peaks: dict[str, int] = {}
    own = _command_of("self")
    done = threading.Event()

    def watch() -> None:
        while not done.wait(_LOOK_AGAIN):
            for child in _children():
                # A child shows our command and memory until it runs its own program.
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
    """Return the process ids of the children that the system reports, or none."""
    found = []
    for file in Path("/proc/self/task").glob("*/children"):
        with contextlib.suppress(OSError):
            found += file.read_text().split()
    return found


def _command_of(process: str) -> bytes:
    """Return the command line of a process, empty if the system does not report it."""
    with contextlib.suppress(OSError):
        return Path(f"/proc/{process}/cmdline").read_bytes()
    return b""


def _peak_of(process: str) -> int | None:
    """Return the peak resident memory of a process, bytes, or None if it is not reported."""
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
