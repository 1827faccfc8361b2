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
    with pytest.raises(EditError, match="'fly': choose rest or drive"):
        simulate(animal(), HERE, "fly")  # pyright: ignore[reportArgumentType]


@pytest.mark.slow
def test_a_resting_animal_falls_freely():
    """Without water and ground, z = -g t^2 / 2, to the error of the time step, g h t / 2."""
    made = simulate(animal(water=None), HERE, "rest")
    assert made["names"] == ["a", "b"] and made["count"] >= SECONDS * RATE - 2
    place = places(made)
    time = np.arange(made["count"]) / made["rate"]
    fallen = place[0, 0, 2] - place[:, 0, 2]
    np.testing.assert_allclose(fallen, 9.81 / 2 * (time + 1 / 60) ** 2, rtol=0.02, atol=0.2)


@pytest.mark.slow
def test_on_the_ground_a_drive_bends_the_spine():
    walker = animal(water=None, ground={})
    joint = walker["creature"]["bodies"][1]["joint"]
    # An oscillator alone is at rest, and two are not.
    tail = {"name": "c", "shape": {"type": "sphere", "radius": 0.05}, "material": "m"}
    walker["creature"]["bodies"].append(tail | {"joint": joint | {"parent": "b"}})
    made = simulate(walker, HERE, "drive")
    driven = places(made)
    between = driven[:, 0] - driven[:, 1]
    angle = np.unwrap(np.arctan2(between[:, 1], between[:, 0]))
    assert np.ptp(angle) > 0.05 and "light" not in made


def with_arms(**water: list[float]) -> dict:
    """An animal with an arm on each side."""
    made, shape = animal(water=water), {"type": "box", "size": [0.15, 0.05, 0.02]}
    place = {"parent": "a", "at": [0, 0.04, 0], "child_at": [-0.07, 0, 0], "axes": ["y", "z"]}
    joint = place | {"rotation_deg": [0, 0, 90], "limits_deg": [-45, 45]}
    arm = {"name": "{side}_arm", "shape": shape, "material": "m", "mirror": "y"}
    made["creature"]["bodies"].append(arm | {"joint": joint | {"actuator": {"gain": 2.0}}})
    return made


@pytest.mark.slow
def test_an_animal_swims_to_its_light():
    made = simulate(with_arms() | {"task": {"light": {"distance": 1.5}}}, HERE, "drive")
    light, centre = np.array(made["light"]), places(made).mean(1)
    np.testing.assert_allclose(np.linalg.norm(light), 1.5)
    distance = np.linalg.norm(centre - light, axis=1)
    assert distance[-1] < 0.8 * distance[0]


@pytest.mark.slow
def test_a_program_of_its_own_swims_alike():
    """A current that is too slow to be seen changes only the program."""
    drifting = with_arms(current=[1e-9, 0, 0])
    common, own = (simulate(x, HERE, "drive") for x in (with_arms(), drifting))
    # The light is five lengths away.
    assert common["light"] == own["light"]
    np.testing.assert_allclose(np.linalg.norm(own["light"]), 5 * 0.4, rtol=0.05)
    there, here = places(common)[:15], places(own)[:15]
    assert np.abs(here[-1] - here[0]).max() > 0.05
    np.testing.assert_allclose(there, here, atol=1e-4)
