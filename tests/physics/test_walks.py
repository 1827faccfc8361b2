"""Trees whose parents are numbers, beside the same trees with known parents."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import quick_jit, random_creature, random_state
from evo_cpg.creature.algebra.linear import expand_dims_like
from evo_cpg.creature.tree import Group, Tree, build_tree
from evo_cpg.creature.walk import walk_of, walk_order
from evo_cpg.physics.step.equations import body_equations
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.articulated import solve
from evo_cpg.physics.tree.generalized import (
    body_accelerations,
    generalized_equations,
    generalized_force,
)
from evo_cpg.physics.tree.kinematics import kinematics, motion_of_bodies
from evo_cpg.physics.tree.spatial_algebra import Wrench

OF_BODIES = ("joint_offset", "joint_orientation", "mass", "volume", "com", "inertia")


def walked(tree: Tree) -> tuple[Tree, np.ndarray, np.ndarray]:
    """Return a tree with a walk, and its bodies and degrees of freedom in the order of the walk."""
    order, slots = map(np.asarray, walk_order(jnp.array(tree.parents)))
    place = np.argsort(order)
    parents = [-1, *(place[tree.parents[body]] for body in order[1:])]
    of_body = {
        body: (group, group.dofs.start + (body - group.bodies.start) * group.axes)
        for group in tree.groups
        for body in range(group.bodies.start, group.bodies.stop)
    }
    groups, dofs = [], []
    for place, body in enumerate(order[1:], 1):
        group, start = of_body[body]
        own = slice(len(dofs), len(dofs) + group.axes)
        dofs += range(start, start + group.axes)
        groups.append(
            Group(slice(place, place + 1), own, group.axes, (0,), group.kind, group.kinds)
        )
    moved = {name: getattr(tree, name)[..., order] for name in OF_BODIES}
    found = dataclasses.replace(
        tree,
        **moved,
        groups=tuple(groups),
        joint_axes=tree.joint_axes[:, dofs],
        armature=tree.armature[np.array(dofs)],
        dof_bodies=tuple(i for i, group in enumerate(groups, 1) for _ in range(group.axes)),
        walk=jax.tree.map(np.asarray, walk_of(jnp.array(parents), jnp.array(slots), np.ones(0))),
    )
    return found, order, np.array(dofs)


def results(tree: Tree, state, torque, y, push) -> tuple:
    """Return accelerations by two algorithms, the mass matrix, motion, and a generalized force."""
    kin = kinematics(tree, state)
    inertia, bias = body_equations(World(tree, 9.81), kin, 0.0)
    given = tree, kin, inertia, bias, torque, expand_dims_like(tree.armature, torque)
    matrix, force = generalized_equations(*given)
    moving = motion_of_bodies(tree, kin, y[:6], y[6:])
    wrench = generalized_force(tree, kin, Wrench(push[:3], push[3:]))
    return (
        jnp.concatenate(solve(*given)),
        matrix,
        force,
        body_accelerations(tree, kin, y),
        moving,
        (wrench),
    )


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_any_parents_give_the_motion_of_the_known_tree(seed):
    with jax.enable_x64(True):
        rng = np.random.default_rng(seed)
        structure = tuple(
            (int(rng.integers(max(0, i - 4 - 3 * seed), i)), int(rng.integers(0, 4)))
            for i in range(1, 11)
        )
        tree = build_tree(random_creature(rng, structure))
        other, bodies, dofs = walked(tree)
        state = random_state(tree, rng)
        torque, y = rng.normal(size=tree.dof_count), rng.normal(size=6 + tree.dof_count)
        push = rng.normal(size=(6, tree.body_count))
        v = np.concatenate([np.arange(6), 6 + dofs])
        expected = quick_jit(lambda *x: results(tree, *x))(state, torque, y, push)
        moved = dataclasses.replace(state, q=state.q[dofs], qd=state.qd[dofs])
        found = quick_jit(lambda *x: results(other, *x))(moved, torque[dofs], y[v], push[:, bodies])
        free, matrix, force, accelerations, moving, wrench = expected
        expected = free[v], matrix[v][:, v], force[v], *(x[:, bodies] for x in accelerations)
        expected += (*(x[:, bodies] for x in moving), wrench[v])
        for one, same in zip(jax.tree.leaves(found), expected, strict=True):
            np.testing.assert_allclose(one, same, rtol=1e-9, atol=1e-9 * np.abs(same).max())
