"""Accelerations of random branching trees against MuJoCo's.

MuJoCo 3's C library solves the same rigid-body equations by the composite rigid-body algorithm
and a factorised mass matrix, a different algorithm in different coordinates.
"""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from creatures import STRUCTURES, random_creature, random_state
from mujoco_model import dof_order, load_state, mujoco_model

from evo_cpg.creature.tree import build_tree
from evo_cpg.physics.articulated import solve
from evo_cpg.physics.joints import passive_torque
from evo_cpg.physics.kinematics import kinematics
from evo_cpg.physics.state import State
from evo_cpg.physics.step import World, body_equations
from evo_cpg.spatial.linear import lift

GRAVITY = 9.81
TREES_PER_STRUCTURE = 5


def relative_error(structure, seed, dtype) -> float:
    """Largest difference from MuJoCo over its largest acceleration (rad/s^2 or m/s^2)."""
    rng = np.random.default_rng(seed)
    creature = random_creature(rng, structure)
    tree = build_tree(creature)
    state = random_state(tree, rng)
    tau = rng.normal(size=tree.dof_count)

    model = mujoco_model(creature)
    data, order = mujoco.MjData(model), dof_order(model, tree)
    rotation = load_state(model, data, tree, state)
    data.qfrc_applied[6 + order] = tau
    mujoco.mj_forward(model, data)
    theirs = np.concatenate([rotation @ data.qacc[3:6], data.qacc[:3], data.qacc[6 + order]])

    state = jax.tree.map(lambda x: x.astype(dtype), state)
    ours = dry_accelerations(World(tree, GRAVITY), state, jnp.asarray(tau, dtype))
    assert ours.dtype == dtype
    return np.abs(ours - theirs).max() / np.abs(theirs).max()


def dry_accelerations(world: World, state: State, tau) -> jax.Array:
    """Root (angular, then linear of its centre) and joint accelerations without any step."""
    tree = world.tree
    kin = kinematics(tree, state)
    inertia, bias = body_equations(world, kin, 0.0)
    passive, derivative = passive_torque(tree, state, 0.0)
    result = solve(tree, kin, inertia, bias, tau + passive, derivative + lift(tree.armature, tau))
    linear = result.root[3:] + jnp.cross(state.velocity[:3], state.velocity[3:])
    return jnp.concatenate([result.root[:3], linear, result.qdd])


@pytest.mark.parametrize("number", range(len(STRUCTURES)))
def test_random_trees_accelerate_as_in_mujoco(number):
    """Fifty trees of all shapes, joints of 1 to 3 axes, springs, dampers and rotors, in float64.

    1e-9 of the largest acceleration is the contract; 3e-13 is what both sides' rounding gives.
    """
    seeds = [100 * number + k for k in range(TREES_PER_STRUCTURE)]
    errors = [relative_error(STRUCTURES[number], seed, jnp.float64) for seed in seeds]
    assert max(errors) < 1e-9, dict(zip(seeds, errors, strict=True))


@pytest.mark.parametrize("number", [1, 3, 6])
def test_float32_keeps_four_digits(number):
    """In float32 the same trees agree to TOL of the largest acceleration."""
    seeds = [100 * number + k for k in range(TREES_PER_STRUCTURE)]
    errors = [relative_error(STRUCTURES[number], seed, jnp.float32) for seed in seeds]
    assert max(errors) < 1e-3, dict(zip(seeds, errors, strict=True))


def test_the_comparison_can_fail():
    """A tree with one spring 1 % stiffer is told apart: the oracle is not blind."""
    rng = np.random.default_rng(7)
    creature = random_creature(rng, STRUCTURES[1])
    joint = creature.bodies[1].joint
    stiffer = dataclasses.replace(joint, stiffness=1.01 * joint.stiffness)
    bodies = list(creature.bodies)
    bodies[1] = dataclasses.replace(bodies[1], joint=stiffer)
    other = dataclasses.replace(creature, bodies=tuple(bodies))
    state = random_state(build_tree(creature), rng)
    tau = jnp.zeros(build_tree(creature).dof_count)
    first, second = (
        dry_accelerations(World(build_tree(c), GRAVITY), state, tau) for c in (creature, other)
    )
    assert np.abs(first - second).max() > 1e-6 * np.abs(first).max()
