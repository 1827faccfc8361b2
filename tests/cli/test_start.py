"""Cost of starting the program, and side effects of importing it."""

import os
import resource
import statistics
import subprocess
import sys
from pathlib import Path

import pytest
import typer

import evo_cpg
from evo_cpg.cli.main import COMMANDS, app, main
from tiny_run import CONFIG, LONG, REPOSITORY, environment

IMPORT_EVERYTHING = """
import importlib, pkgutil, jax

before = dict(jax.config.values)
import pytest

import evo_cpg

for module in pkgutil.walk_packages(evo_cpg.__path__, "evo_cpg."):
    importlib.import_module(module.name)
changed = {k for k, v in jax.config.values.items() if before.get(k, v) != v}
assert not changed, changed

# JAX refuses this after its first computation.
jax.config.update("jax_num_cpu_devices", 3)
print(*(name for name in sys.modules if name.startswith("evo_cpg.")))
"""

TRAIN = """
import sys
from evo_cpg.cli.main import main

try:
    main()
except SystemExit as stop:
    assert not stop.code, stop.code
print(*sys.modules)
"""


def python(code: str, *arguments: object, compiled: Path) -> str:
    """Run a Python program in a process, and return its output."""
    done = subprocess.run(
        [sys.executable, "-c", f"import sys\n{code}", *map(str, arguments)],
        env=environment(compiled),
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def processor_time_of_children():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def test_help_takes_less_than_half_a_second():
    """The test measures processor time, because durations on a busy machine mean nothing."""
    seconds = []
    for arguments in (["--help"], ["train", "--help"], ["render", "--help"]):
        start = processor_time_of_children()
        done = subprocess.run(
            [sys.executable, "-m", "evo_cpg", *arguments],
            cwd=REPOSITORY,
            capture_output=True,
            text=True,
        )
        seconds.append(processor_time_of_children() - start)
        assert done.returncode == 0 and "Usage:" in done.stdout and done.stderr == ""
    assert statistics.median(seconds) < 0.5


def test_no_line_of_the_help_is_cut_at_80_columns():
    """A summary that does not fit into its line would end with three dots."""
    program = typer.main.get_command(app)
    context = program.make_context("evo-cpg", ["configs"], terminal_width=80)
    lines = program.get_help(context).splitlines()
    commands = [line for line in lines if line.startswith("  ") and line.split()[0] in COMMANDS]
    assert len(commands) == len(COMMANDS)
    assert not [line for line in commands if line.endswith("...") or len(line) > 80]


@pytest.mark.slow
def test_importing_does_not_configure_or_start_jax(compiled):
    loaded = python(IMPORT_EVERYTHING, compiled=compiled).split()
    files = Path(evo_cpg.__file__).parent.rglob("*.py")
    assert len(loaded) == sum(1 for _ in files) - 1


@pytest.mark.slow
def test_training_never_loads_vtk(finished_run, compiled, tmp_path):
    del finished_run  # Its training has filled the cache of compiled code.
    settings = (*LONG, "evolution.generations=1", "--out", tmp_path / "run", "--cores", 2)
    loaded = set(python(TRAIN, "train", CONFIG, *settings, compiled=compiled).split())
    assert "evo_cpg.training.train" in loaded
    assert not {"vtk", "vtkmodules", "pyvista", "matplotlib", "imageio_ffmpeg"} & loaded


@pytest.mark.parametrize("chosen, used", [(None, "cpu"), ("cuda,cpu", "cuda,cpu")])
def test_commands_use_the_processor_unless_jax_platforms_says_otherwise(monkeypatch, chosen, used):
    monkeypatch.setenv("JAX_PLATFORMS", chosen or "")
    if chosen is None:
        monkeypatch.delenv("JAX_PLATFORMS")
    monkeypatch.setattr(sys, "argv", ["evo-cpg", "--version"])
    with pytest.raises(SystemExit):
        main()
    assert os.environ["JAX_PLATFORMS"] == used
