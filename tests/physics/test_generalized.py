"""Generalized coordinates of random trees.

The articulated-body algorithm solves these equations without a matrix, and `test_accelerations.py`
compares it with MuJoCo. Energy and power do not depend on coordinates.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import STRUCTURES, quick_jit, random_creature, random_state
from evo_cpg.creature.tree import build_tree
from evo_cpg.physics.step.equations import body_equations
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.articulated import solve
from evo_cpg.physics.tree.generalized import body_accelerations, generalized_force, mass_matrix
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.root import ROOT_DOFS
from evo_cpg.physics.tree.spatial_algebra import Wrench

GRAVITY = 9.81


@pytest.fixture(
    scope="module",
    params=[*(pytest.param(STRUCTURES[i], marks=pytest.mark.slow) for i in (1, 3)), STRUCTURES[5]],
    ids=str,
)
def found(request):
    """Return a tree and its tested quantities at a random state, under random loads."""
    with jax.enable_x64(True):
        rng = np.random.default_rng(3)
        tree = build_tree(random_creature(rng, request.param))
        state = random_state(tree, rng, (1,))
        torque = jnp.asarray(rng.normal(size=(tree.dof_count, 1)))
        load = [jnp.asarray(rng.normal(size=(3, len(tree.names), 1))) for _ in range(2)]

        def everything(state, torque, load):
            kin = kinematics(tree, state)
            inertia, bias = body_equations(World(tree, GRAVITY), kin, 0.0)
            bias = Wrench(bias.moment - load.moment, bias.force - load.force)
            least = jnp.full_like(torque, 1e-3)
            by_bodies = solve(tree, kin, inertia, bias, torque, least)
            M = mass_matrix(tree, kin, inertia)
            velocity = jnp.concatenate([state.velocity, state.qd])
            return {
                "kin": kin,
                "inertia": inertia,
                "y": jnp.concatenate([by_bodies.root, by_bodies.qdd]),
                "M": M,
                "force": generalized_force(tree, kin, Wrench(-bias.moment, -bias.force)),
                "load": generalized_force(tree, kin, load),
                "velocity": velocity,
                "moves": body_accelerations(tree, kin, velocity),
            }

        result = quick_jit(everything)(state, torque, Wrench(*load))
        yield torque, load, jax.tree.map(lambda x: np.asarray(x)[..., 0], result)


def test_equations_agree_with_the_articulated_bodies(found):
    """``M y = f`` holds to 1e-10 of the largest force."""
    torque, _, it = found
    M = it["M"] + np.diag(np.r_[np.zeros(ROOT_DOFS), np.full(len(torque), 1e-3)])
    expected = it["force"] + np.r_[np.zeros(ROOT_DOFS), np.asarray(torque)[:, 0]]
    assert np.abs(M @ it["y"] - expected).max() < 1e-10 * np.abs(expected).max()


def test_mass_matrix_is_symmetric_and_gives_the_energy(found):
    _, _, it = found
    np.testing.assert_allclose(it["M"], it["M"].T, rtol=0, atol=1e-12 * np.abs(it["M"]).max())
    angular, linear = it["kin"].angular, it["kin"].linear
    energy = sum(
        w @ angular_block @ w + 2 * w @ mixed @ v + v @ linear_block @ v
        for w, v, angular_block, mixed, linear_block in zip(
            angular.T, linear.T, *(np.moveaxis(x, -1, 0) for x in it["inertia"]), strict=True
        )
    )
    assert it["velocity"] @ it["M"] @ it["velocity"] == pytest.approx(energy, rel=1e-12)


def test_jacobians_give_the_velocities_of_kinematics(found):
    """The Jacobians times the velocities of root and joints are the body velocities."""
    _, _, it = found
    np.testing.assert_allclose(it["moves"].angular, it["kin"].angular, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(it["moves"].linear, it["kin"].linear, rtol=1e-12, atol=1e-13)


def test_generalized_loads_have_the_power_of_body_loads(found):
    _, (moment, force), it = found
    power = (np.asarray(moment)[..., 0] * it["kin"].angular).sum()
    power += (np.asarray(force)[..., 0] * it["kin"].linear).sum()
    assert it["load"] @ it["velocity"] == pytest.approx(power, rel=1e-12)
