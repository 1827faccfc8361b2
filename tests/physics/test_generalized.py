"""Generalized coordinates of random trees. Energy and power do not depend on coordinates.

`test_joint_kinds.py` and `test_hanging_roots.py` compare the equations with MuJoCo.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import STRUCTURES, quick_jit, random_creature, random_state
from evo_cpg.creature.tree import build_tree
from evo_cpg.physics.step.equations import body_equations
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.generalized import body_accelerations, generalized_force, mass_matrix
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.spatial_algebra import Wrench

GRAVITY = 9.81


@pytest.fixture(
    scope="module",
    params=[*(pytest.param(STRUCTURES[i], marks=pytest.mark.slow) for i in (1, 3)), STRUCTURES[5]],
    ids=str,
)
def found(request):
    """Return a load on random bodies, and its tested quantities at a random state."""
    with jax.enable_x64(True):
        rng = np.random.default_rng(3)
        tree = build_tree(random_creature(rng, request.param))
        state = random_state(tree, rng, (1,))
        load = [jnp.asarray(rng.normal(size=(3, len(tree.names), 1))) for _ in range(2)]

        def everything(state, load):
            kin = kinematics(tree, state)
            inertia, _ = body_equations(World(tree, GRAVITY), kin, 0.0)
            velocity = jnp.concatenate([state.velocity, state.qd])
            return {
                "kin": kin,
                "inertia": inertia,
                "M": mass_matrix(tree, kin, inertia),
                "load": generalized_force(tree, kin, load),
                "velocity": velocity,
                "moves": body_accelerations(tree, kin, velocity),
            }

        result = quick_jit(everything)(state, Wrench(*load))
        yield load, jax.tree.map(lambda x: np.asarray(x)[..., 0], result)


def test_mass_matrix_is_symmetric_and_gives_the_energy(found):
    _, it = found
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
    _, it = found
    np.testing.assert_allclose(it["moves"].angular, it["kin"].angular, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(it["moves"].linear, it["kin"].linear, rtol=1e-12, atol=1e-13)


def test_generalized_loads_have_the_power_of_body_loads(found):
    (moment, force), it = found
    power = (np.asarray(moment)[..., 0] * it["kin"].angular).sum()
    power += (np.asarray(force)[..., 0] * it["kin"].linear).sum()
    assert it["load"] @ it["velocity"] == pytest.approx(power, rel=1e-12)
