"""Cores as devices."""

import jax

from evo_cpg.training.devices import population_mesh, use_cores


def test_the_population_is_sharded_over_as_many_devices_as_asked():
    assert population_mesh(1).size == 1
    assert population_mesh().size == len(jax.devices()) == 2


def test_once_jax_runs_the_devices_are_what_they_are():
    """A second run folder that is opened in one process may have had others."""
    here = jax.local_device_count()
    assert use_cores(here + 5) == here
