"""Native code against plain JAX on every shipped config, and the size of its code.

Single control steps and a second in water start from recorded states, in float32. The allowed
difference depends on the motion, because contact multiplies a last digit by thousands within one
control step. The reference is therefore the effect on plain JAX of a change of the state's last
digits. Short trials are compared in float64, without noise, because noise is drawn in float32 and
differs in the last digit (`tests/simulation/test_noise.py`).
"""

import dataclasses
import functools
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml

from benchmarks.growth import exponent
from benchmarks.large_bodies import walker
from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import complete_config, load_config
from evo_cpg.native.compile import optimize
from evo_cpg.native.engine import Engine, using
from evo_cpg.native.frontend.primitives import fused_p
from evo_cpg.simulation.control_step import begin_episode, control_step
from evo_cpg.simulation.judge import JUDGE
from evo_cpg.simulation.noise import Noise
from evo_cpg.simulation.recording import Recorder
from evo_cpg.simulation.rollout import rollout
from tiny_run import VISCOUS

CONFIGS = Path(__file__).parents[2] / "configs"
INDIVIDUALS, TIMES, APART, NUDGES = 10, 10, 20, 8
# Relative distance of neighbouring float32 numbers.
LAST_DIGIT = 2.0**-23
# A swimmer with three of its ten bodies. The other configs compile longer.
SMALL = "iwadate2010_swimmer", ("creature.bodies.1.repeat=1",)
STRETCH = "{angle_weight: [-1, 1], rate_weight: 0.1, delay: 0.02, from_parents: 1}"
LEGS = '{limbs: ["*_arm", "*_thigh"]'
ALL_SENSES = (
    "iwadate2010_salamander_land",
    (
        f"controller.cpg.feedback={{stretch: [{STRETCH}], "
        f"load: [{LEGS}, weight: 0.2, neighbour_weight: [-1, 0], delay: 0.03}}]}}",
    ),
)
# The robust configs have the creatures of other configs.
EVERY = sorted(p.stem for p in CONFIGS.glob("*.yaml") if not p.stem.endswith("_robust"))
IN_WATER = "iwadate2010_swimmer", "iwadate2010_salamander_water", "two_eyed_swimmer"


def cases(names):
    return [
        pytest.param(SMALL, id="three bodies"),
        *[pytest.param((name, ()), id=name, marks=pytest.mark.slow) for name in names],
    ]


class Trial:
    """Individuals of a config, and their control step by either engine."""

    def __init__(self, config):
        name, overrides = config
        path = CONFIGS / f"{name}.yaml"
        simulation = build_experiment(load_config(path, list(overrides)), path).simulation
        self.rate = simulation.control_rate
        genes = simulation.genome.random(jax.random.key(0), (INDIVIDUALS,), jnp.float32)
        keys = None
        if not simulation.noise.silent:
            keys = jax.random.key_data(jax.random.split(jax.random.key(1), INDIVIDUALS)).T

        def begin():
            return begin_episode(simulation, genes, keys, None)

        def made(engine):
            def step(animal, index):
                with using(Engine(engine)):
                    return control_step(simulation, begin()[0], animal, index)

            return jax.jit(step)

        with using(Engine("native")):
            self.start = jax.jit(begin)()[1]
        self.native, self.plain = made("native"), made("jax")


@pytest.fixture(scope="module")
def trials():
    latest = {}

    def trial(config):
        if config not in latest:
            # A program has thousands of memory mappings, whose number Linux limits.
            latest.clear()
            jax.clear_caches()
            latest[config] = Trial(config)
        return latest[config]

    return trial


def numbers(tree):
    return [np.asarray(x, float) for x in jax.tree.leaves(tree) if x.size]


def moved(trial, animal, number, engine="plain"):
    """Return the results of a control step, and the fraction of the step without ground contact."""
    animal, effects = getattr(trial, engine)(animal, number)
    return (animal, effects._replace(airborne=())), np.asarray(effects.airborne)


def distances(found, expected):
    """Return each individual's largest difference in every array, relative to the array's size."""
    return np.array(
        [
            np.abs(a - b).reshape(-1, INDIVIDUALS).max(0) / max(np.abs(b).max(), 1e-12)
            for a, b in zip(numbers(found), numbers(expected), strict=True)
        ]
    )


def nudged(animal, generator):
    """Return the state with changed last digits."""

    def nudge(x):
        return x * (1 + LAST_DIGIT * generator.choice([-1.0, 1.0], x.shape)).astype(x.dtype)

    return animal._replace(state=jax.tree.map(nudge, animal.state))


@pytest.mark.slow
@pytest.mark.parametrize("config", cases(IN_WATER))
def test_a_second_in_water_agrees(config, trials):
    """Compare with changed last digits in every step. Walkers diverge, so they are absent."""
    trial, generator = trials(config), np.random.default_rng(0)
    native = plain = near = trial.start
    for index in range(round(trial.rate)):
        native, plain = trial.native(native, index)[0], trial.plain(plain, index)[0]
        near = trial.plain(nudged(near, generator), index)[0]
    assert distances(native, plain).max() < 3 * distances(near, plain).max()
    assert distances(native, plain).max() < 1e-3


