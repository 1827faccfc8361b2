"""Double precision, as in MuJoCo, and compiled models."""

import jax
import mujoco
import pytest

from evo_cpg.io.models.mjcf_export import mjcf_model, mjcf_text
from evo_cpg.io.models.mjcf_import import read_model


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


@pytest.fixture
def compiled():
    """Export a creature with arguments of `mjcf_model`, and compile it with MuJoCo."""

    def make(*arguments, **options) -> mujoco.MjModel:
        return mujoco.MjModel.from_xml_string(mjcf_text(mjcf_model(*arguments, **options)))

    return make


@pytest.fixture
def write(tmp_path):
    """Write a model."""

    def call(text: str):
        path = tmp_path / "model.xml"
        path.write_text(text, encoding="utf-8")
        return path

    return call


@pytest.fixture
def read(write):
    """Import a model from text."""
    return lambda text, **options: read_model(write(text), **options)
