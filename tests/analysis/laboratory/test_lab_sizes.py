"""Creatures of other sizes in the laboratory: joints and tendons that slide, against similarity."""

import copy
import dataclasses

import jax
import numpy as np
import pytest
from swimmer import SWIMMER, subject

from benchmarks.imported_models import accelerations
from evo_cpg.analysis.laboratory.bodies import config_of
from evo_cpg.creature.creature import NO_LIMIT
from evo_cpg.creature.tree import Tree, build_tree
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.joint_torque import MotorCommand
from evo_cpg.physics.tree.state import resting_state

# A slide with a servo and a turning axis with a torque motor in one joint, a slide alone, and a
# tendon over a slide and a turning axis with a motor of its own.
MIXED = {
    "axes": [{"slide": "x", "limits_m": [-0.1, 0.2], "rest_m": 0.05}, "z"],
    "limits_deg": None,
    "stiffness": 3.0,
    "damping": [0.2, 0.3],
    "armature": 0.1,
    "friction_loss": 0.4,
    "actuator": [
        {"gain": 0.5, "stiffness": 2.0, "torque_limit": 0.3},
        {"type": "torque", "gear": 2.0},
    ],
}
ALONE = {"axes": [{"slide": "y", "limits_m": None}], "limits_deg": None, "stiffness": 4.0}
TENDON = {
    "name": "cord",
    "joints": {"end.slide_y": 1.0, "tail{i}.z": 0.05},
    "stiffness": 5.0,
    "rest": 0.02,
    "limits": [-0.1, 0.3],
    "damping": 0.1,
    "armature": 0.2,
    "friction_loss": 0.3,
    "actuator": {"type": "torque", "gear": 1.5, "torque_limit": 0.2},
}


@pytest.fixture(scope="module")
def tree_of(tmp_path_factory):
    """Build the animal at a size."""
    data = copy.deepcopy(SWIMMER)
    bodies = data["creature"]["bodies"]
    bodies[1]["repeat"] = 1
    bodies[1]["joint"] |= MIXED
    bodies.append(bodies[1] | {"name": "end", "joint": bodies[1]["joint"] | {"parent": "head"}})
    del bodies[2]["repeat"]
    bodies[2]["joint"] = {k: v for k, v in bodies[2]["joint"].items() if k not in MIXED} | ALONE
    data["creature"]["tendons"] = [TENDON]
    animal = subject(tmp_path_factory.mktemp("cart"), data)

    def call(size: float) -> Tree:
        config = config_of(animal.config, animal.source, {"size": size})
        return build_tree(config.creature.build())

    return call


def units(tree: Tree, size: float) -> np.ndarray:
    return np.where(tree.slides, size, 1.0)[:, None]


def similar_accelerations(tree: Tree, size: float) -> np.ndarray:
    """Return accelerations in similar states: per length of the animal, without gravity."""
    rng = np.random.default_rng(0)
    q, qd, rate, angle, output = rng.normal(size=(5, tree.dof_count, 20))
    own = units(tree, size)
    assert tree.torque_motors and tree.tendons and tree.tendons.torque_motors
    gear = np.array(tree.torque_motors.gear)
    gear[list(tree.tendons.channels)] = tree.tendons.torque_motors.gear
    with jax.enable_x64(True):
        rest = resting_state(tree, dtype=float, batch=(20,))
        state = dataclasses.replace(rest, q=q * own, qd=qd * own)
        command = MotorCommand(rate * own, angle * own, torque=output * gear[:, None])
        found = np.asarray(accelerations(World(tree, 0.0), state, command))
    return found / np.concatenate([np.ones((3, 1)), np.full((3, 1), size), own])


@pytest.mark.slow
def test_slides_and_tendons_move_similarly_in_all_sizes(tree_of):
    expected = similar_accelerations(tree_of(1.0), 1.0)
    for size in (0.5, 3.0):
        found = similar_accelerations(tree_of(size), size)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_limits_and_dry_friction_of_slides_grow_like_the_animal(tree_of):
    """The deceleration by dry friction per length is equal in all sizes."""
    one, three = tree_of(1.0), tree_of(3.0)
    for laws, other in ((one, three), (one.tendons, three.tendons)):
        sliding = laws.slides if isinstance(laws, Tree) else np.array([True])
        own = np.where(sliding, 3.0, 1.0)
        limited = laws.upper < NO_LIMIT
        assert limited.any()
        np.testing.assert_allclose((other.upper / own)[limited], laws.upper[limited], rtol=1e-12)
        rubbed = [each.dry_friction for each in (laws, other) if each.dry_friction]
        slowed = [friction.loss / friction.inertia for friction in rubbed]
        np.testing.assert_allclose(slowed[1] / own, slowed[0], rtol=1e-9)
