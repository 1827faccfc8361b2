"""Fixtures that run `evo-cpg`: in this process, or in a process of its own if that matters."""

import contextlib
import io
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from evo_cpg.api import progress
from evo_cpg.cli.main import main
from evo_cpg.training import devices
from shared_programs import programs_of_its_own, remember_programs
from tiny_run import CONFIG, GENERATIONS, LONG, program

__all__ = ["programs_of_its_own", "remember_programs"]

Called = tuple[int, str, str]


class CommandLine:
    """`evo-cpg`, or another program, in this process."""

    def __init__(self, program: Callable[[], None] = main):
        self._program = program

    def __call__(self, *arguments: object, folder: Path | None = None) -> Called:
        """Return exit code, standard output and standard error of a command."""
        return called(*arguments, folder=folder, program=self._program)

    def passes(self, *arguments: object, folder: Path | None = None) -> tuple[str, str]:
        """Return standard output and error of a command that must succeed."""
        code, out, err = called(*arguments, folder=folder, program=self._program)
        assert code == 0, err
        return out, err

    def refuses(self, *arguments: object, folder: Path | None = None) -> str:
        """Return the message of a command that must refuse its input without output."""
        code, out, err = called(*arguments, folder=folder, program=self._program)
        assert (code, out) == (2, "") and "Traceback" not in err, err
        return err


@pytest.fixture(scope="session")
def cli() -> CommandLine:
    return CommandLine()


@pytest.fixture(scope="session")
def command_line_of() -> type[CommandLine]:
    """Class of command lines, for other programs."""
    return CommandLine


def called(
    *arguments: object, folder: Path | None = None, program: Callable[[], None] = main
) -> Called:
    """Call `evo-cpg` in this process, where JAX already has its two devices.

    Args:
        arguments: arguments of the command line.
        folder: working folder.
        program: function to call.

    Returns:
        Exit code, standard output and standard error.
    """
    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(devices, "use_cores", lambda count=None: 2)
        # Durations on a busy machine mean nothing, so print none.
        patch.setattr(progress, "FIRST", math.inf)
        patch.setattr(progress, "BETWEEN", math.inf)
        patch.setattr(sys, "argv", ["evo-cpg", *map(str, arguments)])
        if folder is not None:
            patch.chdir(folder)
        with (
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(err),
            pytest.raises(SystemExit) as stop,
        ):
            program()
    code = stop.value.code
    assert isinstance(code, int)
    return code, out.getvalue(), err.getvalue()


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Interrupts arrive, also in processes started here, even if a shell ignores them."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="session")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder that the workers of this session share."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "shared"
    folder.mkdir(exist_ok=True)
    return folder


@pytest.fixture(scope="session")
def compiled(shared: Path) -> Path:
    """Return the folder for the compiled code of the processes of this session."""
    return shared / "compiled"


@pytest.fixture(scope="session")
def start(compiled: Path):
    """Return a context that runs `evo-cpg` as a process, and kills the process at its end."""

    @contextlib.contextmanager
    def started(*arguments: object, folder: Path | None = None) -> Iterator:
        with program(*arguments, compiled=compiled, folder=folder) as process:
            try:
                yield process
            finally:
                process.kill()

    return started


@pytest.fixture(scope="session")
def finish(start) -> Callable[..., Called]:
    """Return a function that runs `evo-cpg` as a process to its end."""

    def run(*arguments: object, folder: Path | None = None) -> Called:
        with start(*arguments, folder=folder) as process:
            out, err = process.communicate()
        # Durations on a busy machine mean nothing, so drop their lines.
        lines = [line for line in err.splitlines(True) if not line.endswith(" s so far\n")]
        return process.returncode, out, "".join(lines)

    return run


@pytest.fixture(scope="session")
def finished_run(shared: Path, finish) -> Path:
    """Return the folder of an uninterrupted run. Tests may read or copy it, but not change it."""
    folder, done = shared / "finished", shared / "done"
    try:
        folder.mkdir()
    except FileExistsError:
        # The other worker makes it.
        while not done.exists():
            time.sleep(0.1)
    else:
        try:
            code, out, err = finish("train", CONFIG, *LONG, "--out", folder, "--cores", 2)
        finally:
            done.touch()
        assert code == 0, err
        assert out == f"{folder}\n"
        assert f"  {GENERATIONS}/{GENERATIONS} generations  best" in err
        # The numbers of generations begin with 0.
        assert " (the first is 0): fitness" in err
    return folder
