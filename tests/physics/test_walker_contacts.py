"""Walking and falling creatures on the ground."""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import coast, hinge, jit_as_for_users, quick_jit
from evo_cpg.control.controller import Observation
from evo_cpg.creature.creature import Body, Creature, Material
from evo_cpg.creature.shapes import Box
from evo_cpg.creature.tree import build_tree
from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import load_config
from evo_cpg.physics.contact.contact import find_contacts
from evo_cpg.physics.contact.contact_model import Ground, make_contact_model
from evo_cpg.physics.contact.contact_points import clearance
from evo_cpg.physics.step.step import Effort, step
from evo_cpg.physics.step.step_solver import solve_step
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.joint_torque import MotorCommand
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import State, integrate, resting_state

H = 1 / 240
CONFIG = Path(__file__).parents[2] / "configs" / "fukui2003_model1.yaml"
WALKERS, SECONDS = 24, 4.0


def mechanics(world: World, state: State) -> tuple[np.ndarray, np.ndarray]:
    """Return the velocity of the centre of mass and the mechanical energy of each individual."""
    tree = world.tree
    kin = quick_jit(lambda state: kinematics(tree, state))(state)
    rotation, angular, linear, origin = (
        np.asarray(part, float) for part in (kin.rotation, kin.angular, kin.linear, kin.origin)
    )
    offset = np.einsum("xyb...,yb->xb...", rotation, tree.com)
    velocity = linear + np.cross(angular, offset, axis=0)
    momentum = np.einsum("xb...,b->x...", velocity, tree.mass)
    own = np.concatenate(
        [np.einsum("xyb...,xb...->yb...", rotation, part) for part in (angular, linear)]
    )
    kinetic = 0.5 * np.einsum("ib...,ijb,jb...->...", own, tree.inertia, own)
    height = np.einsum("b...,b->...", origin[2] + offset[2], tree.mass)
    return momentum / tree.mass.sum(), kinetic + world.gravity * height


def depths(world: World, states: State) -> np.ndarray:
    """Return the depth of each contact point in the ground, ``(steps, points, n)``, m."""

    @quick_jit
    def gaps(state):
        kin = kinematics(world.tree, state)
        bodies = np.array(world.contact_model.bodies)
        return (kin.origin[:, bodies] + find_contacts(world.contact_model, kin, H).offset)[2]

    over_time = jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1), states)
    return -np.moveaxis(np.asarray(gaps(over_time)), -1, 0)


def pressed(world: World, effort: Effort) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return normal and tangential forces ``(steps, points, n)``, and mu_s times the former.

    Assert that no normal force is negative, that friction is within its cone plus the residual, and
    that residuals relative to the forces are small. The residual of the solution is at most 1e-3 in
    all but one of 2000 steps, and 0.1 in all (docs/models/contact.md: one of 10,000 contact steps).
    The residual of Coulomb's law is at most 1e-2 in 99 % of the contact steps, and 1 in all.
    """
    support = np.asarray(effort.contact_frame_force, float)
    across, along = support[:, 2], np.hypot(support[:, 0], support[:, 1])
    limit = world.contact_model.static_friction[:, None] * across
    touches = (across > 0).any(1)
    solved, coulomb = (np.asarray(x, float) for x in effort.residual)
    assert (solved > 1.01e-3).mean() < 5e-4 and solved.max() < 0.1
    assert (coulomb[touches] > 1e-2).mean() < 0.01
    assert coulomb.max() < 1.0
    assert across.min() >= 0
    carried = across.sum(1)
    if effort.pair_force is not None:
        carried = carried + np.asarray(effort.pair_force, float).sum(1)
    load = np.maximum(carried, world.gravity * world.tree.mass.sum())
    missed = np.sqrt(2) * (solved + coulomb) * load
    assert (along <= limit + 1.01 * missed[:, None]).all()
    return across, along, limit


@pytest.fixture(scope="module")
def walk():
    """Return 4 s of 24 random genomes of Fukui's Model 1 in float32. The first only stands."""
    with jax.enable_x64(False):
        simulation = build_experiment(load_config(CONFIG), CONFIG).simulation
        world, controller = simulation.world, simulation.controller
        dofs = world.tree.dof_count
        rng = np.random.default_rng(0)
        genes = jnp.asarray(rng.random((controller.gene_count, WALKERS)) < 0.5, jnp.float32)
        nothing = jnp.zeros((0, WALKERS), jnp.float32)
        still = jnp.zeros((dofs, WALKERS), jnp.float32)
        stands = jnp.asarray(np.arange(WALKERS) > 0, jnp.float32)[None]

        @quick_jit
        def run(genes):
            place = simulation.situations[0].start_position
            state = resting_state(world.tree, (WALKERS,), position=place)
            nerves = controller.initial_state((WALKERS,), jnp.float32)
            decoded = controller.decode(genes)
            observed = Observation(nothing, nothing, nothing, nothing, still, still, nothing)

            def control(carry, _):
                state, nerves = carry
                nerves, command = controller.act(decoded, nerves, observed)

                def move(s, _):
                    angle = command.target_angle * stands
                    s, effort = step(world, s, MotorCommand(command.target_rate, angle), H)
                    return s, (s, effort)

                state, record = jax.lax.scan(move, state, None, simulation.substeps)
                return (state, nerves), record

            steps = round(SECONDS * simulation.control_rate)
            _, record = jax.lax.scan(control, (state, nerves), None, steps)
            return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), record)

        states, effort = run(genes)
        return world, states, effort


