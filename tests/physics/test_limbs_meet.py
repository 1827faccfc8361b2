"""Limbs that touch each other: depth, energy and derivatives.

`test_implicit_step` tests that the forces on both limbs are equal and opposite.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import clapper, hinge, quick_jit, resting
from evo_cpg.api.record import as_record
from evo_cpg.control.controller import Command
from evo_cpg.creature.algebra.linear import expand_dims_like
from evo_cpg.creature.algebra.rotation import euler_to_matrix
from evo_cpg.creature.creature import Actuator, Body, Creature, Material
from evo_cpg.creature.self_collision import SelfCollision
from evo_cpg.creature.shapes import Box, Capsule, Ellipsoid
from evo_cpg.creature.tree import build_tree
from evo_cpg.native.engine import Engine, using
from evo_cpg.physics.contact.pairs import make_pairs, separations
from evo_cpg.physics.step.step import first_warmstart, step
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import resting_state
from evo_cpg.simulation.recording import Recorder, as_recording
from evo_cpg.simulation.rollout import rollout
from evo_cpg.simulation.sensors import place_sensors
from evo_cpg.simulation.simulation import Simulation
from evo_cpg.simulation.situation import Situation
from evo_cpg.simulation.tasks import Distance
from trials import SineController

H = 1 / 240
STEPS, LEG, COUNT = 240, 60, 8
FLESH = Material(500.0)
SHAPES = {
    "boxes": Box((0.3, 0.06, 0.05)),
    "capsules": Capsule(0.03, 0.24),
    "ellipsoids": Ellipsoid((0.15, 0.05, 0.03)),
}


def inwards(tree):
    """Return the sign of each degree of freedom that turns its limb inwards about z."""
    return np.array([-1.0 if name.startswith("left") else 1.0 for name in tree.dof_names])


def floating(shape, axes, motor=None):
    creature = clapper(shape, axes, motor)
    tree = build_tree(creature)
    return World(tree, 0.0, pairs=make_pairs(creature, tree, SelfCollision()))


@functools.cache
def adrift(shape, axes):
    """Return the world, and a function of `LEG` steps: states, least gaps, forces, residuals."""
    world = floating(SHAPES[shape], axes)

    def advance(state, _):
        new, effort = step(world, state, jnp.zeros_like(state.qd), H)
        gap = separations(world.pairs, kinematics(world.tree, new)).gap.min(0)
        return new, (new, gap, effort.pair_force, effort.residual.solved)

    return world, quick_jit(lambda s: jax.lax.scan(advance, s, length=LEG))


def drift(run, start, steps):
    """Return the results of `adrift` for a number of steps."""
    found = []
    assert steps % LEG == 0
    for _ in range(steps // LEG):
        start, seen = run(start)
        found.append(seen)
    return jax.tree.map(lambda *parts: jnp.concatenate(parts), *found)


def claps(world, kick, dtype=jnp.float64):
    """Return a state with arms that swing inwards, at about ``kick`` rad/s."""
    tree = world.tree
    state = resting_state(tree, (COUNT,), dtype)
    rng = np.random.default_rng(1)
    about_z = np.array([name.endswith("z") for name in tree.dof_names])
    qd = kick * (inwards(tree) * about_z)[:, None] * rng.uniform(0.5, 1.5, (tree.dof_count, COUNT))
    qd = qd + 0.3 * rng.normal(size=qd.shape)
    return dataclasses.replace(state, qd=jnp.asarray(qd, dtype))


def kinetic_energy(world, states):
    """Return the kinetic energy of every individual at every time, J."""
    tree = world.tree
    over_time = jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1), states)
    kin = quick_jit(lambda s: kinematics(tree, s))(over_time)
    rotation, angular, linear = (np.asarray(x) for x in (kin.rotation, kin.angular, kin.linear))
    parts = [np.einsum("xyb...,xb...->yb...", rotation, x) for x in (angular, linear)]
    own = np.concatenate(parts)
    return 0.5 * np.einsum("ib...,ijb,jb...->...", own, tree.inertia, own)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shape", "axes"),
    [
        ("capsules", "z"),
        ("ellipsoids", "z"),
        ("boxes", "yz"),
        ("boxes", "z"),
        ("capsules", "yz"),
        ("ellipsoids", "yz"),
    ],
)
def test_limbs_clap_without_passing_through(x64, shape, axes):
    """Every step is solved, the depth is below 3 mm, and the contact forces add no energy.

    Ellipsoids may be 8 mm deep, because their rounded boxes stick out of them.
    """
    world, run = adrift(shape, axes)
    states, gap, force, residual = drift(run, claps(world, 3.0), STEPS)
    assert (np.asarray(force) > 0).any((0, 1)).mean() >= 0.75
    assert np.asarray(residual).max() < 1e-9
    assert np.asarray(gap).min() > (-8e-3 if shape == "ellipsoids" else -3e-3)
    energy = kinetic_energy(world, states)
    assert (energy.max(-1) / energy[..., 0]).max() < 1.01


@pytest.mark.slow
@pytest.mark.parametrize(
    "shape",
    ["capsules", *(pytest.param(s, marks=pytest.mark.slow) for s in ("boxes", "ellipsoids"))],
)
def test_fast_limbs_stay_shallow(x64, shape):
    """At 14 rad/s an arm's path bends by millimetres in a step, but limbs are at most 2 mm deep.

    The initial velocity-product bias alone made them 2.3 (ellipsoids) to 3.6 mm (boxes) deep.
    """
    world, run = adrift(shape, "z")
    states, gap, _, residual = drift(run, claps(world, 14.0), LEG)
    assert np.asarray(residual).max() < 1e-9
    assert -2e-3 < np.asarray(gap).min() < -1e-4
    energy = kinetic_energy(world, states)
    assert (energy.max(-1) / energy[..., 0]).max() < 1.01


class Clap(SineController):
    """Controller that turns all limbs of a tree inwards and back."""

    signs: tuple[float, ...] = ()

    def act(self, decoded, state, observation):
        state, command = super().act(decoded, state, observation)
        signs = expand_dims_like(np.array(self.signs), command.target_rate)
        rate = signs * command.target_rate
        return state, Command(rate, command.signal)


@pytest.mark.slow
def test_a_recording_has_the_mean_force_of_every_pair(x64):
    """The mean is over the physics steps of a control step, the sum over the points of a pair."""
    world, substeps = floating(SHAPES["boxes"], "z", Actuator(0.5, 2.0)), 2
    creature = clapper(SHAPES["boxes"], "z")
    place, pairs, signs = Situation((0.0, 0.0, 0.0)), world.pairs, inwards(world.tree)
    trial = Simulation(
        world=world,
        sensors=place_sensors(creature, world.tree),
        controller=Clap(signs=tuple(signs)),
        task=Distance(),
        control_rate=120.0,
        substeps=substeps,
        steps=60,
        situations=(place,),
    )
    genes = np.array([[4.0], [1.0]])
    frames = quick_jit(lambda g: rollout(trial, g, observers=Recorder(full=True)))(genes)
    found = as_record(trial, frames, as_recording(trial, frames, [*world.tree.names]))

    def advance(carry, k):
        state, warmstart = carry
        wave = genes[0] * jnp.sin(2 * np.pi * genes[1] * (k // substeps) / 60)
        commanded = signs[:, None] * wave[None]
        new, effort = step(world, state, commanded, H, warmstart=warmstart)
        return (new, effort.warmstart), effort.pair_force

    start = (
        resting_state(world.tree, (1,), jnp.float64),
        first_warmstart(world, (1,), jnp.float64),
    )
    _, force = quick_jit(lambda s: jax.lax.scan(advance, s, jnp.arange(60 * substeps)))(start)
    mean = np.asarray(force)[..., 0].reshape(60, substeps, -1).mean(1)
    owners = np.array(pairs.owners).T
    for first, second in zip(pairs.first, pairs.second, strict=True):
        name = f"{world.tree.names[first]}-{world.tree.names[second]}.push"
        own = (owners == (first, second)).all(1)
        np.testing.assert_allclose(found[name], mean[:, own].sum(1), atol=1e-6)
        assert found.units[name] == "N"
    assert mean.max() > 0.1


@pytest.mark.parametrize(
    "shape",
    [
        pytest.param(shape, marks=[] if shape == "capsules" else pytest.mark.slow)
        for shape in SHAPES
    ],
)
@pytest.mark.slow
def test_overlapping_limbs_separate_slowly(x64, shape):
    """The push-out does little work at any depth: the speed stays below 0.5 m/s."""
    world, run = adrift(shape, "z")
    tree = world.tree
    arms = inwards(tree) * [name.split(".")[0].endswith("arm") for name in tree.dof_names]
    angle = arms[:, None] * np.linspace(0.16, 0.18, COUNT)
    start = resting(tree, (COUNT,), q=angle)
    states, gap, _, residual = drift(run, start, STEPS)
    assert np.asarray(residual).max() < 1e-9
    assert np.asarray(gap)[0].min() < -0.02
    assert np.asarray(gap)[-1].min() > -1e-4
    most = 0.5 * world.tree.mass.sum() * 0.5**2
    assert kinetic_energy(world, states).max() < most


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["native", "jax"])
def test_gradients_through_touching_limbs_equal_central_differences(x64, engine):
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
        run = quick_jit(ahead)
        _, force = run(none)
        grad = np.asarray(quick_jit(jax.grad(lambda x: ahead(x)[0].sum()))(none))
        expected = np.stack([
            np.asarray(run(none.at[d].set(1e-6))[0] - run(none.at[d].set(-1e-6))[0]) / 2e-6
            for d in range(len(grad))
        ])  # fmt: skip
    assert (np.asarray(force) > 0).any(0).mean() >= 0.75
    error = np.linalg.norm(grad - expected, axis=0) / np.linalg.norm(expected, axis=0)
    assert np.median(error) < 1e-6 and np.quantile(error, 0.8) < 1e-4


@pytest.mark.parametrize("yaw", [0, 20, 45])
def test_boxes_that_cannot_touch_are_no_pair(yaw):
    """They are apart along their common axis. Their reach alone cannot decide this after a yaw."""
    turn = euler_to_matrix(0.0, 0.0, np.radians(yaw))
    bodies = [Body("trunk", Box((0.3, 0.3, 0.05)), FLESH)]
    for side, name in ((1, "left"), (-1, "right")):
        place = turn @ [-side * 0.075, side * 0.05, 0.0]
        turned = tuple(map(tuple, turn.tolist()))
        joint = hinge("trunk", tuple(place), (0.0, 0.0, 0.1), "y", 1.5, orientation=turned)
        bodies.append(Body(name, Box((0.03, 0.03, 0.2)), FLESH, joint))
    creature = Creature("legs", tuple(bodies))
    pairs = make_pairs(creature, build_tree(creature), SelfCollision(include=(("left", "right"),)))
    assert pairs is None
