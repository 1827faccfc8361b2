"""Trials of every shipped config with native code and with plain JAX, in float64.

Both engines must agree. `test_shipped_configs` compares single and many steps. Noise is off,
because it is drawn in float32 and differs in the last digit (`tests/simulation/test_noise.py`).
"""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml

from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import load_config
from evo_cpg.simulation.judge import JUDGE
from evo_cpg.simulation.noise import Noise
from evo_cpg.simulation.recording import Recorder
from evo_cpg.simulation.rollout import rollout
from tiny_run import VISCOUS

CONFIGS = Path(__file__).parents[2] / "configs"
# The robust configs have the creatures of other configs.
EVERY = sorted(p.stem for p in CONFIGS.glob("*.yaml") if not p.stem.endswith("_robust"))
# A swimmer with three of its ten bodies. The other configs compile longer.
# `tests/physics/test_walker_contacts.py` compares one step on the ground.
SMALL = pytest.param("iwadate2010_swimmer", ("creature.bodies.1.repeat=1",), id="three bodies")
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
STEPS, INDIVIDUALS = 3, 2

# Roundings differ by 2e-16 in every operation, and contact multiplies that by thousands. Measured
# differences were up to 1e-14 of the largest number in water and 9e-13 on the ground. The residual
# of solved equations is itself such a difference. Its scale is the equations' terms, which are 1.
# The cosine of an animal that swims level is a rounding, too.
TOLERANCE = 1e-11
OF_SCALE_1 = ("solved_residual", "coulomb_residual", "sense.vertical_cosine")


def trial(name, overrides, engine):
    """Return the results of a short trial of some individuals, and the recording of one."""
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
        pytest.param(SMALL.values[0], SHEDDING, id="reactive thrust", marks=pytest.mark.slow),
        pytest.param(SMALL.values[0], LIFTING, id="lift", marks=pytest.mark.slow),
        *[pytest.param(name, (), id=name, marks=pytest.mark.slow) for name in EVERY],
    ],
)
def test_native_code_and_jax_give_the_same_trial(x64, name, overrides):
    found, expected = (trial(name, overrides, engine) for engine in ("native", "jax"))
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
    used = [config["creature"] for config in configs]
    assert creatures == {each["file"] if isinstance(each, dict) else each for each in used}
