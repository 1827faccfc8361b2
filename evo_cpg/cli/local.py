"""`--local N`: start N processes of this command and wait for them."""

import contextlib
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence

from evo_cpg.training.devices import available_cores

# Interval between two checks of the processes, s.
_LOOK = 0.05

# Time that the other processes have to end after a failure or an interrupt, s.
_GRACE = 10.0

# A shell adds this to the number of the signal that ended a program.
_BY_SIGNAL = 128


def run_local(
    count: int,
    arguments: Sequence[str],
    cores: int | None,
) -> int:
    """Start the processes, and wait until they have ended.

    Args:
        count: number of processes.
        arguments: arguments of this command, without its name.
        cores: cores of all processes together, or None for all of this machine.

    Returns:
        The exit code of the lead if it failed, else of the first failed process, else 0.
    """
    own = max(1, (cores or available_cores()) // count)
    with socket.create_server(("", 0)) as server:
        port = server.getsockname()[1]
    hosts = ",".join([f"localhost:{port}", *["localhost"] * (count - 1)])
    common = [*_without_local(arguments), "--cores", str(own), "--hosts", hosts]
    command = [sys.executable, "-m", "evo_cpg", *common, "--process"]
    processes: list[subprocess.Popen] = []
    with _ended(processes):
        for index in range(count):
            # In its own process group, a process gets interrupts from this command only, and not
            # from the terminal, too.
            processes.append(
                subprocess.Popen([*command, str(index)], stdin=subprocess.DEVNULL, process_group=0)
            )
        while None in (codes := _codes(processes)) and not any(codes):
            time.sleep(_LOOK)
        _wait(processes)
    return _code([process.returncode for process in processes])


@contextlib.contextmanager
def _ended(processes: list[subprocess.Popen]) -> Iterator[None]:
    """End all processes after the block, and report which of them a signal had ended."""

    def stop(number: int, frame: object) -> None:
        del frame
        raise SystemExit(_BY_SIGNAL + number)

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    except KeyboardInterrupt:
        for process in processes:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
        _wait(processes)
        raise
    finally:
        signal.signal(signal.SIGTERM, before)
        for index, code in enumerate(_codes(processes)):
            if code is not None and code < 0:
                name = signal.Signals(-code).name
                print(f"evo-cpg: process {index} was ended by {name}", file=sys.stderr, flush=True)
        for process in processes:
            # Send SIGKILL: a stopped process reacts to no other signal.
            process.kill()
            process.wait()


def _wait(processes: Sequence[subprocess.Popen]) -> None:
    """Wait until all processes have ended, at most for `_GRACE`."""
    end = time.monotonic() + _GRACE
    while time.monotonic() < end and None in _codes(processes):
        time.sleep(_LOOK)


def _codes(processes: Sequence[subprocess.Popen]) -> list[int | None]:
    """Return the exit code of each process, or None for a running process."""
    return [process.poll() for process in processes]


def _code(codes: Sequence[int]) -> int:
    """Return the exit code of the lead if it failed, else of the first failed process, else 0."""
    ends = [code for code in codes if code > 0]
    if codes[0] > 0 or not ends:
        ends = [code for code in codes if code] or [0]
    return ends[0] if ends[0] >= 0 else _BY_SIGNAL - ends[0]


def _without_local(arguments: Sequence[str]) -> list[str]:
    """Return the arguments without ``--local N`` and ``--cores N``."""
    kept: list[str] = []
    words = iter(arguments)
    for word in words:
        if word in ("--local", "--cores"):
            next(words, None)
        elif not word.startswith(("--local=", "--cores=")):
            kept.append(word)
    return kept
