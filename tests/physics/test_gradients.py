"""Derivatives through swimming and walking against central differences."""

import dataclasses
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import box_chain, hinge, in_water, jit_as_for_users, quick_jit, slope
from evo_cpg.creature.creature import Actuator, Body, Creature, Material
from evo_cpg.creature.shapes import Sphere
from evo_cpg.creature.tree import build_tree
from evo_cpg.io.build import build_experiment
from evo_cpg.io.load import load_config
from evo_cpg.physics.contact.contact_model import Ground, make_contact_model
from evo_cpg.physics.step.step import step
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.joint_torque import MotorCommand
from evo_cpg.physics.tree.state import resting_state
from evo_cpg.physics.water.fluid import Drag
from evo_cpg.simulation.situation import starting_state

WALKER = Path(__file__).parents[2] / "configs" / "fukui2003_model1.yaml"
H = 1 / 120
STEPS = 60
# Wave amplitude (rad/s), frequency (Hz) and C_d.
PARAMETERS = np.array([3.0, 1.3, 1.1])
# Relative errors of central differences: rounding gives at most 1e-7, curvature 1e-6 (a quadruped
# that pushes itself off). Curvature grows with the square: 1e-5 with a difference of 1e-6.
DIFFERENCE = 3e-7


# The backward pass of the motors' limits takes more than a minute to compile.
LIMITS = pytest.mark.parametrize(
    "torque_limit", [np.inf, pytest.param(50.0, marks=pytest.mark.slow)]
)


def make_swim(torque_limit: float, bodies: int = 3, axes: str = "yz", steps: int = STEPS):
    """Return a function from `PARAMETERS` to weighted displacement (m) and peak torque.

    The chain bends about both axes and does not reach a finite limit.
    """
    world = in_water(box_chain(bodies, axes, Actuator(5.0, torque_limit)))
    joints = bodies - 1
    phase = np.repeat(np.arange(joints), len(axes)) * 0.9 + np.tile(np.arange(len(axes)), joints)

    def swim(parameters):
        amplitude, frequency, form_drag = parameters
        changed = eqx.tree_at(lambda w: w.law(Drag).form_drag, world, form_drag)

        def advance(state, n):
            target = amplitude * jnp.sin(2 * jnp.pi * frequency * n * H - phase)
            state, effort = step(changed, state, target, H)
            return state, jnp.abs(effort.torque).max()

        start = resting_state(world.tree, dtype=jnp.float64)
        state, torque = jax.lax.scan(advance, start, jnp.arange(steps))
        return state.position @ jnp.array([1.0, 0.7, 0.4]), torque.max()

    return swim


@pytest.mark.slow
@LIMITS
def test_gradients_equal_central_differences(torque_limit):
    """Both modes are within 1e-6 of (f(p + e) - f(p - e)) / 2e, relative, in float64.

    The step has a kink if a point's normal velocity changes sign. A kink within e of this path is
    very unlikely, and both modes would show it.
    """
    equal_central_differences(make_swim(torque_limit), torque_limit, quick_jit)


@pytest.mark.slow
def test_gradients_with_limited_motors_equal_central_differences():
    """Differentiate a pair, compiled as for users."""
    swim = make_swim(50.0, bodies=2, axes="y")
    equal_central_differences(swim, 50.0, jit_as_for_users)


def equal_central_differences(swim, torque_limit: float, jit) -> None:
    @jit
    def forward(parameters, direction):
        (value, torque), (gradient, _) = jax.jvp(swim, (parameters,), (direction,))
        return value, gradient, torque

    units = jnp.eye(len(PARAMETERS))
    differences, gradients = [], []
    for unit in units:
        (up, *_), (down, *_) = (
            forward(PARAMETERS + sign * DIFFERENCE * unit, unit) for sign in (1, -1)
        )
        differences.append((up - down) / (2 * DIFFERENCE))
        _, gradient, torque = forward(jnp.asarray(PARAMETERS), unit)
        gradients.append(gradient)
        assert 0 < torque < torque_limit
    assert np.abs(differences).min() > 1e-4
    np.testing.assert_allclose(gradients, differences, rtol=1e-6)
    reverse, _ = jit(jax.grad(swim, has_aux=True))(jnp.asarray(PARAMETERS))
    np.testing.assert_allclose(reverse, differences, rtol=1e-6)


