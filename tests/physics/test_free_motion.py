"""Conserved quantities and convergence of a tree in vacuum without gravity.

Positions and velocities leapfrog: a velocity belongs to the time half a step before its position.
So a path begins and ends with a pose half a step later than its velocities.

MuJoCo computes momentum and energy of a state (`mj_subtreeVel`, `mj_energyVel`) and the reference
path (Runge-Kutta 4 at 1/4000 s).
"""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from benchmarks.mujoco_model import mujoco_model
from creatures import STRUCTURES, coast, last, quick_jit, random_creature, random_state
from evo_cpg.creature.algebra.rotation import integrate_quaternion, quaternion_to_matrix
from evo_cpg.creature.creature import Actuator, Body, Creature, Material
from evo_cpg.creature.shapes import Box, Capsule, Ellipsoid, Sphere
from evo_cpg.creature.tree import build_tree
from evo_cpg.io.models.mujoco_state import load_state
from evo_cpg.physics.step.step import step
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.state import State
from on_ground import alone, released

DURATION = 0.5
# Steps in `DURATION`; the shortest step is 1/1920 s.
STEP_COUNTS = np.array([120, 240, 480, 960])
ORACLE_STEP = 1 / 4000
H = 1 / 120


class Vacuum:
    """MuJoCo model of a creature without gravity, springs or rotors."""

    def __init__(self, creature: Creature):
        self.tree = build_tree(creature)
        self.model = mujoco_model(
            creature, {"gravity": "0 0 0", "integrator": "RK4", "timestep": ORACLE_STEP}
        )
        self.data = mujoco.MjData(self.model)

    def conserved(self, state: State) -> dict[str, np.ndarray]:
        """Return linear and angular momentum (about the world's origin) and kinetic energy."""
        load_state(self.model, self.data, self.tree, state)
        mujoco.mj_forward(self.model, self.data)
        mujoco.mj_subtreeVel(self.model, self.data)
        mujoco.mj_energyVel(self.model, self.data)
        linear = self.model.body_subtreemass[1] * self.data.subtree_linvel[1]
        orbital = np.cross(self.data.subtree_com[1], linear)
        return {
            "linear momentum": linear,
            "angular momentum": self.data.subtree_angmom[1] + orbital,
            "energy": self.data.energy[1:2].copy(),
        }

    def position_after(self, state: State) -> np.ndarray:
        """Return the position of the root's centre after `DURATION`."""
        load_state(self.model, self.data, self.tree, state)
        for _ in range(round(DURATION / ORACLE_STEP)):
            mujoco.mj_step(self.model, self.data)
        return self.data.qpos[:3].copy()


def at_speed(state: State, factor: float) -> State:
    """Return the pose with all velocities multiplied by a factor."""
    return dataclasses.replace(state, velocity=factor * state.velocity, qd=factor * state.qd)


def moved_on(state: State, time: float) -> State:
    """Return the state after some time at constant velocities."""
    return dataclasses.replace(
        state,
        position=state.position + time * state.velocity[3:],
        orientation=integrate_quaternion(state.orientation, state.velocity[:3], time),
        q=state.q + time * state.qd,
    )


def bare(creature: Creature) -> Creature:
    """Return the creature with free joints: no springs, dampers or rotors."""
    free = {"stiffness": 0.0, "damping": 0.0, "armature": 0.0}
    bodies = [
        dataclasses.replace(body, joint=body.joint and dataclasses.replace(body.joint, **free))
        for body in creature.bodies
    ]
    return Creature(creature.name, tuple(bodies))


@pytest.fixture(scope="module")
def errors():
    """Return the error of each quantity after `DURATION` for each of `STEP_COUNTS`.

    Free motion has no time scale. Dividing all speeds by s, with s times the number of steps, gives
    the path of a step divided by s. So one compiled step serves all.
    """
    with jax.enable_x64(True):
        rng = np.random.default_rng(5)
        creature = bare(random_creature(rng, STRUCTURES[2], limits=99.0, axes_seed=3))
        vacuum, tree = Vacuum(creature), build_tree(creature)
        world, h = World(tree, 0.0), DURATION / STEP_COUNTS[0]
        start = random_state(tree, rng)
        scale = STEP_COUNTS / STEP_COUNTS[0]
        slower = [moved_on(at_speed(start, 1 / s), h / 2) for s in scale]
        states = jax.tree.map(lambda *parts: jnp.stack(parts, -1), *slower)
        states = coast(world, states, STEP_COUNTS[-1] * h, h)
        before = vacuum.conserved(start) | {"position": vacuum.position_after(start)}
        result = {name: [] for name in before}
        for i, count in enumerate(STEP_COUNTS):
            end = jax.tree.map(lambda x, i=i, count=count: x[count - 1, ..., i], states)
            end = at_speed(moved_on(end, -h / 2), scale[i])
            after = vacuum.conserved(end) | {"position": np.asarray(end.position)}
            for name, value in after.items():
                size = np.linalg.norm(before[name])
                result[name].append(np.linalg.norm(value - before[name]) / size)
        return result


@pytest.mark.slow
@pytest.mark.parametrize("name", ["linear momentum", "angular momentum", "energy", "position"])
def test_free_motion_converges_at_second_order(errors, name):
    """The exponent of the error in h, over three halvings, is 2 within 0.2."""
    order = -np.polyfit(np.log(STEP_COUNTS), np.log(errors[name]), 1)[0]
    assert abs(order - 2) < 0.2, (order, errors[name])