@pytest.mark.slow
def test_the_ground_pushes_and_motors_keep_their_limits(walk):
    """No normal force is negative, no friction exceeds mu_s times it, no torque exceeds 40 N m."""
    world, states, effort = walk
    across, along, limit = pressed(world, effort)
    torque = np.abs(np.asarray(effort.torque))
    assert (torque <= world.tree.torque_limit[:, None].astype(np.float32)).all()
    for part in jax.tree.leaves(states):
        assert np.isfinite(part).all()
    # The motion is a walk: feet slip and lift off, and motors reach their limits.
    assert 0.02 < (across > 0).mean() < 0.5
    assert (along > 0.99 * limit)[across > 0].mean() > 0.05
    assert torque.max() == 40.0


@pytest.mark.slow
def test_support_is_weight_and_change_of_momentum(walk):
    """The impulse of the ground minus the impulse of gravity changes the walkers' momentum.

    The tolerance is 1 % of gravity's impulse. Joint motion conserves momentum to first order in h.
    """
    world, states, effort = walk
    total = np.asarray(effort.contact_frame_force, float).sum((0, 2)) * H / world.tree.mass.sum()
    gained = total - np.array([[0], [0], [world.gravity * SECONDS]])
    velocity, _ = mechanics(world, jax.tree.map(lambda x: x[-1], states))
    assert np.abs(gained - velocity).max() < 0.01 * world.gravity * SECONDS


@pytest.mark.slow
def test_a_standing_walker_is_carried_by_its_feet(walk):
    """Its feet carry its weight within 2 % (0.1 % on average), and are less than 2 mm deep."""
    world, states, effort = walk
    support = np.asarray(effort.contact_frame_force, float)[:, 2, :, 0].sum(1)
    weight = world.gravity * world.tree.mass.sum()
    np.testing.assert_allclose(support[-480:], weight, rtol=0.02)
    assert support.mean() == pytest.approx(weight, rel=1e-3)
    deep = depths(world, jax.tree.map(lambda x: x[..., :1], states))
    assert deep.max() < 2e-3
    assert np.abs(np.asarray(states.velocity)[-1, :, 0]).max() < 1e-3


@pytest.mark.slow
def test_walking_feet_stay_on_the_ground(walk):
    """Depth is below 1 mm for 99.99 % of all points and times, and below 3 mm for all."""
    world, states, _ = walk
    deep = depths(world, states)
    assert (deep > 1e-3).mean() < 1e-4
    assert deep.max() < 3e-3


