"""A process of its own for work that may take too long or too much memory.

The worker (`serve`) prepares itself and reports that it is ready. It then does its work once for
every line that it reads, so that workers can take turns. It writes JSON, a line at a time, to its
original standard output. All other output goes to its standard error.
"""

import contextlib
import json
import os
import resource
import select
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from typing import IO, Any

from benchmarks.plan import ROOT

# Largest address space of a worker, bytes. It stops runaway compilers before the machine begins to
# swap.
MEMORY_LIMIT = 12 * 2**30
# Variables that a worker does not inherit. This program sets them for itself: XLA's threads are off
# if every core is a device.
_OWN_SETTINGS = ("NPROC",)
# Cached code must not shorten the compile time.
_NO_CACHE = {"JAX_ENABLE_COMPILATION_CACHE": "false"}


class WorkerError(Exception):
    """Reason why a worker has no results, in words for the table."""


class Worker:
    """A started worker.

    Args:
        complaints: file of the worker's standard error.
        module: module of this package that calls `serve`.
        arguments: arguments of the module.
    """

    def __init__(self, complaints: IO[str], module: str, *arguments: str):
        self._complaints, self._doing = complaints, "compiling"
        environment = {key: v for key, v in os.environ.items() if key not in _OWN_SETTINGS}
        environment |= _NO_CACHE
        environment["PYTHONPATH"] = os.pathsep.join(
            filter(None, [str(ROOT), os.environ.get("PYTHONPATH")])
        )
        self._process = subprocess.Popen(
            [sys.executable, "-m", f"benchmarks.{module}", *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._complaints,
            env=environment,
            text=True,
        )

    def answer(self, limit: float) -> dict[str, Any]:
        """Return the next line that the worker writes.

        Args:
            limit: longest wait, s.

        Raises:
            WorkerError: the worker took too long, ended, or reported a failure.
        """
        assert self._process.stdout is not None
        if not select.select([self._process.stdout], [], [], limit)[0]:
            raise WorkerError(f"did not finish {self._doing} in {limit:g} s")
        line = self._process.stdout.readline()
        if not line:
            raise WorkerError(self._last_words())
        answer = json.loads(line)
        if "error" in answer:
            raise WorkerError(answer["error"])
        self._doing = "a call"
        return answer

    def ask(self, question: Any, limit: float) -> dict[str, Any]:
        """Run the worker once, and return its answer.

        Args:
            question: argument of the worker's function, which must fit into JSON.
            limit: longest wait, s.

        Raises:
            WorkerError: the worker took too long, ended, or reported a failure.
        """
        self.send(question)
        return self.answer(limit)

    def send(self, question: Any) -> None:
        """Make the worker run once, without waiting (see `answer`).

        Raises:
            WorkerError: the worker ended.
        """
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(question) + "\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            raise WorkerError(self._last_words()) from None

    def stop(self) -> None:
        """End the worker at once."""
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                # A line that the worker has not read cannot be delivered after its end.
                with contextlib.suppress(BrokenPipeError):
                    stream.close()

    def _last_words(self) -> str:
        code = self._process.wait()
        self._complaints.seek(0)
        lines = [line.strip() for line in self._complaints if line.strip()]
        return f"ended with code {code}: {lines[-1] if lines else 'no message'}"


@contextlib.contextmanager
def started(module: str, *arguments: str) -> Iterator[Worker]:
    """Yield a worker that ends with the block."""
    with tempfile.TemporaryFile("w+") as complaints:
        worker = Worker(complaints, module, *arguments)
        try:
            yield worker
        finally:
            worker.stop()


def serve(prepare: Callable[[], tuple[dict[str, Any], Callable[[Any], dict[str, Any]]]]) -> None:
    """Serve requests as the worker, until the input ends or an error is reported.

    Args:
        prepare: function that returns the first report, and a function from a question to its
            answer.
    """
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT, MEMORY_LIMIT))
    speech = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)

    def say(answer: dict[str, Any]) -> None:
        speech.write(json.dumps(answer) + "\n")
        speech.flush()

    start = time.perf_counter()
    try:
        ready, work = prepare()
        say({"prepared": time.perf_counter() - start, **ready})
        for line in sys.stdin:
            say(work(json.loads(line)))
    except Exception as error:
        first = (str(error).strip() or "no message").splitlines()[0]
        say({"error": f"{type(error).__name__}: {first}"})