@pytest.mark.parametrize(
    "config", [*cases(EVERY), pytest.param(ALL_SENSES, id="all feedback", marks=pytest.mark.slow)]
)
@pytest.mark.slow
def test_control_steps_agree_to_the_last_digits(config, trials):
    trial, generator = trials(config), np.random.default_rng(0)
    animal, apart, loose, touching = trial.start, [], [], 0
    for index in range(TIMES * APART):
        number = jnp.int32(index)
        if index % APART == 0:
            expected, off = moved(trial, animal, number)
            found, found_off = moved(trial, animal, number, "native")
            near = [moved(trial, nudged(animal, generator), number)[0] for _ in range(NUDGES)]
            apart.append(distances(found, expected))
            loose.append([distances(one, expected) for one in near])
            touching += (off == found_off).sum()
        animal = trial.native(animal, number)[0]
    apart, loose = np.array(apart), np.array(loose)
    assert apart.shape[0] * apart.shape[2] == 100
    # The median difference is about the effect of the last digits. No difference far exceeds it.
    assert np.median(apart.max(1)) <= 4 * np.median(loose.max(2)) + 1e-6
    assert apart.max() <= 10 * loose.max() + 1e-5
    # A last digit may decide whether a point just touches.
    assert touching >= 95


# Whole trials.

SHEDDING = (
    "creature.bodies.0.shape.size.2=0.15",
    "creature.bodies.1.repeat=2",
    "world.water.surface=0.02",
    "world.water.reactive_thrust=true",
)
LIFTING = (
    "creature.bodies.1.repeat=1",
    "creature.bodies.1.shape.size.1=0.02",
    "world.water.surface=0.02",
    *VISCOUS,
    "world.water.lift=true",
)
STEPS, BOTH = 3, 2

# Roundings differ by 2e-16 in every operation, and contact multiplies that by thousands. Measured
# differences were up to 1e-14 of the largest number in water and 9e-13 on the ground. The residual
# of solved equations is itself such a difference. Its scale is the equations' terms, which are 1.
# The cosine of an animal that swims level is a rounding, too.
TOLERANCE = 1e-11
OF_SCALE_1 = ("solved_residual", "coulomb_residual", "sense.vertical_cosine")


def short_trial(name, overrides, engine):
    """Return the results of a short trial of some individuals, and the recording of one."""
    path = CONFIGS / f"{name}.yaml"
    config = load_config(path, [f"engine={engine}", *overrides])
    simulation = build_experiment(config, path).simulation
    simulation = dataclasses.replace(simulation, steps=STEPS, noise=Noise())
    keys = jax.random.key_data(jax.random.split(jax.random.key(1), BOTH)).T
    genes = simulation.genome.random(jax.random.key(0), (BOTH,), jnp.float64)
    both = JUDGE, Recorder(full=True)
    live = jax.jit(lambda genes, keys: rollout(simulation, genes, keys, observers=both))
    outcome, frames = jax.device_get(live(genes, keys))
    assert outcome.alive.all()
    return {**outcome.terms, **frames}


@pytest.mark.parametrize(
    ("name", "overrides"),
    [
        pytest.param(*SMALL, id="three bodies"),
        pytest.param(SMALL[0], SHEDDING, id="reactive thrust", marks=pytest.mark.slow),
        pytest.param(SMALL[0], LIFTING, id="lift", marks=pytest.mark.slow),
        *[pytest.param(name, (), id=name, marks=pytest.mark.slow) for name in EVERY],
    ],
)
def test_native_code_and_jax_give_the_same_trial(x64, name, overrides):
    found, expected = (short_trial(name, overrides, engine) for engine in ("native", "jax"))
    assert found.keys() == expected.keys()
    assert np.abs(np.diff(expected["joint_angle"], axis=0)).max() > 1e-6
    for key, values in expected.items():
        size = 1.0 if key in OF_SCALE_1 else np.abs(values).max(initial=0.0)
        np.testing.assert_allclose(
            found[key], values, rtol=0, atol=TOLERANCE * size, strict=True, err_msg=key
        )


def test_every_shipped_creature_is_compared():
    configs = [yaml.safe_load(path.read_text()) for path in CONFIGS.glob("*.yaml")]
    creatures = {f"creatures/{path.name}" for path in (CONFIGS / "creatures").glob("*.yaml")}
    # Plans evolve their creatures.
    used = [config["creature"] for config in configs if "creature" in config]
    assert creatures == {each["file"] if isinstance(each, dict) else each for each in used}


def operations(legs):
    """Return the number of operations of a walker's trial, without compiling it."""
    source = Path("walker.yaml")
    config = complete_config(walker(legs, "capsule"), source)
    simulation = build_experiment(config, source).simulation
    genes = jax.eval_shape(lambda: simulation.genome.random(jax.random.key(0), (64,), jnp.float32))
    jaxpr = jax.make_jaxpr(functools.partial(rollout, simulation))(genes)
    (fused,) = [each for each in jaxpr.eqns if each.primitive is fused_p]
    return optimize(fused.params["program"]).operations


@pytest.mark.slow
def test_operations_grow_slowly_with_bodies():
    legs = 4, 20
    found = [operations(each) for each in legs]
    assert found[0] < 60_000
    assert exponent([2 * each + 1 for each in legs], found) < 1.5
