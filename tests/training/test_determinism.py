"""Repeated runs have equal bits, which equal the recorded bits of this kind of machine.

`EVO_CPG_NOTE_BITS=1 pytest tests/training/test_determinism.py` records the bits of this machine.
Repeat it after a change of the program that is meant to change the bits.
"""

import functools
import hashlib
import json
import os
from pathlib import Path

import numpy as np
import pytest

import xla_flags
from evo_cpg.api.machine import machine_changes, machine_fingerprint
from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import dump_config, load_config
from evo_cpg.training.evaluate import compile_replay
from evo_cpg.training.run_folder import RunFolder
from evo_cpg.training.train import TIMING_COLUMNS, train
from tiny_run import CONFIG, PAIR

CPUINFO = Path("/proc/cpuinfo")
NOTED = Path(__file__).with_name("noted_bits.json")

WALKERS = (
    "runs=2", "simulation.seconds=0.6667", "evolution.generations=3", "evolution.population=6",
    "evolution.elites=2", "evolution.rank_probabilities=[0.5, 0.3, 0.2]",
)  # fmt: skip
KINDS = {
    "swimmer": ("iwadate2010_swimmer", PAIR),
    "swimmer with noise, two trials": (
        "iwadate2010_swimmer", (*PAIR, "noise.push=0.1", "simulation.trials=2"),
    ),
    "swimmer that learns": (
        "iwadate2010_swimmer",
        (
            *PAIR,
            "simulation.seconds=0.1667",
            "evolution.learning={every: 2, learners: 1, steps: 1}",
        ),
    ),
    "walkers on ground of any friction": (
        "fukui2003_model1", (*WALKERS, "noise.friction=0.2", "noise.tilt_deg=1"),
    ),
}  # fmt: skip


def digest(kind: str, folder: Path) -> str:
    """Return the digest of all results of a run, except times."""
    name, settings = KINDS[kind]
    path = CONFIG.with_name(f"{name}.yaml")
    config = load_config(path, settings)
    experiment = build_experiment(config, path)
    run = RunFolder(folder)
    run.create(dump_config(config), {})
    done = train(experiment, run)
    assert done.champion is not None
    fitness, terms, _, motion = compile_replay(experiment, 2)(done.champion)
    assert fitness == done.champion.fitness
    rows = [{k: v for k, v in row.items() if k not in TIMING_COLUMNS} for row in done.history]
    told = json.dumps([rows, done.scales, fitness, terms, done.champion[1:]])
    parts = told.encode(), done.genes.tobytes(), *(np.asarray(each).tobytes() for each in motion)
    return hashlib.sha256(b"".join(parts)).hexdigest()


def machine(engine) -> str:
    """Return a description of the machine that bits depend on."""
    here = machine_fingerprint(engine, 2)
    versions = [f"{name} {here['versions'][name]}" for name in ("jaxlib", "numpy")]
    flags = []
    if CPUINFO.exists():
        flags = [x for x in CPUINFO.read_text().splitlines() if x.startswith("flags")][:1]
    able = hashlib.sha256("".join(flags).encode()).hexdigest()[:8]
    code = f"{here.get('instructions', 'plain')} code by LLVM {here.get('llvm', '-')}"
    return ", ".join([here["processor"], f"flags {able}", code, *versions, *xla_flags.quick()])


# The fast tests run one kind, which has all parts of the first and noise.
EACH_KIND = pytest.mark.parametrize(
    "kind",
    [pytest.param(kind, marks=[] if "with noise" in kind else pytest.mark.slow) for kind in KINDS],
)


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    """Return a function that returns the digest of a kind's run, which is made once."""
    return functools.cache(lambda kind: digest(kind, tmp_path_factory.mktemp("first")))


@EACH_KIND
def test_same_run_has_same_bits(kind, first, tmp_path):
    assert digest(kind, tmp_path) == first(kind)


@EACH_KIND
def test_run_has_the_recorded_bits(kind, first):
    name, settings = KINDS[kind]
    path = CONFIG.with_name(f"{name}.yaml")
    here = machine(build_experiment(load_config(path, settings), path).simulation.engine)
    noted = json.loads(NOTED.read_text())
    if os.environ.get("EVO_CPG_NOTE_BITS"):
        noted.setdefault(here, {})[kind] = first(kind)
        NOTED.write_text(json.dumps(noted, indent=1, sort_keys=True) + "\n")
    if kind not in noted.get(here, {}):
        # Each kind of machine rounds differently.
        pytest.skip(f"no result of {kind} is recorded for the machine {here}")
    assert first(kind) == noted[here][kind]


def test_machine_changes_that_affect_bits_are_named():
    from evo_cpg.native.engine import Engine

    here = machine_fingerprint(Engine(), 2)
    assert machine_changes(here, here) == []
    assert machine_changes({}, here) == []
    then = here | {
        "processor": "Another 9000",
        "devices": 7,
        "versions": here["versions"] | {"jaxlib": "0.0.1", "equinox": "0"},
    }
    told = machine_changes(then, here)
    assert told == [
        "cores: then 7, here 2",
        f"processor: then Another 9000, here {here['processor'][:80]}",
        f"jaxlib: then 0.0.1, here {here['versions']['jaxlib']}",
    ]
