"""The size of native code grows slowly with the number of bodies."""

import functools
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest

from benchmarks.growth import exponent
from benchmarks.large_bodies import walker
from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import complete_config
from evo_cpg.native.compile import optimize
from evo_cpg.native.frontend.primitives import fused_p
from evo_cpg.simulation.rollout import rollout

SOURCE = Path("walker.yaml")


def operations(legs):
    """Return the number of operations of a walker's trial, without compiling it."""
    config = complete_config(walker(legs, "capsule"), SOURCE)
    simulation = build_experiment(config, SOURCE).simulation
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
