"""Any animal in one program, beside its own simulation."""

import copy
import dataclasses
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from evo_cpg.io.build import build_simulation
from evo_cpg.io.load import complete_config
from evo_cpg.simulation.any_animal import AnimalInputs
from evo_cpg.simulation.batched import BatchedSimulation
from evo_cpg.simulation.recording import Recorder
from evo_cpg.simulation.rollout import rollout
from evo_cpg.view.drawing_page.swim import star

HERE = Path("animal.yaml")
MUSCLE = {"type": "muscle", "area": 1e-4, "arm": 0.01, "fibre_length": 0.1}
BOX = {"type": "box", "size": [0.2, 0.06, 0.04]}


def part(name: str, parent: str, at: list[float], axes: list, **joint: Any) -> dict[str, Any]:
    """A box on a parent. Its joint is at its end, with a motor about each axis."""
    if axes:
        joint |= {"actuator": {"gain": 2.0}, "limits_deg": [-50, 40]}
    joint |= {"parent": parent, "at": at, "child_at": [0.1, 0, 0], "axes": axes}
    return {"name": name, "shape": BOX, "material": "flesh", "joint": joint}


def animal(*more: dict[str, Any]) -> dict[str, Any]:
    """An animal with a horn without a joint, and with axes in any directions."""
    trunk = {"type": "ellipsoid", "radii": [0.1, 0.05, 0.06]}
    spring = {"stiffness": 0.2, "damping": 0.1, "rest_deg": 20}
    return {
        "name": "animal",
        "creature": {
            "name": "animal",
            "materials": {"flesh": {"density": 900}},
            "bodies": [
                {"name": "trunk", "shape": trunk, "material": "flesh"},
                part("arm", "trunk", [0, 0.05, 0], ["z", [1, 1, 0]], **spring),
                part("horn", "trunk", [0, 0, 0.06], [], rotation_deg=[0, 40, 0]),
                *more,
            ],
        },
        "world": {"gravity": 5.0, "water": {"density": 1100, "form_drag": 0.8}},
        "controller": {"type": "body_brain"},
        "task": {"type": "reach_light", "light": {"distance": 2, "bearing_deg": 50}},
        "simulation": {"control_rate_hz": 60, "substeps": 4, "seconds": 0.25},
    }


def simulation_of(data: dict[str, Any]):
    return build_simulation(complete_config(data, HERE))[1]


@pytest.fixture(scope="module")
def inputs() -> AnimalInputs:
    return AnimalInputs(star(4))


def motion(simulation, genes: int) -> np.ndarray:
    """Return places of all bodies, then their axes."""
    recorder = Recorder(names=("position", "rotation"))
    run = jax.jit(lambda genes: rollout(simulation, genes, observers=recorder))
    frames = jax.tree.map(np.asarray, run(np.full((genes, 1), 0.5)))
    places, turns = frames["position"], frames["rotation"]
    return np.concatenate([places[:, :, None], turns.swapaxes(1, 2)], 2)[..., 0]


def compared(inputs: AnimalInputs, data: dict[str, Any]) -> None:
    """Compare the motion of an animal with that of its own simulation."""
    own = simulation_of(data)
    found = inputs.values(own)
    assert found is not None
    values, places = found
    common = dataclasses.replace(inputs.common, steps=own.steps)
    batch = BatchedSimulation(common, inputs, (values[:, None],))
    there = motion(batch, common.controller.gene_count)[..., places]
    alone = motion(own, own.controller.gene_count)
    assert np.abs(alone[-1] - alone[0]).max() > 0.05
    np.testing.assert_allclose(there, alone, atol=1e-9)


@pytest.mark.slow
def test_an_animal_moves_as_in_its_own_simulation(x64, inputs):
    compared(inputs, animal())


@pytest.mark.slow
def test_many_limbs_move_as_in_their_own_simulation(x64):
    limbs = [
        part("tail1", "trunk", [-0.1, 0, 0], ["-z"]),
        part("tail2", "tail1", [-0.1, 0, 0], ["y", "x", "-z"]),
        part("hand", "arm", [-0.1, 0, 0], ["x"]),
        part("finger1", "hand", [-0.1, 0, 0.01], [[1, 0, 1], "z"]),
        part("finger2", "hand", [-0.1, 0, -0.01], ["y"], rotation_deg=[0, -60, 0]),
    ]
    compared(AnimalInputs(star(11)), animal(*limbs))


def changed(**change: Any) -> dict[str, Any]:
    """Return the animal with changes of its arm's joint, or of the water."""
    data = copy.deepcopy(animal())
    joint = data["creature"]["bodies"][1]["joint"]
    for key, value in change.items():
        (data["world"]["water"] if key in ("surface", "current", "law") else joint)[key] = value
    return data


def long_animal() -> dict[str, Any]:
    data = animal()
    data["creature"]["bodies"][1] |= {"repeat": 3, "name": "arm{i}"}
    return data


def many_points() -> dict[str, Any]:
    data = animal()
    data["world"]["water"]["form_resolution"] = 12
    return data


@pytest.mark.parametrize(
    "data",
    [
        long_animal(),
        many_points(),
        changed(actuator=MUSCLE, rest_deg=0),
        changed(axes=[{"slide": "x"}], limits_deg=None),
        changed(actuator={"gain": 2.0, "torque_limit": 1.0}),
        changed(surface=0.0),
        changed(law="isotropic"),
        changed(current=[0.1, 0, 0]),
    ],
)
def test_other_animals_do_not_fit(inputs, data):
    assert inputs.values(simulation_of(data)) is None
