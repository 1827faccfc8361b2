"""Text that `print` shows for public objects."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import evo_cpg as evo
from evo_cpg.io.schema.world import WaterConfig, WorldConfig
from tiny_run import CONFIG, PAIR


@pytest.fixture(scope="module")
def experiment():
    return evo.load(CONFIG, [*PAIR, "task={type: distance}"])


def test_an_experiment_shows_its_parts(experiment):
    shown = repr(experiment)
    assert shown.startswith("Experiment('iwadate2010_swimmer', creature=Creature('swimmer10'")
    assert "genes=51, task=Distance, trials=1 of 1 s, search=RealGenetics of 8" in shown


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (["world.water=null", "world.ground={}"], "no water, ground)"),
        (["world.water.surface=-0.5"], "water up to -0.5 m, no ground)"),
    ],
)
def test_a_world_shows_its_water_and_its_ground(settings, words):
    assert repr(evo.load(CONFIG, [*PAIR, *settings]).world).endswith(words)


def test_settings_show_values_that_differ_from_defaults():
    assert repr(WorldConfig()) == str(WorldConfig()) == "WorldConfig()"
    world = WorldConfig(gravity=1.6, water=WaterConfig(surface=0.0))
    assert repr(world) == "WorldConfig(gravity=1.6, water=WaterConfig(surface=0.0))"


def test_long_lists_of_settings_show_their_length(experiment):
    config = experiment.config.creature
    assert "bodies=[BodyConfig(name='head', " in repr(config)
    many = config.model_copy(update={"bodies": config.bodies * 3})
    assert "bodies=[6 entries]" in repr(many)


def test_an_environment_shows_its_sizes_and_its_state_the_last_step(experiment):
    environment = experiment.environment()
    assert repr(environment).startswith("Environment(1 actions (rates), 7 observations (light 1,")
    state = evo.EnvironmentState(
        jnp.zeros(7), jnp.float32(0.25), jnp.asarray(True), {"distance": jnp.float32(1.0)}, None
    )
    assert repr(state) == (
        "EnvironmentState(obs of shape (7,), reward=0.25, done=True, metrics: distance)"
    )
    several = jax.tree.map(lambda x: x[None], state)
    assert "reward=float32[1], done=bool[1]" in repr(several)
    seen = []
    jax.eval_shape(lambda state: seen.append(repr(state)), state)
    assert "reward=float32[], done=bool[]" in seen[0]


def test_results_show_their_numbers_and_not_their_arrays():
    fitness, terms = np.array([0.5, 2.0, -np.inf]), {"distance": np.zeros(3)}
    found = evo.Evaluation(fitness, terms, terms, fitness[None])
    assert repr(found) == "Evaluation(fitness of 3 individuals, best 2; terms: distance)"
    traced = evo.Evaluation(jnp.asarray(fitness), terms, terms, fitness[None])
    assert repr(traced) == "Evaluation(fitness of shape [3]; terms: distance)"
    trials = evo.Trials(terms, np.array([[True, False], [True, True]]))
    assert repr(trials) == "Trials(individuals=2, trials=2, diverged=1, terms: distance)"
    trained = evo.Trained(Path("run"), np.zeros(51), 1.25, {"distance": 3.0}, [{}, {}], 1.0)
    assert repr(trained) == (
        "Trained('run': fitness 1.25, expected 1 (distance 3), 51 genes, 2 rows of history)"
    )
