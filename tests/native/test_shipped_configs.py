"""Native code against plain JAX on every shipped config: control steps from recorded states.

The allowed difference depends on the motion, because contact multiplies a last digit by thousands
within one control step. The reference is therefore the effect on plain JAX of a change of the
state's last digits.
"""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import load_config
from evo_cpg.native.engine import Engine, using
from evo_cpg.simulation.control_step import begin_episode, control_step

CONFIGS = Path(__file__).parents[2] / "configs"
INDIVIDUALS, TIMES, APART, NUDGES = 10, 10, 20, 8
# Relative distance of neighbouring float32 numbers.
LAST_DIGIT = 2.0**-23
SMALL = "iwadate2010_swimmer", ("creature.bodies.1.repeat=1",)
STRETCH = "{angle_weight: [-1, 1], rate_weight: 0.1, delay: 0.02, from_parents: 1}"
FEELING = SMALL[0], (*SMALL[1], f"controller.cpg.feedback={{stretch: [{STRETCH}]}}")
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
    "config",
    [
        *cases(EVERY),
        pytest.param(FEELING, id="stretch", marks=pytest.mark.slow),
        pytest.param(ALL_SENSES, id="all feedback", marks=pytest.mark.slow),
    ],
)
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
