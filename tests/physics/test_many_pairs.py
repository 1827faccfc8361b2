"""Loops over many pairs of limbs agree with written-out pairs, and long chains are solved."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import clapper, hinge, quick_jit
from evo_cpg.creature.creature import Actuator, Body, Creature, Material
from evo_cpg.creature.self_collision import SelfCollision
from evo_cpg.creature.shapes import Box, Capsule, Ellipsoid
from evo_cpg.creature.tree import build_tree
from evo_cpg.native.engine import Engine, using
from evo_cpg.physics.contact import many_pairs
from evo_cpg.physics.contact import pairs as written_out
from evo_cpg.physics.contact.contact_model import Ground, make_contact_model
from evo_cpg.physics.contact.many_pairs import ManyPairContacts
from evo_cpg.physics.contact.pairs import make_pairs, separations
from evo_cpg.physics.step.step import first_warmstart, step
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import resting_state

H, COUNT = 1 / 240, 24
FLESH = Material(500.0, static_friction=0.8, dynamic_friction=0.8)
LIMBS = {
    "capsules": Capsule(0.03, 0.24),
    "boxes": Box((0.3, 0.06, 0.05)),
    "ellipsoids": Ellipsoid((0.15, 0.05, 0.03)),
}


@pytest.fixture
def loops(monkeypatch):
    """Return a function that switches loops over pairs on or off."""
    return lambda yes: monkeypatch.setattr(written_out, "_MOST_WRITTEN_OUT", 0 if yes else 10**6)


def clapping(shape, axes, dtype=jnp.float64):
    """Return a world, and states with limbs that turn inwards so that some touch."""
    creature = clapper(LIMBS[shape], axes, Actuator(2.0, torque_limit=5.0))
    tree = build_tree(creature)
    world = World(tree, 0.0, pairs=make_pairs(creature, tree, SelfCollision()))
    rng = np.random.default_rng(3)
    inwards = np.array([-1.0 if name.startswith("left") else 1.0 for name in tree.dof_names])
    about_z = np.array([name.endswith("z") for name in tree.dof_names])
    turned = (inwards * about_z)[:, None] * rng.uniform(0.1, 1.0, (tree.dof_count, COUNT))
    q = turned + 0.1 * rng.normal(size=turned.shape)
    qd = 4.0 * (inwards * about_z)[:, None] + rng.normal(size=turned.shape)
    state = resting_state(tree, (COUNT,), dtype)
    given = {"q": jnp.asarray(q, dtype), "qd": jnp.asarray(qd, dtype)}
    return world, dataclasses.replace(state, **given)


def one_step(world, state):
    rates = jnp.zeros_like(state.qd)
    return quick_jit(lambda s: step(world, s, rates, H))(state)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shape", "axes"), [("capsules", "z"), ("boxes", "z"), ("boxes", "yz"), ("ellipsoids", "yz")]
)
def test_loops_find_the_same_step(x64, loops, shape, axes):
    world, state = clapping(shape, axes)
    loops(False)
    expected, effort = one_step(world, state)
    loops(True)
    got, its_effort = one_step(world, state)
    # One point may have left the margin of watched points. It exerts no force.
    pushes = np.asarray(effort.pair_force)
    assert (pushes.sum(0) > 0).sum() >= 5, "the test needs forces"
    np.testing.assert_allclose(its_effort.pair_force, pushes, rtol=1e-8, atol=1e-8 * pushes.max())
    np.testing.assert_allclose(got.qd, expected.qd, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(got.velocity, expected.velocity, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_loops_on_plain_jax_find_the_same_step(x64, loops):
    """Mix individuals with and without forces in programs of plain JAX."""
    world, state = clapping("capsules", "z")
    loops(True)
    expected, effort = one_step(world, state)
    with using(Engine("jax")):
        got, its_effort = one_step(world, state)
    np.testing.assert_allclose(got.qd, expected.qd, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(its_effort.pair_force, effort.pair_force, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("shape", LIMBS)
@pytest.mark.slow
def test_loops_measure_the_same_gaps(x64, loops, shape):
    world, state = clapping(shape, "yz")
    tree, pairs = world.tree, world.pairs

    def measure(state):
        return separations(pairs, kinematics(tree, state))

    loops(False)
    expected = quick_jit(measure)(state)
    loops(True)
    got = jax.jit(measure)(state)
    # Near two corners the gap is less than the distance, and rounding chooses the points. That is
    # so for 3 % of these boxes.
    determined = np.full(expected.gap.shape, True)
    for found in (expected, got):
        distance = np.linalg.norm(np.subtract(found.second, found.first), axis=0)
        determined &= distance < np.abs(found.gap) + 1e-9
    assert determined.mean() > 0.95
    for name, one, other in zip(expected._fields, got, expected, strict=True):
        if name in ("first", "second"):
            one, other = (np.asarray(each)[:, determined] for each in (one, other))
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9, err_msg=name)


def listed_points(contacts):
    """Return 1 for each point that an individual lists."""
    return contacts.of_points(lambda _: 1.0)


@pytest.mark.slow
def test_points_that_are_not_listed_exert_no_force(x64, loops):
    """Points that are not listed in a step are too far away to touch, at any reachable rate."""
    world, state = clapping("capsules", "z")
    tree, pairs = world.tree, world.pairs
    state = dataclasses.replace(state, qd=8.0 * state.qd)

    def watch(state):
        kin = kinematics(tree, state)
        contacts = ManyPairContacts(tree, pairs, kin, state.qd, H)
        return separations(pairs, kin).gap, listed_points(contacts)

    loops(True)
    watched = np.asarray(jax.jit(watch)(state)[1])
    later = dataclasses.replace(state, q=state.q + H * state.qd)
    gap_later = np.asarray(jax.jit(watch)(later)[0])
    # A further point may appear, but one point of the pair is listed.
    owners = list(zip(*pairs.owners, strict=True))
    points = [[k for k, own in enumerate(owners) if own == pair] for pair in sorted(set(owners))]
    comes = np.array([gap_later[own].min(0) < 0 for own in points])
    seen = np.array([watched[own].max(0) == 1 for own in points])
    assert comes.sum() >= 10 and (~seen).sum() >= 10, "the test needs approaching pairs"
    assert seen[comes].all()


@pytest.mark.slow
def test_points_that_are_left_out_change_no_bit(loops, monkeypatch):
    """Sums over the listed points equal sums over all points."""
    world, state = clapping("capsules", "z", jnp.float32)
    tree, pairs = world.tree, world.pairs
    loops(True)
    monkeypatch.setattr(many_pairs, "_TOGETHER", 5)

    def evaluated():
        def evaluate(state):
            kin = kinematics(tree, state)
            contacts = ManyPairContacts(tree, pairs, kin, state.qd, H)
            forces, again = (contacts.at(jnp.zeros_like(state.q)) for _ in range(2))
            matrix = forces.newton()
            return listed_points(contacts), matrix, forces.sums, again.sums

        return quick_jit(evaluate)(state)

    listed, *found = evaluated()
    monkeypatch.setattr(many_pairs, "_MARGIN", 1e6)
    monkeypatch.setattr(many_pairs, "_TOGETHER", 1)
    everything, *expected = evaluated()
    assert len(listed) % 5, "the test needs an incomplete group"
    # The second point of a pair need not exist.
    assert everything.sum() > 1.5 * listed.sum() and (found[-1].load > 0).sum() >= 5
    jax.tree.map(np.testing.assert_array_equal, found, expected)
    _, with_matrix, alone = found
    np.testing.assert_allclose(with_matrix.load, alone.load, rtol=1e-6)
    scale = np.abs(alone.torque).max()
    np.testing.assert_allclose(with_matrix.torque, alone.torque, rtol=0, atol=1e-6 * scale)


@pytest.mark.slow
def test_neighbours_change_no_bit_of_a_step(loops):
    """The lists of other individuals in a vector may be longer or shorter."""
    world, state = clapping("capsules", "yz", jnp.float32)
    loops(True)
    together, effort = one_step(world, state)
    assert len(np.unique((np.asarray(effort.pair_force) > 0).sum(0))) > 1
    order = np.random.default_rng(0).permutation(COUNT)[:17]
    some, its_effort = one_step(world, jax.tree.map(lambda x: x[..., order], state))
    np.testing.assert_array_equal(some.qd, together.qd[:, order])
    np.testing.assert_array_equal(its_effort.pair_force, effort.pair_force[:, order])


def snake(count):
    """Return boxes in a row on the ground, with one upright axis between neighbours."""
    size = Box((0.1, 0.05, 0.05))
    bodies = [Body("head", size, FLESH)]
    for k in range(1, count):
        ends = (-0.055, 0.0, 0.0), (0.055, 0.0, 0.0)
        joint = hinge(bodies[-1].name, *ends, actuator=Actuator(2.0))
        bodies.append(Body(f"part{k}", size, FLESH, joint))
    return Creature("snake", tuple(bodies))


@pytest.mark.slow
@pytest.mark.parametrize("count", [18, 40])
def test_long_snakes_have_the_motion_of_float64(count):
    """Single precision finds the step of double precision, and reports it as solved."""
    creature = snake(count)
    tree = build_tree(creature)
    world = World(tree, 9.81, contact_model=make_contact_model(creature, tree, Ground()))
    rng = np.random.default_rng(0)
    start = 0.5 * rng.uniform(-1, 1, (tree.dof_count, 8)), rng.normal(size=(tree.dof_count, 8))
    with jax.enable_x64(True):
        ends = {}
        for dtype in (jnp.float32, jnp.float64):
            state = resting_state(tree, (8,), dtype)
            q, rates = (jnp.asarray(x, dtype) for x in start)
            position = state.position.at[2].set(0.0249)
            state = dataclasses.replace(state, q=q, position=position)

            def run(state, rates=rates, dtype=dtype):
                def advance(carry, _):
                    state, warm = carry
                    state, effort = step(world, state, rates, 1 / 120, warm)
                    return (state, effort.warmstart), effort.residual.solved

                begin = state, first_warmstart(world, (8,), dtype)
                (state, _), residual = jax.lax.scan(advance, begin, length=10)
                return state.qd, residual

            ends[dtype] = jax.jit(run)(state)
        (single, missed), (double, exact) = ends.values()
    assert np.max(exact) < 1e-9
    assert np.quantile(missed, 0.9) < 1e-3 and np.max(missed) < 3e-3
    assert np.abs(single - double).max() < 0.03 * np.abs(double).max()
