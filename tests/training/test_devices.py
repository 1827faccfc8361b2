"""Cores as devices."""

import jax

from evo_cpg.training.devices import population_mesh, use_cores


def test_the_mesh_has_the_requested_number_of_devices():
    assert population_mesh(1).size == 1
    assert population_mesh().size == len(jax.devices())


def test_devices_stay_after_jax_has_run():
    """A process may open a second run folder that was made with other devices."""
    here = jax.local_device_count()
    assert use_cores(here + 5) == here
