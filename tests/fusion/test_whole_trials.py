"""Every shipped config with the native back end and with it switched off: trials, in float64.

Switched off (`engine: jax`) the simulation is plain JAX, which is what its code says; both must
come to the same. From single steps to many see `test_shipped_configs`. Without noise, which is
drawn in float32, of which the last digit differs: see `tests/simulation/test_noise.py`.
"""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml

from evo_cpg.config.build import build_experiment
from evo_cpg.config.load import load_config
from evo_cpg.simulation.judge import JUDGE
from evo_cpg.simulation.noise import Noise
from evo_cpg.simulation.recording import Recorder
from evo_cpg.simulation.rollout import rollout

CONFIGS = Path(__file__).parents[2] / "configs"
# Those that evolve with noise have the animals of others.
EVERY = sorted(p.stem for p in CONFIGS.glob("*.yaml") if not p.stem.endswith("_robust"))
# In water with three of its ten bodies: the others compile longer. One step on the ground is
# compared in `tests/physics/test_walker_contacts.py`.
SMALL = pytest.param("iwadate2010_swimmer", ("creature.bodies.1.repeat=1",), id="three bodies")
LIFTING = (
    "creature.bodies.1.repeat=1",
    "creature.bodies.1.shape.size.1=0.02",
    "world.water.surface=0.02",
    "world.water.viscosity=0.001",
    "world.water.lift=true",
)
STEPS, INDIVIDUALS = 3, 2

# Two ways to round are 2e-16 apart in every operation, and what touches the ground multiplies that
# by thousands. Found were up to 1e-14 in water and 9e-13 on the ground, of the largest number. What
# is left of equations that are solved is itself such a difference: its measure is the equations'
# terms, which are 1 in its unit.
TOLERANCE = 1e-11
RESIDUALS = ("solved_residual", "coulomb_residual")


def trial(name, overrides, engine):
    """What a short trial of some individuals comes to, and the recording of one."""
    path = CONFIGS / f"{name}.yaml"
    config = load_config(path, [f"engine={engine}", *overrides])
    simulation = build_experiment(config, path).simulation
    simulation = dataclasses.replace(simulation, steps=STEPS, noise=Noise())
    keys = jax.random.key_data(jax.random.split(jax.random.key(1), INDIVIDUALS)).T
    genes = simulation.genome.random(jax.random.key(0), (INDIVIDUALS,), jnp.float64)
    both = JUDGE, Recorder(full=True)
    live = jax.jit(lambda genes, keys: rollout(simulation, genes, keys, observers=both))
    outcome, frames = jax.device_get(live(genes, keys))
    assert outcome.alive.all()
    return {**outcome.terms, **frames}


@pytest.mark.parametrize(
    ("name", "overrides"),
    [
        SMALL,
        pytest.param(SMALL.values[0], LIFTING, id="lift", marks=pytest.mark.slow),
        *[pytest.param(name, (), id=name, marks=pytest.mark.slow) for name in EVERY],
    ],
)
def test_the_same_trial_with_native_code_and_without(x64, name, overrides):
    found, wanted = (trial(name, overrides, engine) for engine in ("native", "jax"))
    assert found.keys() == wanted.keys()
    assert np.abs(np.diff(wanted["joint_angle"], axis=0)).max() > 1e-6
    for key, values in wanted.items():
        size = 1.0 if key in RESIDUALS else np.abs(values).max(initial=0.0)
        np.testing.assert_allclose(
            found[key], values, rtol=0, atol=TOLERANCE * size, strict=True, err_msg=key
        )


def test_every_shipped_creature_lives_in_one_of_them():
    configs = [yaml.safe_load(path.read_text()) for path in CONFIGS.glob("*.yaml")]
    creatures = {f"creatures/{path.name}" for path in (CONFIGS / "creatures").glob("*.yaml")}
    used = [config["creature"] for config in configs]
    assert creatures == {each["file"] if isinstance(each, dict) else each for each in used}
