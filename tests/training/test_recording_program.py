"""The program that records the champion is compiled while the population evolves."""

import threading
from typing import Any

import jax
import numpy as np
import pytest

from evo_cpg.api.training import ChampionRecorder, evolve_run
from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import load_config
from evo_cpg.io.run import Run
from evo_cpg.training import evaluate, train
from evo_cpg.training.run_folder import RunFolder
from tiny_run import CONFIG, TINY

NOISY = (*TINY, "noise.joint_angle_deg=2", "simulation.trials=3", "seed=77")


@pytest.fixture
def lowered():
    """Record every program that JAX lowers during the test, and the thread."""
    seen = []

    def listen(event: str, seconds: float, **details) -> None:
        del seconds
        if event.endswith("jaxpr_to_mlir_module_duration"):
            seen.append((details.get("fun_name", ""), threading.current_thread().name))

    jax.monitoring.register_event_duration_secs_listener(listen)
    yield seen
    jax.monitoring.unregister_event_duration_listener(listen)


def folder_of(path, overrides):
    folder = RunFolder(path)
    folder.create("name: test\n", {"devices": 2})
    return build_experiment(load_config(CONFIG, overrides), CONFIG), folder


@pytest.mark.slow
def test_nothing_large_is_compiled_after_the_last_generation(tmp_path, lowered):
    settings = (*TINY, "seed=76", "audit.after_training=false")
    experiment, folder = folder_of(tmp_path / "run", settings)
    run = Run(folder, load_config(CONFIG, settings), experiment)
    evolve_run(run, lambda rows: None)
    mine = [name for name, thread in lowered if thread == threading.main_thread().name]
    others = [name for name, thread in lowered if thread.startswith("recording")]
    # The program of all trials, and the program that records the champion.
    assert sum("rollouts" in name for name in mine) == 1, mine
    assert sum("rollouts" in name for name in others) == 1, others
    assert not any("judge" in name for name in mine), mine
    champion, motion, _ = folder.load_champion()
    assert motion is not None and len(motion.time) == experiment.simulation.steps
    again = evaluate.compile_replay(experiment, 2)(champion)
    assert again.fitness == champion.fitness and again.terms == champion.terms
    assert np.array_equal(again.recording.position, motion.position)


@pytest.mark.slow
def test_on_compiled_is_called_once_after_the_first_trials(tmp_path):
    """Compiling two programs at once would delay the first generation."""
    experiment, folder = folder_of(tmp_path / "run", (*TINY, "seed=76"))
    told, rows = [], []
    train.train(experiment, folder, rows.append, on_compiled=lambda: told.append(len(rows)))
    assert told == [0]
    train.train(experiment, folder, rows.append, on_compiled=lambda: told.append(len(rows)))
    assert told == [0], "nothing is left to do, and nothing was compiled"


@pytest.mark.slow
def test_one_program_replays_any_champion(tmp_path):
    """The program is compiled before there is a champion, and each champion has its own noise."""
    experiment, folder = folder_of(tmp_path / "run", NOISY)
    run = evaluate.compile_replay(experiment, 2)
    champion = train.train(experiment, folder).champion
    assert champion is not None
    again = run(champion)
    assert again.fitness == champion.fitness and again.terms == champion.terms
    assert run(champion._replace(index=champion.index + 1)).fitness != champion.fitness


def test_an_interrupt_skips_only_the_first_look(tmp_path):
    """The champion is already recorded, and the run is finished."""
    recorded = []

    class Interrupted(ChampionRecorder):
        def record(self, champion):
            recorded.append(champion)

        def look(self, champion, displacement):
            raise KeyboardInterrupt

    experiment, folder = folder_of(tmp_path / "run", (*TINY, "seed=76"))
    champion: Any = object()
    with Interrupted(experiment, folder, 0.9) as recorder:
        recorder.keep(champion)
    assert recorded == [champion] and recorder.skipped
    meta = folder.read_meta()
    assert meta["half_step"] is None and "finished" in meta
