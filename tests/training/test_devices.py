"""Cores as devices."""

import jax

from evo_cpg.training.devices import use_cores


def test_devices_stay_after_jax_has_run():
    """A process may open a second run folder that was made with other devices."""
    here = jax.local_device_count()
    assert use_cores(here + 5) == here
