"""Limbs that push each other: depth, energy, and derivatives.

That pushes are equal and opposite is tested in `test_implicit_step`.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import quick_jit
from evo_cpg.creature.creature import Actuator, Body, Creature, Joint, Material
from evo_cpg.creature.self_collision import SelfCollision
from evo_cpg.creature.shapes import Box, Capsule, Ellipsoid
from evo_cpg.creature.tree import build_tree
from evo_cpg.fusion.engine import Engine, using
from evo_cpg.physics.kinematics import kinematics
from evo_cpg.physics.pairs import make_pairs, separations
from evo_cpg.physics.state import resting_state
from evo_cpg.physics.step import step
from evo_cpg.physics.world import World

H = 1 / 240
STEPS, COUNT = 240, 8
FLESH = Material(500.0)
SHAPES = {
    "boxes": Box((0.3, 0.06, 0.05)),
    "capsules": Capsule(0.03, 0.24),
    "ellipsoids": Ellipsoid((0.15, 0.05, 0.03)),
}


def clapper(shape, axes, motor=None):
    """A trunk with two limbs of two bodies each that can clap together in front of it."""
    unit = {"y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
    bodies = [Body("trunk", Box((0.2, 0.3, 0.1)), FLESH)]
    for side, name in ((1, "left"), (-1, "right")):
        joint = {
            "child_anchor": (-0.16, 0.0, 0.0),
            "axes": tuple(unit[axis] for axis in axes),
            "lower": (-1.2,) * len(axes),
            "upper": (1.2,) * len(axes),
            "actuator": motor,
        }
        bodies.append(
            Body(f"{name}_arm", shape, FLESH, Joint("trunk", (0.1, side * 0.12, 0.0), **joint))
        )
        bodies.append(
            Body(f"{name}_hand", shape, FLESH, Joint(f"{name}_arm", (0.16, 0.0, 0.0), **joint))
        )
    return Creature("clapper", tuple(bodies))


def floating(shape, axes, motor=None):
    creature = clapper(shape, axes, motor)
    tree = build_tree(creature)
    return World(tree, 0.0, pairs=make_pairs(creature, tree, SelfCollision()))


def claps(world, kick, dtype=jnp.float64):
    """A start at which the arms swing inwards at some rates, rad/s."""
    tree = world.tree
    state = resting_state(tree, (COUNT,), dtype)
    rng = np.random.default_rng(1)
    sides = [-1.0 if tree.names[body].startswith("left") else 1.0 for body in tree.dof_bodies]
    inwards = np.array(sides) * [name.endswith("z") for name in tree.dof_names]
    qd = kick * inwards[:, None] * rng.uniform(0.5, 1.5, (tree.dof_count, COUNT))
    qd = qd + 0.3 * rng.normal(size=qd.shape)
    return dataclasses.replace(state, qd=jnp.asarray(qd, dtype))


def kinetic_energy(world, states):
    """Of every individual at every time, J."""
    tree = world.tree
    over_time = jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1), states)
    kin = quick_jit(lambda s: kinematics(tree, s))(over_time)
    rotation, angular, linear = (np.asarray(x) for x in (kin.rotation, kin.angular, kin.linear))
    parts = [np.einsum("xyb...,xb...->yb...", rotation, x) for x in (angular, linear)]
    own = np.concatenate(parts)
    return 0.5 * np.einsum("ib...,ijb,jb...->...", own, tree.inertia, own)


@pytest.mark.parametrize("axes", ["z", "yz"])
@pytest.mark.parametrize("shape", SHAPES)
def test_limbs_clap_without_passing_through(x64, shape, axes):
    """The law holds in every step; they are not 3 mm deep; what pushes gives no energy.

    Rounded boxes stick out of ellipsoids by more than they go deeper.
    """
    world = floating(SHAPES[shape], axes)
    start = claps(world, 3.0)

    def advance(state, _):
        new, effort = step(world, state, jnp.zeros_like(state.qd), H)
        gap = separations(world.pairs, kinematics(world.tree, new)).gap.min(0)
        return new, (new, gap, effort.pair_force, effort.residual.solved)

    whole = quick_jit(lambda s: jax.lax.scan(advance, s, length=STEPS)[1])
    states, gap, force, residual = whole(start)
    assert (np.asarray(force) > 0).any((0, 1)).mean() >= 0.75
    assert np.asarray(residual).max() < 1e-9
    assert np.asarray(gap).min() > (-8e-3 if shape == "ellipsoids" else -3e-3)
    energy = kinetic_energy(world, states)
    assert (energy.max(-1) / energy[..., 0]).max() < 1.01


@pytest.mark.parametrize("engine", ["native", pytest.param("jax", marks=pytest.mark.slow)])
def test_gradients_through_limbs_that_push_equal_central_differences(x64, engine):
    world = floating(SHAPES["boxes"], "z", Actuator(0.5, 2.0, stiffness=4.0))
    start = claps(world, 4.0)

    def ahead(kick):
        def advance(state, _):
            new, effort = step(world, state, jnp.zeros_like(state.qd), H)
            return new, effort.pair_force.max(0)

        state = dataclasses.replace(start, qd=start.qd + kick)
        state, force = jax.lax.scan(advance, state, length=40)
        return (state.q * jnp.arange(1.0, 5.0)[:, None]).sum(0) + state.position[0], force

    with using(Engine(engine)):
        none = jnp.zeros_like(start.qd)
        _, force = quick_jit(ahead)(none)
        grad = np.asarray(quick_jit(jax.grad(lambda x: ahead(x)[0].sum()))(none))
        both = quick_jit(lambda x: ahead(x)[0])
        wanted = np.stack([
            np.asarray(both(none.at[d].set(1e-6)) - both(none.at[d].set(-1e-6))) / 2e-6
            for d in range(len(grad))
        ])  # fmt: skip
    assert (np.asarray(force) > 0).any(0).mean() >= 0.75
    error = np.linalg.norm(grad - wanted, axis=0) / np.linalg.norm(wanted, axis=0)
    assert np.median(error) < 1e-6 and np.quantile(error, 0.8) < 1e-4
