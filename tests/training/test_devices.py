"""Cores as devices."""

import jax

from evo_cpg.training.devices import population_mesh


def test_the_population_is_sharded_over_as_many_devices_as_asked():
    assert population_mesh(1).size == 1
    assert population_mesh().size == len(jax.devices()) == 2
