"""A user's own task and controller, in a module beside the config, train without a fork."""

import yaml

from evo_cpg.training.run_folder import RunFolder
from tiny_run import CONFIG, REPOSITORY

# The controller's example in the documentation of `Controller`, and a race along x.
MODULE = """
import equinox as eqx
import jax
import jax.numpy as jnp
from evo_cpg.control.controller import Command, Controller
from evo_cpg.simulation.task import Task

class SineController(Controller):
    gene_count: int = eqx.field(static=True, default=2)
    control_step: float = eqx.field(static=True, default=1 / 60)

    def random_genes(self, key, batch, dtype):
        return jax.random.uniform(key, (self.gene_count, *batch), dtype)

    def initial_state(self, batch, dtype):
        return jnp.zeros(batch, dtype)

    def act(self, genes, state, observation):
        amplitude, frequency = genes
        time = state + self.control_step
        wave = jnp.sin(2 * jnp.pi * frequency * time)
        signal = wave[None] * jnp.ones_like(observation.joint_angle)
        return time, Command(target_rate=amplitude[None] * signal, signal=signal)

class GoForward(Task):
    light: tuple[float, float, float] = (10.0, 0.0, 0.0)
    bonus: float = 0.0

    def begin(self, batch, dtype, steps):
        return jnp.zeros(batch, dtype)

    def watch(self, tally, moment, steps):
        return moment.position[0]

    def terms(self, tally, steps):
        return {"distance": tally}

    def fitness(self, terms, scales):
        return terms["distance"] + self.bonus
"""


def test_a_task_and_a_controller_of_ones_own_train_and_verify(finish, tmp_path):
    config = yaml.safe_load(CONFIG.read_text())
    config["creature"] = str(REPOSITORY / "configs" / config["creature"])
    config["controller"] = {"type": "my_animal:SineController"}
    config["task"] = {"type": "my_animal:GoForward", "options": {"bonus": 5.0}}
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "my_animal.py").write_text(MODULE)
    (mine / "race.yaml").write_text(yaml.safe_dump(config))
    run, elsewhere = tmp_path / "run", tmp_path / "elsewhere"
    elsewhere.mkdir()
    code, _, err = finish(
        "train",
        "mine/race.yaml",
        "creature.bodies.1.repeat=1",
        "creature.light_sensors=[]",
        "creature.bodies.1.joint.axes=[z]",
        "simulation.steps=20",
        "evolution.population=8",
        "evolution.elites=2",
        "evolution.generations=2",
        "--out",
        run,
        "--cores",
        1,
        folder=tmp_path,
    )
    assert code == 0, err
    champion, _, _ = RunFolder(run).load_champion()
    assert champion.genes.shape == (2,)
    assert champion.scales == {} and list(champion.terms) == ["distance"]
    assert abs(champion.fitness - champion.terms["distance"] - 5.0) < 1e-6
    code, out, err = finish("verify", run, folder=elsewhere)
    assert code == 0, err
    assert out.endswith("comes out as recorded (exactly)\n")
