"""Warnings of a physics step that is too long, from trials of random individuals."""

import shutil

import pytest
import yaml

from evo_cpg.api.advice import is_light_in_water
from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import load_config
from tiny_run import REPOSITORY

STEADY = """
import jax
import jax.numpy as jnp
import evo_cpg as evo

class Steady(evo.Controller):
    gene_count = 1

    def random_genes(self, key, batch, dtype):
        return jax.random.uniform(key, (1, *batch), dtype)

    def initial_state(self, batch, dtype):
        return jnp.zeros(batch, dtype)

    def act(self, decoded, state, observation):
        rate = jnp.full_like(observation.joint_angle, 10.0)
        return state, evo.Command(target_rate=rate, signal=rate)
"""


def plates(thickness: float) -> str:
    """Return a swimmer of three plates that curls up, one physics step per control step."""
    shape = {"type": "box", "size": [0.1, thickness, 0.1]}
    joint = {"parent": "a", "at": [-0.05, 0, 0], "child_at": [0.05, 0, 0], "axes": ["z"],
             "actuator": {"gain": 10}}  # fmt: skip
    bodies = [
        {"name": "a", "shape": shape, "material": "m"},
        {"name": "b{i}", "repeat": 2, "shape": shape, "material": "m", "joint": joint},
    ]
    creature = {"name": "x", "materials": {"m": {"density": 1000}}, "bodies": bodies}
    water = {"viscosity": 1e-3, "reactive_thrust": True}
    return yaml.safe_dump(
        {"name": "x", "creature": creature, "world": {"water": water},
         "simulation": {"seconds": 2, "substeps": 1}, "controller": {"type": "steady:Steady"},
         "task": {"type": "distance"}, "evolution": {"population": 4, "elites": 1}}
    )  # fmt: skip


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "steady.py").write_text(STEADY)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
def test_thin_plates_get_a_number_of_substeps(cli, folder):
    (folder / "x.yaml").write_text(plates(0.0005))
    _, err = cli.passes("validate", "x.yaml")
    assert err == (
        "evo-cpg: warning: x.yaml: simulation.substeps: 1: 8 of 8 random individuals diverge "
        "within 2 s, because the physics step of 0.017 s is too long. With simulation.substeps: 2 "
        "none diverges\n"
    )
    drawn = "courses={draw: {simulation.start_heading_deg: [-90, 90]}}"
    for more in ((), (drawn,)):
        err = cli.refuses("train", "x.yaml", "evolution.generations=1", *more, "--out", "run")
        assert "all of generation 0 diverged. simulation.substeps: 1: 8 of 8 random" in err
        shutil.rmtree("run")


@pytest.mark.parametrize("name", ["eel", "fish", "salamander_swim", "hexapod"])
def test_shipped_animals_need_no_test_of_the_step(name):
    path = REPOSITORY / "configs" / f"{name}.yaml"
    assert not is_light_in_water(build_experiment(load_config(path), path).simulation)
