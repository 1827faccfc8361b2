"""Plans in one program, beside their own creatures, which have programs of their own."""

import dataclasses
import functools

import jax
import numpy as np
import pytest

from plans import LAND, WATER, motion_of, own_motion, plans_of, random_genes

# Places of bodies agree to some roundings of 1e-16, and contacts enlarge them.
TOLERANCE = 1e-9
# World, seconds, number of plans, and settings of the plans.
CASES = {
    "water": (WATER, 1.0, {"bodies": 6}),
    "land": (LAND, 0.25, {"bodies": 4, "density": 500.0}),
    "body brain": (
        WATER,
        0.25,
        {"bodies": 6, "eyes": True, "controller": {"type": "body_brain"}, "lit": True},
    ),
    "muscles": (WATER, 1.0, {"bodies": 4, "joints": ["hinge", "ball"], "actuator": "muscle"}),
}
SLOW = {
    "water": (WATER, 1.0, {"bodies": 12, "joints": ["hinge", "universal", "ball"]}),
    # Creatures whose limbs stay in a plane have contact laws of their own.
    "land": (LAND, 0.25, {"bodies": 8, "density": 500.0, "joints": ["universal", "ball"]}),
}


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


@functools.cache
def prepared(case: str, count: int, slow: bool):
    """Return the builder of plans, genes, numbers and the compiled program of a case."""
    world, seconds, settings = (SLOW if slow else CASES)[case]
    plans = plans_of(world, seconds=seconds, **settings)
    genes = random_genes(plans, count)
    return plans, genes, plans.developed(genes), motion_of(plans, plans.sizes[-1])


def differences(plans, genes, frames) -> tuple[float, float]:
    """Return the largest difference and the largest change of the places of bodies, m."""
    own, simulation = own_motion(plans, genes)
    found = plans.frames_of(simulation, frames)
    assert found["position"].shape == own["position"].shape
    apart = np.abs(found["position"] - own["position"]).max((1, 2, 3))
    turned = np.abs(found["rotation"] - own["rotation"]).max((1, 2, 3, 4))
    apart = np.maximum(apart, turned * np.abs(simulation.world.tree.com).max())
    change = np.ptp(own["position"], axis=0).max()
    return apart.max(), change


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "count", "slow"),
    [
        ("water", 3, False),
        ("muscles", 3, False),
        ("body brain", 3, False),
        ("land", 2, False),
        ("water", 50, True),
        ("land", 50, True),
    ],
)
def test_plans_move_as_their_own_creatures(case, count, slow):
    """All bodies of random plans have the same poses in all control steps."""
    plans, genes, found, run = prepared(case, count, slow)
    frames = run(found, np.arange(count))
    moved = []
    for i in range(count):
        own = {name: values[..., i : i + 1] for name, values in frames.items()}
        apart, change = differences(plans, genes[:, i], own)
        assert apart < TOLERANCE, i
        moved.append(change)
    assert np.median(moved) > 5e-3


@pytest.mark.slow
def test_the_comparison_can_fail():
    """An axis of a mirrored body that turns the other way round moves bodies by far more."""
    plans, genes, found, run = prepared("water", 3, False)
    count, control, numbers = found
    turns = numbers.walk.turns
    i = np.flatnonzero((turns < 0).any(0))[0]
    walk = dataclasses.replace(numbers.walk, turns=np.abs(turns))
    frames = run((count, control, numbers._replace(walk=walk)), np.array([i]))
    assert differences(plans, genes[:, i], frames)[0] > 1e-4
