"""Tries without evolution: what is simulated, and what is refused."""

import base64
from pathlib import Path

import numpy as np
import pytest

from evo_cpg.view.drawing_page.document import EditError
from evo_cpg.view.drawing_page.runs import RATE, SECONDS, simulate

HERE = Path("animal.yaml")


def animal(**world) -> dict:
    """Two bodies, with a walker's settings that a try does not use."""
    joint = {"parent": "a", "at": [-0.1, 0, 0], "child_at": [0.1, 0, 0], "axes": ["z"],
             "actuator": {"gain": 10}}  # fmt: skip
    shape = {"type": "box", "size": [0.2, 0.1, 0.1]}
    bodies = [
        {"name": "a", "shape": shape, "material": "m"},
        {"name": "b", "shape": shape, "material": "m", "joint": joint},
    ]
    return {
        "name": "animal",
        "creature": {"name": "x", "materials": {"m": {"density": 1000}}, "bodies": bodies},
        "world": world,
        "controller": {"type": "postures", "postures": 4},
        "evolution": {"type": "bits"},
    }


def places(made: dict) -> np.ndarray:
    values = np.frombuffer(base64.b64decode(made["place"]), "<f4")
    return values.reshape(made["count"], len(made["names"]), 3)


def test_a_try_that_shows_nothing_is_refused():
    lonely = animal()
    del lonely["creature"]["bodies"][1]
    with pytest.raises(EditError, match="a body without joints has nothing to try"):
        simulate(lonely, HERE, "rest")
    with pytest.raises(EditError, match="'fly': choose rest or rhythm"):
        simulate(animal(), HERE, "fly")  # pyright: ignore[reportArgumentType]


@pytest.mark.slow
def test_a_resting_animal_falls_freely_and_a_driven_one_bends():
    """Without water and ground, z = -g t^2 / 2, to the error of the time step, g h t / 2."""
    made = simulate(animal(water=None), HERE, "rest")
    assert made["names"] == ["a", "b"] and made["count"] >= SECONDS * RATE - 2
    place = places(made)
    time = np.arange(made["count"]) / made["rate"]
    fallen = place[0, 0, 2] - place[:, 0, 2]
    np.testing.assert_allclose(fallen, 9.81 / 2 * (time + 1 / 60) ** 2, rtol=0.02, atol=0.2)
    swimmer = animal(water={"density": 1000})
    joint = swimmer["creature"]["bodies"][1]["joint"]
    # An oscillator alone is at rest, and two are not.
    tail = {"name": "c", "shape": {"type": "sphere", "radius": 0.05}, "material": "m"}
    swimmer["creature"]["bodies"].append(tail | {"joint": joint | {"parent": "b"}})
    driven = places(simulate(swimmer, HERE, "rhythm"))
    between = driven[:, 0] - driven[:, 1]
    angle = np.unwrap(np.arctan2(between[:, 1], between[:, 0]))
    assert np.ptp(angle) > 0.05 and np.abs(driven[..., 2] - driven[0, 0, 2]).max() < 1e-3
