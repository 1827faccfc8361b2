"""The compiler option without which everything is several times slower."""

import jax
import jax.numpy as jnp
import pytest

from evo_cpg.training import devices
from evo_cpg.training.devices import COMPILER_OPTIONS, fast_jit, population_mesh


@pytest.fixture
def asked_anew():
    """Let JAX be asked again which options it knows, now and afterwards."""
    devices._supported_options.cache_clear()
    yield
    devices._supported_options.cache_clear()


def test_this_jax_knows_the_option(asked_anew):
    assert devices._supported_options() == COMPILER_OPTIONS


def test_a_jax_that_does_not_know_it_is_warned_about_and_still_runs(asked_anew, monkeypatch):
    monkeypatch.setattr(devices, "COMPILER_OPTIONS", {"xla_cpu_no_such_option": ""})
    with pytest.warns(UserWarning, match=r"does not know \['xla_cpu_no_such_option'\]"):
        doubled = fast_jit(lambda x: 2 * x)
    assert float(doubled(jnp.float32(3))) == 6.0


def test_the_population_is_sharded_over_as_many_devices_as_asked():
    assert population_mesh(1).size == 1
    assert population_mesh().size == len(jax.devices()) == 2
