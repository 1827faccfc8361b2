"""Accelerations of random branching trees against MuJoCo's.

MuJoCo 3's C library solves these rigid-body equations by another algorithm in other coordinates:
the composite rigid-body algorithm and a factorised mass matrix.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from benchmarks.mujoco_model import mujoco_model
from creatures import STRUCTURES, mujocos_accelerations, quick_jit, random_creature, random_state
from evo_cpg.creature.algebra.linear import expand_dims_like
from evo_cpg.creature.tree import Tree, build_tree
from evo_cpg.physics.step.equations import body_equations
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.articulated import solve
from evo_cpg.physics.tree.generalized import generalized_equations
from evo_cpg.physics.tree.joint_torque import passive_torque
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import State

GRAVITY = 9.81
TREES_PER_STRUCTURE = 9

# Arrays that differ between trees of one structure and equal joint axes. A compiled function can
# take them as arguments.
PARAMETERS = (
    "joint_offset",
    "mass",
    "volume",
    "com",
    "inertia",
    "stiffness",
    "damping",
    "armature",
)


def parameters(tree: Tree) -> list:
    """Return the arrays of a tree named by `PARAMETERS`."""
    return [getattr(tree, name) for name in PARAMETERS]


def dry_accelerations(tree: Tree, state: State, tau) -> jax.Array:
    """Return accelerations of the root (angular, then linear) and the joints, without a step."""
    return jnp.concatenate(solve(*equations_of(tree, state, tau)))


def equations_of(tree: Tree, state: State, tau) -> tuple:
    """Return the arguments of `solve` and of `generalized_equations`, without a step."""
    kin = kinematics(tree, state)
    inertia, bias = body_equations(World(tree, GRAVITY), kin, 0.0)
    passive, derivative = passive_torque(tree, state, 0.0)
    rotor = derivative + expand_dims_like(tree.armature, tau)
    return tree, kin, inertia, bias, tau + passive, rotor


def relative_errors(number: int, dtype, stiffer: float = 1.0) -> list[float]:
    """Return errors relative to MuJoCo's largest acceleration, for trees of one structure."""
    first = build_tree(
        random_creature(np.random.default_rng(0), STRUCTURES[number], axes_seed=number)
    )

    @quick_jit
    def accelerations(values, state, tau):
        return dry_accelerations(eqx.tree_at(parameters, first, values), state, tau)

    errors = []
    for seed in range(TREES_PER_STRUCTURE):
        rng = np.random.default_rng([number, seed])
        creature = random_creature(rng, STRUCTURES[number], axes_seed=number)
        tree = build_tree(creature)
        state = random_state(tree, rng)
        tau = rng.normal(size=tree.dof_count)

        model = mujoco_model(creature)
        theirs = mujocos_accelerations(model, mujoco.MjData(model), tree, state, tau)

        tree = eqx.tree_at(lambda t: t.stiffness, tree, stiffer * tree.stiffness)
        ours = accelerations(
            parameters(tree),
            jax.tree.map(lambda x: x.astype(dtype), state),
            jnp.asarray(tau, dtype),
        )
        assert ours.dtype == dtype
        errors.append(np.abs(ours - theirs).max() / np.abs(theirs).max())
    return errors


# The fast tests compare the smallest structure, the chain and the mixture with most bodies.
@pytest.mark.parametrize(
    "number",
    [
        pytest.param(number, marks=[] if number in (0, 3) else pytest.mark.slow)
        for number in range(len(STRUCTURES))
    ],
)
def test_random_trees_accelerate_as_in_mujoco(number):
    """Compare 54 trees with all shapes, joints of 1 to 3 axes, springs, dampers and rotors.

    The tolerance is 1e-9 of the largest acceleration. The roundings of both sides give 1e-12.
    """
    assert max(relative_errors(number, jnp.float64)) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("number", [1, 3])
def test_float32_keeps_four_digits(number):
    """In float32 the tolerance is 2e-4 of the largest acceleration.

    The error is some 1e3 roundings of 6e-8 in systems of condition 1e2 to 1e3. The largest error of
    the 54 trees is 5e-5, in the structure asserted here, whose joints have three axes.
    """
    assert max(relative_errors(number, jnp.float32)) < 2e-4


def test_the_comparison_can_fail():
    """Springs that are 1 % stiffer exceed the tolerance by far."""
    assert min(relative_errors(0, jnp.float64, stiffer=1.01)) > 1e-7


@pytest.mark.parametrize("number", [0, pytest.param(3, marks=pytest.mark.slow)])
@pytest.mark.parametrize("held", [False, pytest.param(True, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_derivatives_equal_those_of_the_dense_equations(number, held):
    """Compare both modes with derivatives of the mass matrix and of a dense solution."""
    rng = np.random.default_rng(number)
    tree = build_tree(random_creature(rng, STRUCTURES[number], axes_seed=number))
    state, free = random_state(tree, rng), slice(6 if held else 0, None)
    direction = rng.normal(size=6 + tree.dof_count)[free]

    def ours(q, mass, tau):
        own = eqx.tree_at(lambda t: t.mass, tree, mass)
        given = equations_of(own, dataclasses.replace(state, q=q), tau)
        return jnp.concatenate(solve(*given, held=held))[free]

    def dense(q, mass, tau):
        own = eqx.tree_at(lambda t: t.mass, tree, mass)
        given = equations_of(own, dataclasses.replace(state, q=q), tau)
        matrix, force = generalized_equations(*given)
        return jnp.linalg.solve(matrix[free, free], force[free])

    at = state.q, jnp.asarray(tree.mass), rng.normal(size=tree.dof_count)
    tangents = tuple(jnp.asarray(rng.normal(size=x.shape)) for x in at)
    for differentiate in (
        lambda f: lambda *x: jax.vjp(f, *x)[1](direction),
        lambda f: lambda *x: jax.jvp(f, x, tangents),
    ):
        pairs = zip(*(quick_jit(differentiate(f))(*at) for f in (ours, dense)), strict=True)
        for one, other in pairs:
            np.testing.assert_allclose(one, other, rtol=1e-8, atol=1e-10 * np.abs(other).max())
