"""A loop in Python that steps one half cheetah, beside gymnasium's own `HalfCheetah-v5`.

Both run the same file with five physics steps of 0.01 s per step, and random actions.
"""

import importlib
import importlib.util
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from benchmarks.plan import MODELS, Plan
from benchmarks.rows import Row
from benchmarks.timing import Contender, race, ratio_quartiles
from evo_cpg.api.environment import Environment
from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import check_config
from evo_cpg.io.models.mjcf_import import read_model

# Steps of a call. An episode of gymnasium has 1000.
_STEPS = 900
_TRIAL = {"control_rate_hz": 20, "substeps": 5, "seconds": 50}


def measure(plan: Plan) -> Iterator[Row]:
    """Yield a row."""
    plan.say("loop: compiling")
    path = MODELS / "half_cheetah.xml"
    config = read_model(path).experiment
    config["simulation"] |= _TRIAL
    simulation = build_experiment(check_config(config, path), path).simulation
    session = Environment(simulation, {}, "torques", 0).session()
    limits = np.asarray(simulation.world.tree.torque_limit, np.float32)
    contenders = [Contender("ours", _STEPS, _loop(session, limits))]
    peer, missing = "gymnasium", None in map(importlib.util.find_spec, ("gymnasium", "imageio"))
    if not missing:
        theirs: Any = importlib.import_module("gymnasium").make("HalfCheetah-v5")
        contenders.append(Contender(peer, _STEPS, _loop(theirs, np.ones(6, np.float32))))
    rates = race(contenders, plan.repeats)
    medians = {name: float(np.median(each)) for name, each in rates.items()}
    low, ratio, high = (None,) * 3 if missing else ratio_quartiles(rates, "ours", peer)
    yield Row(
        "loop", "half cheetah", 1, medians["ours"], "control steps/s",
        f"a Python loop of {_STEPS} steps, each of 5 physics steps of 0.01 s, one core, median of "
        f"{plan.repeats} rounds in turn. Ours: float32, `Environment.session`. Theirs: float64",
        peer=peer, peer_rate=medians.get(peer), ratio=ratio,
        ratio_spread=None if low is None or high is None else (low, high),
        note="not installed" if missing else None,
    )  # fmt: skip


def _loop(environment: Any, limits: np.ndarray) -> Callable[[], None]:
    """Return an episode with random actions within the limits."""
    size = _STEPS, len(limits)
    actions = np.random.default_rng(0).uniform(-1, 1, size).astype(np.float32) * limits

    def run() -> None:
        environment.reset(seed=0)
        for action in actions:
            environment.step(action)

    return run
