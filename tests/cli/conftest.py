"""The program in this process for what is quick, in its own where the process matters."""

import contextlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from evo_cpg.cli import training
from evo_cpg.cli.main import main
from tiny_run import CONFIG, TINY, program

# Enough generations to stop a run in the middle of.
GENERATIONS = 40

Called = tuple[int, str, str]


@pytest.fixture
def cli(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., Called]:
    """Call `evo-cpg` in this process: exit code, what it printed, what it complained of."""
    # JAX has its two devices already.
    monkeypatch.setattr(training, "use_cores", lambda count=None: 2)

    def call(*arguments: object) -> Called:
        monkeypatch.setattr(sys, "argv", ["evo-cpg", *map(str, arguments)])
        with pytest.raises(SystemExit) as stop:
            main()
        code = stop.value.code
        assert isinstance(code, int)
        return code, *capsys.readouterr()

    return call


@pytest.fixture(scope="session")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the processes of this session keep what they compile."""
    return tmp_path_factory.mktemp("compiled")


@pytest.fixture(scope="session")
def start(compiled: Path):
    """Start `evo-cpg` as a process, which does not outlive the test."""

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
    """Run `evo-cpg` as a process to its end."""

    def run(*arguments: object, folder: Path | None = None) -> Called:
        with start(*arguments, folder=folder) as process:
            out, err = process.communicate()
        return process.returncode, out, err

    return run


@pytest.fixture(scope="session")
def finished_run(tmp_path_factory: pytest.TempPathFactory, finish) -> Path:
    """A run that went through; tests only read it, or copy it first."""
    folder = tmp_path_factory.mktemp("finished") / "run"
    code, out, err = finish(
        "train", CONFIG, *TINY, f"evolution.generations={GENERATIONS}", "--out", folder, "--cores", 2
    )
    assert code == 0, err
    assert out == f"{folder}\n"
    assert f"generation   {GENERATIONS}/{GENERATIONS}" in err
    return folder