@pytest.mark.slow
def test_gradients_of_rolling_balls_equal_central_differences():
    """A motor joins the balls. One swings while the other rolls. Compiled as for users."""
    flesh = Material(500.0, 0.2, 0.6, 0.5)
    motor = Actuator(0.5, 20.0, stiffness=8.0)
    joint = hinge("a", (-0.15, 0, 0), (0.15, 0, 0), "y", actuator=motor)
    balls = (Body("a", Sphere(0.1), flesh), Body("b", Sphere(0.08), flesh, joint))
    creature = Creature("balls", balls)
    tree = build_tree(creature)
    ground = Ground(static_friction=0.6, dynamic_friction=0.5)
    world = World(tree, 9.81, contact_model=make_contact_model(creature, tree, ground))
    start = resting_state(tree, dtype=jnp.float64, position=(0.0, 0.0, 0.12))

    def roll(numbers):
        angle, speed, spin = numbers
        state = dataclasses.replace(
            start, velocity=start.velocity.at[3].set(speed).at[4].set(0.3).at[2].set(spin)
        )

        def advance(state, _):
            still = jnp.zeros_like(state.q)
            state, effort = step(world, state, MotorCommand(still, still + angle), 1 / 240)
            return state, effort.contact_frame_force[2].max()

        state, support = jax.lax.scan(advance, state, length=40)
        return state.position @ jnp.array([1.0, 0.7, 0.4]), support.max()

    numbers = np.array([0.3, 0.8, 0.5])
    gradient, support = jit_as_for_users(jax.grad(roll, has_aux=True))(jnp.asarray(numbers))
    assert support > 1.0
    value = jit_as_for_users(lambda numbers: roll(numbers)[0])
    differences = [slope(value, numbers, unit) for unit in np.eye(len(numbers)) * DIFFERENCE]
    assert np.abs(differences).min() > 1e-3
    np.testing.assert_allclose(gradient, differences, rtol=1e-5, atol=1e-8)


@pytest.mark.slow
def test_a_gradient_through_contact_equals_central_differences():
    """Differentiate a push-off of Fukui's quadruped, 0.25 s long, by its motors' target angles.

    Contacts that open, close or begin to slide are kinks. A kink within the difference of this path
    is unlikely.
    """
    simulation = build_experiment(load_config(WALKER), WALKER).simulation
    world, h = simulation.world, simulation.step_length
    start = starting_state(simulation.situations, None, world.tree, (), np.dtype(float))
    angles = np.linspace(-0.3, 0.4, world.tree.dof_count)

    def walk(angles):
        def advance(state, _):
            state, effort = step(world, state, MotorCommand(jnp.zeros_like(angles), angles), h)
            return state, effort.contact_frame_force[2].max()

        state, support = jax.lax.scan(advance, start, length=60)
        return state.position @ jnp.array([1.0, 0.7, 0.4]), support.max()

    gradient, support = quick_jit(jax.grad(walk, has_aux=True))(jnp.asarray(angles))
    assert support > 1.0
    value = quick_jit(lambda angles: walk(angles)[0])
    differences = [slope(value, angles, unit) for unit in np.eye(len(angles)) * DIFFERENCE]
    assert np.abs(differences).max() > 1e-3
    np.testing.assert_allclose(gradient, differences, rtol=1e-5, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize(("seconds", "difference", "error"), [(1, 3e-9, 1e-5), (2, 1e-9, 1e-4)])
def test_median_gradients_of_walkers_equal_central_differences(seconds, difference, error):
    """Differentiate 16 of Fukui's quadrupeds in random postures along a random direction each.

    Contacts that open, close or begin to slide are kinks, and some paths have one within the
    difference. The test therefore uses the median error. After 1 s it is 1e-6 for half-widths from
    3e-9 to 1e-7. Narrower differences have rounding errors (1e-5 at 1e-9), and wider differences
    have kinks (1e-3 at 1e-6). After 2 s changes have grown more, and kinks lie within 3e-9 (7e-4).
    """
    simulation = build_experiment(load_config(WALKER), WALKER).simulation
    world, h, count = simulation.world, simulation.step_length, 16
    start = starting_state(simulation.situations, None, world.tree, (count,), np.dtype(float))
    rng = np.random.default_rng(6)
    postures = rng.uniform(-0.6, 0.6, (3 * seconds, world.tree.dof_count, count))
    direction = rng.normal(size=postures.shape)
    held = np.arange(240 * seconds) // 80

    def walk(postures):
        def advance(state, number):
            still = jnp.zeros_like(state.q)
            state, _ = step(world, state, MotorCommand(still, postures[number]), h)
            return state, None

        state, _ = jax.lax.scan(jax.checkpoint(advance), start, held)
        return state.position[0] + 0.5 * state.position[1]

    gradient = quick_jit(jax.grad(lambda x: walk(x).sum()))(jnp.asarray(postures))
    ours = (np.asarray(gradient) * direction).sum((0, 1))
    value = quick_jit(walk)
    ahead, behind = (value(postures + sign * difference * direction) for sign in (1.0, -1.0))
    differences = np.asarray(ahead - behind) / (2 * difference)
    assert np.abs(differences).min() > 1e-4
    assert np.median(np.abs(ours / differences - 1)) < error
