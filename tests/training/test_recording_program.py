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
from evo_cpg.training import loop, replay
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
    threads = {name: thread for name, thread in lowered if "replay" in name}
    assert threads and all(thread.startswith("recording") for thread in threads.values()), lowered
    mine = [name for name, thread in lowered if thread == threading.main_thread().name]
    assert any("rollout" in name for name in mine)
    assert not any("replay" in name or "judge" in name for name in mine), mine
    champion, motion, _ = folder.with_champion()
    assert motion is not None and len(motion.time) == experiment.simulation.steps
    again = replay.replay_champion(experiment, champion, 2)
    assert again[0] == champion.fitness and again[1] == champion.terms
    assert np.array_equal(again[2].position, motion.position)


def test_on_compiled_is_called_once_after_the_first_trials(tmp_path):
    """Compiling two programs at once would delay the first generation."""
    experiment, folder = folder_of(tmp_path / "run", (*TINY, "seed=76"))
    told, rows = [], []
    loop.train(experiment, folder, rows.append, on_compiled=lambda: told.append(len(rows)))
    assert told == [0]
    loop.train(experiment, folder, rows.append, on_compiled=lambda: told.append(len(rows)))
    assert told == [0], "nothing is left to do, and nothing was compiled"


@pytest.mark.slow
def test_one_program_replays_any_champion(tmp_path):
    """The program is compiled before there is a champion, and each champion has its own noise."""
    experiment, folder = folder_of(tmp_path / "run", NOISY)
    run = replay.compile_replay(experiment, 2)
    champion = loop.train(experiment, folder).champion
    assert champion is not None
    fitness, terms, _ = run(champion)
    assert fitness == champion.fitness and terms == champion.terms
    assert run(champion._replace(index=champion.index + 1))[0] != fitness


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
