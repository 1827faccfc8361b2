"""The wrench on a held root, against the change of momentum and against statics."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import STRUCTURES, box_chain, in_water, quick_jit, random_creature, random_state
from evo_cpg.creature.algebra.rotation import integrate_quaternion
from evo_cpg.creature.creature import Actuator
from evo_cpg.creature.tree import build_tree
from evo_cpg.physics.step.equations import body_equations
from evo_cpg.physics.step.step import holding_wrench, step
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.articulated import solve
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import State, resting_state

H = 1 / 120


@pytest.mark.slow
def test_holding_wrench_balances_momentum():
    """Momentum about the world's origin changes by the holding wrench and the weight."""
    rng = np.random.default_rng(5)
    world = World(build_tree(random_creature(rng, STRUCTURES[4])), 9.81, held=True)
    tree = world.tree

    def momentum(state):
        bodies = world.bodies(kinematics(tree, state), 0.0)
        own = jnp.einsum("ijb,jb->ib", jnp.asarray(tree.inertia), bodies.velocity)
        return about_origin(bodies.kin, own)

    def about_origin(kin, wrench):
        moment, force = (
            jnp.einsum("ijb,jb->ib", kin.rotation, part) for part in (wrench[:3], wrench[3:])
        )
        return jnp.concatenate(
            [(moment + jnp.cross(kin.origin, force, axis=0)).sum(1), force.sum(1)]
        )

    @quick_jit
    def balance(state, torque):
        kin = kinematics(tree, state)
        inertia, bias = body_equations(world, kin, 0.0)
        found = solve(tree, kin, inertia, bias, torque, jnp.zeros_like(torque), world.held)
        holding = holding_wrench(tree, kin, inertia, bias, found)
        turn = jax.jvp(
            lambda t: integrate_quaternion(state.orientation, state.velocity[:3], t), (0.0,), (1.0,)
        )[1]
        change = State(state.velocity[3:], turn, found.root, state.qd, found.qdd)
        rate = jax.jvp(momentum, (state,), (change,))[1]
        lever = kin.rotation[:, :, None] * jnp.asarray(tree.com)[None, :, None]
        centre = kin.origin + lever[:, :, 0].sum(1)
        weight = jnp.stack([0 * tree.mass, 0 * tree.mass, -9.81 * jnp.asarray(tree.mass)])
        moment = holding[:3] + jnp.cross(state.position, holding[3:])
        moment += jnp.cross(centre, weight, axis=0).sum(1)
        return rate, jnp.concatenate([moment, holding[3:] + weight.sum(1)]), found.root

    for _ in range(3):
        state = random_state(tree, rng)
        rate, wrench, acceleration = balance(state, jnp.asarray(rng.normal(size=tree.dof_count)))
        np.testing.assert_allclose(rate, wrench, atol=1e-9 * np.abs(rate).max())
        assert not np.any(acceleration)


def test_held_stiff_body_feels_the_drag_of_the_laws():
    """A straight body in a current: the holder carries the weight's rest and the laws' drag."""
    creature = box_chain(4, "z", Actuator(gain=50.0, stiffness=500.0), density=1200.0)
    world = dataclasses.replace(in_water(creature, current=(-0.4, 0.0, 0.0)), held=True)
    tree = world.tree
    start = resting_state(tree, dtype=jnp.float64)
    still = jnp.zeros(tree.dof_count)

    @quick_jit
    def hold(state):
        return jax.lax.scan(lambda s, _: step(world, s, still, H), state, length=60)

    @quick_jit
    def drag_of(state):
        bodies = world.bodies(kinematics(tree, state), H)
        return sum(law.wrench(bodies) for law in world.forces)[3:].sum(1)

    end, effort = hold(start)
    drag = drag_of(start)
    heavier = 9.81 * (tree.mass - 1000.0 * tree.volume).sum()
    np.testing.assert_allclose(
        effort.holding[-1, 3:], -np.asarray(drag) + [0, 0, heavier], atol=1e-6
    )
    assert float(drag[0]) < -1.0
    np.testing.assert_array_equal(end.position, start.position)


def test_free_root_has_no_holding_wrench():
    world = in_water(box_chain(2, "z"))
    _, effort = jax.eval_shape(
        lambda state: step(world, state, jnp.zeros(1), H), resting_state(world.tree)
    )
    assert effort.holding is None


def test_steps_that_need_iteration_hold_no_root():
    """Limits of torque have a kink."""
    world = World(build_tree(box_chain(2, "z", Actuator(1.0, torque_limit=1.0))), 9.81, held=True)
    with pytest.raises(ValueError, match="only a step without iteration can hold the root"):
        step(world, resting_state(world.tree), jnp.zeros(1), H)