def test_a_single_body_keeps_its_linear_momentum_exactly():
    """The centre of a tumbling free body has a constant velocity, to rounding."""
    tree = build_tree(Creature("box", (Body("b", Box((0.3, 0.2, 0.1)), Material(1000.0)),)))
    start = random_state(tree, np.random.default_rng(1))
    end = after_steps(World(tree, 0.0), start, 200)
    np.testing.assert_allclose(end.velocity[3:], start.velocity[3:], rtol=1e-13)
    travelled = start.position + 200 * H * start.velocity[3:]
    np.testing.assert_allclose(end.position, travelled, rtol=1e-12)


def test_a_sphere_spins_at_a_constant_rate():
    """A sphere's angular momentum is parallel to its angular velocity, so both are constant."""
    tree = build_tree(Creature("ball", (Body("b", Sphere(0.1), Material(1000.0)),)))
    start = random_state(tree, np.random.default_rng(2))
    end = after_steps(World(tree, 0.0), start, 200)
    np.testing.assert_allclose(end.velocity[:3], start.velocity[:3], rtol=1e-12)


def test_free_fall_is_exact():
    """Semi-implicit Euler with constant g gives z_n = z_0 + v_0 n h - g h^2 n (n + 1) / 2."""
    tree = build_tree(Creature("box", (Body("b", Box((0.3, 0.2, 0.1)), Material(1000.0)),)))
    start = random_state(tree, np.random.default_rng(3))
    n = 200
    end = after_steps(World(tree, 9.81), start, n)
    fall = 9.81 * H**2 * n * (n + 1) / 2
    expected = start.position[2] + start.velocity[5] * n * H - fall
    np.testing.assert_allclose(end.position[2], expected, rtol=1e-12)


def after_steps(world: World, state: State, count: int) -> State:
    """Return the state after some steps without motors."""
    return last(coast(world, state, count * H, H))


@pytest.mark.slow
def test_motors_at_their_limits_do_not_change_the_momentum():
    """Joint torques are internal, so a thrashing tree that starts at rest has no momentum, to O(h).

    The momentum error of a step is of second order in h, as in free motion. So half the step gives
    half the error over a fixed time. The test asserts this and the size of the error.
    """
    rng = np.random.default_rng(8)
    motor = Actuator(2.0, 0.2)
    creature = bare(random_creature(rng, ((0, 2), (0, 1)), limits=99.0, motor=motor, axes_seed=2))
    world, vacuum = World(build_tree(creature), 0.0), Vacuum(creature)
    still = random_state(world.tree, rng, speed=0.0)
    target = jnp.asarray(rng.choice([-5.0, 5.0], world.tree.dof_count))
    sizes = []
    for count in (60, 120):
        h = DURATION / count

        def advance(s, _, h=h):
            s, effort = step(world, s, target, h)
            return s, jnp.abs(effort.torque).max()

        run = quick_jit(lambda s, f=advance, n=count: jax.lax.scan(f, s, None, n))
        end, torque = run(still)
        assert float(torque.max()) == 0.2
        after = vacuum.conserved(end)
        scale = np.sqrt(2 * after["energy"][0] * creature.mass)
        sizes.append(np.linalg.norm(after["linear momentum"]) / scale)
    assert sizes[0] < 0.02
    assert sizes[1] < 0.6 * sizes[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shape", "h"),
    [
        (Capsule(0.03, 0.3), 1 / 240),
        (Ellipsoid((0.15, 0.06, 0.03)), 1 / 240),
        (Box((0.3, 0.12, 0.06)), 1 / 240),
        (Capsule(0.03, 0.3), 1 / 60),
    ],
)
def test_a_tumbling_body_keeps_its_energy_and_momentum(x64, shape, h):
    """The magnitudes are kept. The momentum's direction drifts: positions use the new velocity."""
    world, count = alone(shape), 12
    rng = np.random.default_rng(0)
    spin = rng.normal(size=(3, count))
    spin *= np.array([5.0, 20.0, 40.0])[np.arange(count) % 3] / np.linalg.norm(spin, axis=0)
    start = released(world, np.full((3, count), 50.0), np.concatenate([spin, 0 * spin]))

    states = coast(world, start, 2.0, h)
    orientation, velocity = states.orientation, states.velocity
    turn = np.asarray(quaternion_to_matrix(jnp.moveaxis(orientation, 1, 0)))
    own = np.einsum("ijtn,tin->jtn", turn, np.asarray(velocity)[:, :3])
    momentum = np.einsum("ij,jtn->itn", world.tree.inertia[:3, :3, 0], own)
    energy, size = (own * momentum).sum(0), np.linalg.norm(momentum, axis=0)
    # The error grows with the square of the angle of a step: 0.17 or 0.67 rad at 40 rad/s.
    wobble = 0.3 if h > 1 / 100 else 0.02
    assert (energy.max(0) / energy[0]).max() < 1 + wobble
    assert (energy.min(0) / energy[0]).min() > 1 - wobble
    assert (size.max(0) / size.min(0)).max() < 1 + wobble
    # The second half of the time has no larger errors than the first half.
    first, second = np.split(energy, 2)
    assert (second.max(0) / first.max(0)).max() < 1.01
