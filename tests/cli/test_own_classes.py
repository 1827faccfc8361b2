"""A user's own task and controller, in a module next to the configuration, can be trained."""

import hashlib
import importlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from evo_cpg.training.run_folder import RunFolder
from tiny_run import own_config

# A controller of one wave, and a race along x.
MODULE = """
import equinox as eqx
import jax.numpy as jnp
import trials
from evo_cpg.simulation.sensors import Sensor
from evo_cpg.simulation.task import Task
from my_scale import SCALE

class SineController(trials.SineController):
    pass

class GoForward(Task):
    light: tuple[float, float, float] = (10.0, 0.0, 0.0)
    bonus: float = 0.0

    def begin(self, batch, dtype, steps):
        return jnp.zeros(batch, dtype)

    def update(self, tally, transition, steps):
        return transition.after.state.position[0]

    def terms(self, tally, steps):
        return {"distance": tally}

    def fitness(self, terms, scales):
        return terms["distance"] + self.bonus

class Variometer(Sensor):
    count: int = eqx.field(static=True, default=1)

    def sense(self, snapshot, forces):
        return snapshot.state.velocity[5:6] * SCALE

class NoGradient(GoForward):
    def fitness(self, terms, scales):
        distance = super().fitness(terms, scales)
        # The derivative of a root at 0 is infinite, and 0 times infinity is not a number.
        return distance + jnp.sqrt(0 * distance)
"""

SETTINGS = (
    "creature.bodies.1.repeat=1",
    "world.water.form_resolution=1",
    "creature.light_sensors=[]",
    "creature.bodies.1.joint.axes=[z]",
    "simulation.seconds=0.3333",
    "evolution.population=8",
    "evolution.elites=2",
    "evolution.generations=2",
)


def race(folder: Path, task: dict[str, Any]) -> Path:
    """Write a configuration and, next to it, the module."""
    config = own_config() | {"controller": {"type": "my_animal:SineController"}, "task": task}
    mine = folder / "mine"
    mine.mkdir()
    (mine / "my_animal.py").write_text(MODULE)
    (mine / "my_scale.py").write_text("SCALE = 0.5\n")
    written = mine / "race.yaml"
    written.write_text(yaml.safe_dump(config))
    return written


@pytest.fixture
def fresh_cli(cli) -> Callable:
    """Return a function that calls `evo-cpg` and imports the user's modules again each time."""

    def call(*arguments: object, folder: Path | None = None):
        path = list(sys.path)
        importlib.invalidate_caches()
        try:
            return cli(*arguments, folder=folder)
        finally:
            sys.path[:] = path
            for name in ("my_animal", "my_scale"):
                sys.modules.pop(name, None)

    return call


def test_an_own_task_and_controller_train_and_verify(fresh_cli, tmp_path):
    race(tmp_path, {"type": "my_animal:GoForward", "options": {"bonus": 5.0}})
    run, elsewhere = tmp_path / "run", tmp_path / "elsewhere"
    elsewhere.mkdir()
    code, _, err = fresh_cli(
        "train", "mine/race.yaml", *SETTINGS, "--out", run, "--cores", 1, folder=tmp_path
    )
    assert code == 0, err
    champion, _, _ = RunFolder(run).load_champion()
    assert champion.genes.shape == (2,)
    assert champion.scales == {} and list(champion.terms) == ["distance"]
    assert abs(champion.fitness - champion.terms["distance"] - 5.0) < 1e-6
    code, out, err = fresh_cli("verify", run, folder=elsewhere)
    assert code == 0, err
    assert out.endswith("is as recorded (exactly)\n")


@pytest.mark.slow
def test_refine_reports_a_fitness_without_gradient(fresh_cli, tmp_path):
    config = race(tmp_path, {"type": "my_animal:NoGradient", "options": {"bonus": 0.0}})
    run = tmp_path / "run"
    code, _, err = fresh_cli("train", config, *SETTINGS, "--out", run, "--cores", 1)
    assert code == 0, err
    folder = RunFolder(run)
    changed = folder.config.read_text().replace("bonus: 0.0", "bonus: 1.0")
    folder.config.write_text(changed)
    recorded = folder.load_champion()[0].fitness
    code, out, err = fresh_cli("refine", run, "--rounds", 1, "--steps", 2, "--cores", 1)
    assert (code, out) == (0, f"{run}\n")
    # Each of the two devices of this process computes 48 gradients.
    assert "96 gradients, 96 not finite" in err
    assert "no gradient was finite" in err
    # The changed configuration gives another fitness, which is reported, too.
    assert f"fitness is {recorded + 1:.4f} here, not {recorded:.4f} as recorded" in err


@pytest.mark.slow
def test_resume_refuses_changes_of_configuration_and_code(fresh_cli, tmp_path):
    config = race(tmp_path, {"type": "my_animal:GoForward", "options": {"bonus": 0.0}})
    sensors = "creature.sensors=[{type: 'my_animal:Variometer'}]"
    run = tmp_path / "run"
    code, _, err = fresh_cli("train", config, *SETTINGS, sensors, "--out", run, "--cores", 1)
    assert code == 0, err
    folder = RunFolder(run)
    kept = folder.read_meta()["fingerprint"]
    own = config.with_name("my_animal.py")
    assert kept["code"] == {"my_animal": hashlib.sha256(own.read_bytes()).hexdigest()}
    code, _, err = fresh_cli("resume", run, "--generations", 3)
    assert code == 0 and "warning" not in err, err
    folder.config.write_text(folder.config.read_text().replace("bonus: 0.0", "bonus: 1.0"))
    own.write_text(own.read_text() + "# changed\n")
    code, _, err = fresh_cli("resume", run, "--generations", 4)
    assert code == 2 and "last started: task.options, the source of my_animal. Its champion" in err
