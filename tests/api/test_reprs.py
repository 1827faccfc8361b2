"""Text that `print` shows for public objects."""

import jax.numpy as jnp
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


def test_settings_show_values_that_differ_from_defaults():
    assert repr(WorldConfig()) == str(WorldConfig()) == "WorldConfig()"
    world = WorldConfig(gravity=1.6, water=WaterConfig(surface=0.0))
    assert repr(world) == "WorldConfig(gravity=1.6, water=WaterConfig(surface=0.0))"


def test_an_environment_shows_its_sizes_and_its_state_the_last_step(experiment):
    environment = experiment.environment()
    assert repr(environment).startswith("Environment(1 actions (rates), 7 observations (light 1,")
    state = evo.EnvironmentState(
        jnp.zeros(7), jnp.float32(0.25), jnp.asarray(True), {"distance": jnp.float32(1.0)}, None
    )
    assert repr(state) == (
        "EnvironmentState(obs of shape (7,), reward=0.25, done=True, metrics: distance)"
    )
