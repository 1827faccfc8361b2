"""Run LLVM in a separate process, so that a crash of the compiler does not end the run.

The process starts with the first program whose machine code is not on disk, and ends with the
current process. If no process can be started, LLVM runs in the current process, on a thread with a
large stack.
"""

import atexit
import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import BinaryIO, cast

from evo_cpg.native.backend import compiler_process
from evo_cpg.native.backend.compiler_process import Request
from evo_cpg.native.unsupported import Unsupported

# The process is stopped after a text longer than this (characters), because LLVM never frees the
# memory.
_LARGE_TEXT = 4 * 2**20


class CompilerDied(Unsupported):
    """Raised if the process of LLVM ends, as by a crash, while it compiles a program."""


def object_code(request: Request) -> bytes:
    """Compile a module of LLVM IR.

    Raises:
        CompilerDied: LLVM ended its process.
        RuntimeError: the text is not valid IR, or LLVM has no such processor.
    """
    with _lock:
        process = _running()
        if process is None:
            return compiler_process.object_code(request)
        try:
            return _reply_of(process, request)
        except BaseException:
            # The pipes may hold an incomplete request or answer.
            _stop()
            raise
        finally:
            if len(request.text) > _LARGE_TEXT:
                _stop()


def _reply_of(process: subprocess.Popen, request: Request) -> bytes:
    """Send a request and return the object code of the answer.

    Raises:
        CompilerDied: LLVM ended its process.
        RuntimeError: the answer is an error.
    """
    requests, answers = cast(BinaryIO, process.stdin), cast(BinaryIO, process.stdout)
    options = request._asdict()
    text = options.pop("text").encode()
    line = json.dumps({**options, "size": len(text)}).encode()
    with contextlib.suppress(BrokenPipeError):
        requests.write(line + b"\n" + text)
        requests.flush()
    line = answers.readline()
    answer = json.loads(line) if line.endswith(b"\n") else {"size": 1}
    code = answers.read(answer["size"])
    if len(code) < answer["size"]:
        raise CompilerDied(f"the compiler ended with {_cause(process.wait())}")
    if "error" in answer:
        raise RuntimeError(answer["error"])
    return code


def _cause(status: int) -> str:
    """Describe the exit status of a process."""
    with contextlib.suppress(ValueError):
        return signal.Signals(-status).name
    return f"exit status {status}"


_lock = threading.Lock()
_process: subprocess.Popen | None = None
_owner = 0


def _running() -> subprocess.Popen | None:
    """Return the compiler's process. Start it if needed, and return None if that fails."""
    global _process, _owner
    # After a fork, the pipes belong to the parent process.
    if _process is None or _owner != os.getpid() or _process.poll() is not None:
        command = [sys.executable, "-P", str(Path(compiler_process.__file__))]
        try:
            _process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
            )
        except OSError:
            _process = None
        _owner = os.getpid()
    return _process


@atexit.register
def _stop() -> None:
    """End the compiler's process."""
    global _process
    if _process is None or _owner != os.getpid():
        return
    _process.kill()
    for pipe in (_process.stdin, _process.stdout):
        with contextlib.suppress(OSError):
            cast(BinaryIO, pipe).close()
    _process.wait()
    _process = None
