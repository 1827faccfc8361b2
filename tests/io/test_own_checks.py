"""Own classes that mix individuals, lights of a wrong type, and a fitness that is always NaN."""

import sys

import numpy as np
import pytest

import evo_cpg as evo
from evo_cpg.io.errors import ConfigError
from tiny_run import CONFIG, PAIR

MODULE = """
import equinox as eqx
import jax.numpy as jnp
import evo_cpg as evo

class Go(evo.Task):
    light: object = None
    def begin(self, batch, dtype, steps):
        return jnp.zeros(batch, dtype)
    def update(self, tally, transition, steps):
        return tally + transition.energy
    def terms(self, tally, steps):
        return {"energy": tally}
    def fitness(self, terms, scales):
        return -terms["energy"] / scales.get("energy", 1.0)

class Scaled(Go):
    def scales(self, terms):
        return {"energy": terms["energy"].max()}

class Summed(Go):
    def update(self, tally, transition, steps):
        return tally + transition.energy.sum()

class Best(Go):
    def fitness(self, terms, scales):
        return terms["energy"] / terms["energy"].max()

class Ordered(Go):
    def terms(self, tally, steps):
        return {"energy": tally - (tally[:1] if tally.ndim else tally)}

class Nothing(Go):
    def fitness(self, terms, scales):
        return terms["energy"] * jnp.nan

class Unmoved(Go):
    def fitness(self, terms, scales):
        # Not a number only for an animal at rest.
        return terms["energy"] / terms["energy"]

class Carousel(Go):
    light: object = (3.0, 0.0, 0.0)
    moves_light = True
    draws_course = True
    def begin_course(self, start):
        return 6.28 * start.uniform(1)
    def place_light(self, course):
        x, y = 3 * jnp.cos(course[0]), 3 * jnp.sin(course[0])
        return jnp.stack([x, y, 0 * x])
    def advance_course(self, course, after, step):
        return course + 0.2 * after.control_step

class Dark(Carousel):
    light: object = None

class Flat(Carousel):
    def place_light(self, course):
        return course

class Grown(Carousel):
    def advance_course(self, course, after, step):
        return course, step

class Undrawn(Carousel):
    draws_course = False

class Shared(Carousel):
    def begin_course(self, start):
        return start.uniform(1) + start.position[:1].mean()

class Wave(evo.Controller):
    gene_count: int = eqx.field(static=True, default=1)
    def random_genes(self, key, batch, dtype):
        return jnp.ones((1, *batch), dtype)
    def initial_state(self, batch, dtype):
        return jnp.zeros(batch, dtype)
    def act(self, decoded, state, observation):
        rate = decoded - observation.joint_angle.mean()
        return state, evo.Command(target_rate=rate, signal=rate)

class Slip(evo.Sensor):
    count: int = eqx.field(static=True, default=3)
    def sense(self, snapshot, forces):
        return snapshot.state.velocity[:3] - snapshot.state.velocity.mean()

class Pull(evo.ForceLaw):
    def wrench(self, bodies):
        slow = -bodies.through_water
        return jnp.concatenate([0 * slow, slow - slow.mean()])
"""


@pytest.fixture
def load(tmp_path, monkeypatch):
    """Return a function that loads a pair of bodies with parts of the module."""
    (tmp_path / "mixers.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "mixers", raising=False)

    def load(settings):
        return evo.load(CONFIG, [*PAIR, "creature.light_sensors=[]", settings])

    return load


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("task={type: 'mixers:Summed'}", r"task\.type: Summed\.update mixes individuals"),
        ("task={type: 'mixers:Ordered'}", r"Ordered\.terms mixes individuals"),
        ("task={type: 'mixers:Best'}", r"Best\.fitness mixes individuals"),
        ("task={type: 'mixers:Nothing'}", r"Nothing\.fitness is NaN for every animal"),
        ("controller={type: 'mixers:Wave'}", r"Wave\.act mixes individuals"),
        ("creature.sensors=[{type: 'mixers:Slip'}]", r"Slip\.sense mixes individuals"),
        ("world.forces=[{type: 'mixers:Pull'}]", r"forces\.0\.type: Pull\.wrench mixes ind"),
    ],
)
def test_own_classes_that_mix_individuals_are_refused(load, setting, words):
    with pytest.raises(ConfigError, match=words):
        load(setting)


@pytest.mark.parametrize("task", ["Scaled", "Unmoved"])
def test_scales_of_all_individuals_are_accepted(load, task):
    assert load(f"task={{type: 'mixers:{task}'}}").task.light is None


@pytest.mark.parametrize(
    "light", ["ahead", "[8, 0]", "8", "true", "[8, 0, null]", "[[8, 0, 0]]", "{distance: 8}"]
)
def test_a_light_of_a_wrong_type_is_refused(load, light):
    with pytest.raises(ConfigError, match=r"Go\.light must be None, or a place of three numbers"):
        load(f"task={{type: 'mixers:Go', options: {{light: {light}}}}}")


def test_a_light_of_an_own_task_may_be_a_list(load):
    experiment = load("task={type: 'mixers:Go', options: {light: [8, 0, 0]}}")
    np.testing.assert_array_equal(experiment.parts.simulation.lights, [(8, 0, 0)])


def test_a_fitness_function_that_mixes_individuals_is_refused(load):
    experiment = load("task={type: distance}")
    with pytest.raises(ValueError, match="fitness mixes individuals"):
        experiment.with_fitness(lambda terms: terms["distance"] - terms["distance"].mean())


def test_an_own_task_may_move_its_light(load):
    experiment = load("task={type: 'mixers:Carousel'}")
    light = experiment.record(0, experiment.random_genomes(0, 1)[0]).recording.light
    np.testing.assert_allclose(np.linalg.norm(light, axis=1), 3.0, rtol=1e-5)
    angles = np.unwrap(np.arctan2(light[:, 1], light[:, 0]))
    np.testing.assert_allclose(np.diff(angles), 0.2 / 60, rtol=1e-3)


@pytest.mark.parametrize(
    ("task", "words"),
    [
        ("Dark", "must be a place, not None"),
        ("Flat", r"Flat\.place_light must return"),
        ("Grown", r"Grown\.advance_course must return"),
        ("Undrawn", "draws_course = True"),
        ("Shared", r"Shared\.begin_course mixes individuals"),
    ],
)
def test_wrong_methods_of_moving_lights_are_refused(load, task, words):
    with pytest.raises(ConfigError, match=words):
        load(f"task={{type: 'mixers:{task}'}}")