def legged(legs, segments: int) -> World:
    """Return a torso on legs that turn about y, damped by 0.05 N m s/rad, far from limits."""
    flesh = Material(300.0, 0.3, 0.8, 0.8)
    bodies = [Body("torso", Box((0.6, 0.3, 0.16)), flesh)]
    for name, (x, y) in enumerate(legs):
        parent, anchor = "torso", (x, y, -0.08)
        for segment in range(segments):
            joint = hinge(parent, anchor, (0, 0, 0.12), "y", 99.0, damping=0.05)
            parent, anchor = f"{name}-{segment}", (0, 0, -0.12)
            bodies.append(Body(parent, Box((0.08, 0.08, 0.24)), flesh, joint))
    creature = Creature("legged", tuple(bodies))
    tree = build_tree(creature)
    return World(
        tree, 9.81, contact_model=make_contact_model(creature, tree, Ground(1.0, 0.8, 0.8))
    )


def thrown(world: World, count: int, height: float) -> State:
    """Return states above the ground in any orientation, moving at some 1 m/s and 1 rad/s."""
    rng = np.random.default_rng(0)
    turns = rng.normal(size=(4, count))
    state = resting_state(world.tree, (count,), jnp.float64, position=(0.0, 0.0, height))
    return dataclasses.replace(
        state,
        orientation=jnp.asarray(turns / np.linalg.norm(turns, axis=0)),
        velocity=jnp.asarray(rng.normal(size=(6, count))),
        q=jnp.asarray(rng.uniform(-0.5, 0.5, (world.tree.dof_count, count))),
    )


@pytest.mark.slow
def test_ragdolls_only_lose_energy_and_come_to_rest():
    """The energy of passive quadrupeds never rises by 1 % of its initial value above a minimum.

    The torsos rest after 10 s, while legs on lightly damped joints still swing a little.
    """
    world = legged([(0.26, 0.11), (0.26, -0.11), (-0.26, 0.11), (-0.26, -0.11)], segments=2)
    start = thrown(world, 12, 1.0)

    states = coast(world, start, 2400 * H, H)
    _, energy = mechanics(world, jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1), states))
    _, first = mechanics(world, start)
    rise = (energy - np.minimum.accumulate(energy, axis=1)) / first[:, None]
    assert (energy < 1.01 * first[:, None]).all()
    assert rise.max() < 0.01
    assert depths(world, states)[-1].max() < 2e-3
    assert np.abs(np.asarray(states.velocity)[-1]).max() < 0.05


@pytest.fixture(scope="module")
def tumbling():
    """Return half a second of tumbling tripods in float32, compiled as for users."""
    with jax.enable_x64(True):
        world = legged([(0.2, 0.0), (-0.2, 0.0)], segments=1)
        start = jax.tree.map(lambda x: np.asarray(x, np.float32), thrown(world, 12, 0.4))
    with jax.enable_x64(False):

        @jit_as_for_users
        def run(state):
            def advance(s, _):
                s, effort = step(world, s, jnp.zeros_like(s.q), H)
                return s, (s, effort)

            return jax.lax.scan(advance, state, None, 120)[1]

        states, effort = run(start)
        yield world, start, states, effort


@pytest.mark.slow
def test_a_tripod_obeys_friction_and_conserves_momentum(tumbling):
    """Normal forces are not negative, friction is in the cone, impulses change the momentum."""
    world, start, states, effort = tumbling
    across, along, limit = pressed(world, effort)
    support = np.asarray(effort.contact_frame_force, float)
    assert (along > 0.99 * limit)[across > 0].mean() > 0.05
    seconds = len(across) * H
    total = support.sum((0, 2)) * H / world.tree.mass.sum()
    gained = total - np.array([[0], [0], [world.gravity * seconds]])
    (first, _), (last, _) = (
        mechanics(world, state) for state in (start, jax.tree.map(lambda x: x[-1], states))
    )
    assert np.abs(gained - (last - first)).max() < 0.01 * world.gravity * seconds


@pytest.mark.slow
def test_a_tripod_loses_energy_and_stays_shallow(tumbling):
    world, start, states, _ = tumbling
    _, energy = mechanics(world, jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1), states))
    _, first = mechanics(world, start)
    rise = (energy - np.minimum.accumulate(energy, axis=1)) / first[:, None]
    assert (energy < 1.01 * first[:, None]).all()
    assert rise.max() < 0.01
    deep = depths(world, states)
    assert (deep > 1e-3).mean() < 1e-3
    assert deep.max() < 5e-3
    assert 0.02 < (deep > -1e-3).mean() < 0.5


def test_an_impact_of_many_limbs_adds_no_energy():
    """Tripods hit the ground at 10 m/s while their legs swing at some 10 rad/s.

    The step is so short that only the impact does work. Newton's restitution alone would add energy
    if a chain of bodies hits the ground with one point.
    """
    world = legged([(0.2, 0.0), (-0.2, 0.0)], segments=2)
    state, rng, h = thrown(world, 64, 1.0), np.random.default_rng(3), 1e-6
    velocity = np.asarray(state.velocity) - np.array([0, 0, 0, 0, 0, 10.0])[:, None]
    rates = 10 * rng.normal(size=state.qd.shape)
    state = dataclasses.replace(state, velocity=jnp.asarray(velocity), qd=jnp.asarray(rates))
    gap = quick_jit(lambda s: clearance(world.contact_model, kinematics(world.tree, s)))(state)
    down = np.asarray(state.position) - np.array([0, 0, 1.0])[:, None] * np.asarray(gap).min(0)
    state = dataclasses.replace(state, position=jnp.asarray(down))
    _, before = mechanics(world, state)

    @quick_jit
    def hit(state, restitution):
        like = jnp.full(len(world.contact_model.bodies), restitution)
        own = dataclasses.replace(
            world, contact_model=world.contact_model._replace(restitution=like)
        )
        new, effort = step(own, state, jnp.zeros_like(state.qd), h)
        return new, effort.contact_frame_force[2].sum(0)

    dull = np.asarray(hit(state, 0.0)[1])
    hits = dull > 0
    assert hits.mean() > 0.8
    for restitution in (0.3, 1.0):
        new, force = hit(state, restitution)
        _, after = mechanics(world, new)
        assert (after <= (1 + 1e-4) * before).all()
        # The tripods do bounce.
        assert np.median(np.asarray(force)[hits] / dull[hits]) > 1 + 0.5 * restitution


@pytest.mark.slow
def test_derivatives_of_a_contact_step_equal_central_differences():
    """Differentiate an unfused step by the initial velocity. Some tripods touch the ground."""
    world = legged([(0.2, 0.0), (-0.2, 0.0)], segments=1)
    state, still = thrown(world, 12, 0.3), jnp.zeros(world.tree.dof_count)

    def alone(state):
        found = solve_step(world, H, state, MotorCommand(still))
        return integrate(world.tree, state, found.root, found.qdd, H)

    plain = jax.vmap(alone, -1, -1)
    gaps = quick_jit(lambda s: clearance(world.contact_model, kinematics(world.tree, s)))(state)
    assert 2 < (np.asarray(gaps) < 0).any(0).sum() < 12
    weights = jnp.asarray(np.random.default_rng(1).normal(size=state.velocity.shape))

    def outcome(velocity):
        return (weights * plain(dataclasses.replace(state, velocity=velocity)).velocity).sum()

    value = quick_jit(outcome)
    gradient = np.asarray(quick_jit(jax.grad(outcome))(state.velocity))
    assert np.isfinite(gradient).all()
    for axis in range(6):
        change = jnp.zeros_like(state.velocity).at[axis].set(1e-6)
        up, down = (value(state.velocity + sign * change) for sign in (1, -1))
        np.testing.assert_allclose(gradient[axis].sum(), (up - down) / 2e-6, rtol=1e-5, atol=1e-6)
