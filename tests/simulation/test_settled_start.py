"""A released creature rests where Archimedes', Coulomb's and Newton's laws place it."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from creatures import coast, hinge, in_water
from evo_cpg.creature.algebra.rotation import quaternion_to_matrix
from evo_cpg.creature.creature import Actuator, Body, Creature, Material
from evo_cpg.creature.shapes import Box, Capsule, Sphere
from evo_cpg.creature.tree import build_tree
from evo_cpg.native.jax_internals import quick_jit
from evo_cpg.physics.contact.contact_model import Ground, make_contact_model
from evo_cpg.physics.contact.contact_points import clearance
from evo_cpg.physics.contact.terrain import Plane
from evo_cpg.physics.step.step import first_warmstart, step
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import State, resting_state
from evo_cpg.simulation import settle
from evo_cpg.simulation.plans import Programs
from evo_cpg.simulation.settle import NoRestError, Settling
from evo_cpg.simulation.situation import Situation

pytestmark = pytest.mark.usefixtures("x64")

H = 1 / 240


def alone(shape, density: float, friction: float = 0.5) -> Creature:
    material = Material(density, static_friction=friction, dynamic_friction=friction)
    return Creature("alone", (Body("body", shape, material),))


def on_ground(creature: Creature, floor=None, friction: float = 0.5) -> World:
    tree = build_tree(creature)
    ground = Ground(static_friction=friction, dynamic_friction=friction, floor=floor or Plane())
    return World(tree, 9.81, contact_model=make_contact_model(creature, tree, ground))


def turn(situation: Situation) -> np.ndarray:
    return np.asarray(quaternion_to_matrix(jnp.array(situation.orientation)))


def settled(world: World, *start, **more) -> Situation:
    return settle.settled(lambda: Settling(world, H), world, H, Situation(*start, **more))


def draught(area, reach: float, fraction: float) -> float:
    """Return the height of a body's centre above the surface, from its horizontal slices."""
    whole = quad(area, -reach, reach)[0]
    return -brentq(lambda z: quad(area, -reach, z)[0] - fraction * whole, -reach, reach)


def capsule_slice(z: float) -> float:
    width = np.sqrt(max(0.1**2 - z**2, 0.0))
    return np.pi * width**2 + 2 * width * 0.3


@pytest.mark.slow
def test_animals_that_differ_in_numbers_share_compiled_programs():
    def floating(fraction):
        return settled(
            in_water(alone(Box((0.7, 0.5, 0.1)), 1000 * fraction), surface=0.2), (0, 0, 0.5)
        )

    first, compiled = floating(0.5), list(settle._searches.kept)
    second = floating(0.8)
    assert settle._searches.kept == compiled
    sank = first.start_position[2] - second.start_position[2]
    # The immersed fraction of a level box's height is its relative density.
    assert sank == pytest.approx(0.3 * 0.1, abs=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shape", "area", "reach", "error"),
    [
        (Box((0.8, 0.6, 0.1)), lambda z: 1.0, 0.05, 1e-7),
        (Sphere(0.2), lambda z: 0.2**2 - z**2, 0.2, 1e-7),
        # The error of a disc's horizontal slices is 0.004 of its area (see `buoyancy`).
        (Capsule(0.1, 0.3), capsule_slice, 0.1, 0.004 * np.pi / 2 * 0.1),
    ],
)
@pytest.mark.parametrize("fraction", [0.5, 0.8])
def test_bodies_float_at_their_draught(shape, area, reach, error, fraction):
    """The body starts above the surface, does not tilt, and keeps its place and heading."""
    world = in_water(alone(shape, 1000 * fraction), surface=0.2)
    found = settled(world, (1.0, 2.0, 0.5), 0.7)
    expected = 0.2 + draught(area, reach, fraction)
    assert found.start_position == pytest.approx((1.0, 2.0, expected), abs=error)
    np.testing.assert_allclose(turn(found)[:2, 0], [np.cos(0.7), np.sin(0.7)], atol=1e-7)


@pytest.mark.parametrize(("width", "angle"), [(0.2, 45.0), (0.4, 0.0)])
@pytest.mark.slow
def test_a_log_of_square_section_floats_on_its_edge_and_a_board_flat(width, angle):
    """Half immersed, GM = w^2 / (6 t) - t / 4, which is negative for the log (w = t).

    The start is exactly flat on the water, where no moment acts on either.
    """
    world = in_water(alone(Box((1.0, width, 0.2)), 500.0), surface=0.0)
    metacentric = width**2 / (6 * 0.2) - 0.2 / 4
    assert (metacentric < 0) == (angle > 0)
    found = settled(world)
    roll = np.rad2deg(np.arccos(np.clip(turn(found)[2, 2], -1, 1)))
    assert roll == pytest.approx(angle, abs=1e-3)
    assert found.start_position == pytest.approx((0, 0, 0), abs=1e-7)


@pytest.mark.slow
def test_righting_stiffness_follows_from_the_metacentre():
    """K = rho g V GM about the centre of gravity, half immersed."""
    world = in_water(alone(Box((1.0, 0.4, 0.2)), 500.0), surface=0.0)
    rest = Settling(world, H).rest(resting_state(world.tree, (), jnp.float64))
    radius = np.sqrt((1.0 + 0.4**2 + 0.2**2) / 12)
    # Level boxes are up to 2 % stiffer, because every extent counts as 5 % of the reach.
    roll = (0.4**2 / (6 * 0.2) - 0.2 / 4) / radius
    pitch = (1.0**2 / (6 * 0.2) - 0.2 / 4) / radius
    heave = radius / 0.1
    found = np.sort(rest.stiffness)
    np.testing.assert_allclose(found[:3], 0, atol=1e-9)
    np.testing.assert_allclose(found[3:], np.sort([roll, pitch, heave]), rtol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("slope", [0.0, 20.0])
def test_a_box_rests_on_level_ground_and_on_a_moderate_slope(slope):
    """Normal forces sum to m g cos a, and the box hardly moves in a simulation."""
    a = np.deg2rad(slope)
    normal = (-float(np.sin(a)), 0.0, float(np.cos(a)))
    creature = alone(Box((0.4, 0.3, 0.1)), 300.0)
    world = on_ground(creature, Plane(normal=normal))
    start = resting_state(world.tree, (), jnp.float64, position=(0.0, 0.0, 0.2))
    rest = Settling(world, H).rest(start)
    load = creature.mass * 9.81 * np.cos(a)
    assert rest.normal_force.sum() == pytest.approx(load, rel=1e-3)
    away = np.array(rest.state.position) @ normal
    assert away == pytest.approx(0.05, abs=1e-4)
    up = np.asarray(quaternion_to_matrix(rest.state.orientation))[:, 2]
    np.testing.assert_allclose(up, normal, atol=1e-4)
    motion = coast(world, rest.state, 0.25, H)
    # The creep rate of friction is f / c, with f = m g sin a / 4 and c = 60 m / h.
    creep = 9.81 * np.sin(a) / 4 / 60 * H
    displacement = np.linalg.norm(motion.position - np.asarray(rest.state.position), axis=1)[-1]
    assert displacement == pytest.approx(0.25 * creep, rel=0.05, abs=1e-8)


def legged(stiffness: float, legs, length: float = 0.2, friction: float = 0.8) -> Creature:
    """Return a slab on straight legs with springs at the hips."""
    flesh = Material(500.0, static_friction=friction, dynamic_friction=friction)
    bodies = [Body("torso", Box((0.5, 0.3, 0.1)), flesh)]
    for i, (x, y) in enumerate(legs):
        motor = Actuator(3.0, stiffness=stiffness)
        hip = hinge("torso", (x, y, -0.05), (0.0, 0.0, length / 2), "y", actuator=motor)
        bodies.append(Body(f"leg{i}", Box((0.05, 0.05, length)), flesh, hip))
    return Creature("legged", tuple(bodies))


FOUR = [(x, y) for x in (-0.2, 0.2) for y in (-0.12, 0.12)]


THREE, CROSS = [(0.2, 0), (-0.2, -0.12), (-0.2, 0.12)], [(0.2, 0), (-0.2, 0), (0, -0.12), (0, 0.12)]
STARTS = {
    "box": lambda friction: alone(Box((0.4, 0.3, 0.1)), 300.0, friction),
    "capsule": lambda friction: alone(Capsule(0.05, 0.3), 300.0, friction),
    "quadruped": lambda friction: legged(100.0, FOUR, friction=friction),
    "tripod": lambda friction: legged(150.0, THREE, friction=friction),
    "cross": lambda friction: legged(100.0, CROSS, friction=friction),
}


class _Run:
    """Simulate a creature whose velocities shrink by a factor in each step."""

    def __init__(self, plan):
        def run(numbers, state, steps, factor):
            world = plan.world(numbers)

            def advance(carry):
                state, warmstart, index, quiet = carry
                state, effort = step(world, state, jnp.zeros_like(state.q), H, warmstart)
                fastest = jnp.abs(jnp.concatenate([state.velocity, state.qd])).max()
                slowed = factor * state.velocity, factor * state.qd
                state = dataclasses.replace(state, velocity=slowed[0], qd=slowed[1])
                return state, effort.warmstart, index + 1, jnp.where(fastest < 1e-3, quiet + 1, 0)

            warmstart = first_warmstart(world, (), jnp.float64)
            carry = state, warmstart, 0, 0
            end = jax.lax.while_loop(lambda carry: carry[2] < steps, advance, carry)
            return end[0], end[3]

        self.run = quick_jit(run)


_runs = Programs(_Run)


def simulated(world, state, seconds, factor):
    """Return the state at the end, and the steps for which the motion was slow until then."""
    program, numbers = _runs.of(world)
    return program.run(numbers, state, round(seconds / H), factor)


def random_start(name: str, rng) -> tuple[World, State]:
    """Return a creature up to 0.1 m above a slope of 0 to 97 % of its friction limit."""
    friction = rng.uniform(0.2, 1.0)
    angle = np.arctan(rng.uniform(0.0, 0.97) * friction)
    floor = Plane(normal=(-float(np.sin(angle)), 0.0, float(np.cos(angle))))
    world = on_ground(STARTS[name](friction), floor, friction)
    tree = world.tree
    half = rng.uniform(-np.pi, np.pi) / 2
    turned = float(np.cos(half)), 0.0, 0.0, float(np.sin(half))
    high = resting_state(tree, (), jnp.float64, (0.0, 0.0, 1.0), turned)
    lowest = clearance(world.contact_model, kinematics(tree, high)).min()
    gap = float(lowest) - rng.uniform(0.0, 0.1)
    height = 1.0 - gap / float(np.cos(angle))
    start = resting_state(tree, (), jnp.float64, (0.0, 0.0, height), turned)
    return world, start


@pytest.mark.slow
@pytest.mark.parametrize("name", STARTS)
def test_starts_rest_where_the_simulation_rests(name):
    """An accepted start stays for a second. A refused one moves on in 20 s of damped motion.

    One start in 40 may differ, because a creature that lands on an edge may tip either way.
    """
    rng = np.random.default_rng(70)
    differ = []
    for i in range(40):
        world, start = random_start(name, rng)
        try:
            rest = Settling(world, H).rest(start).state
        except NoRestError as error:
            end, quiet = simulated(world, start, 20.0, 0.9)
            before, after = (quaternion_to_matrix(np.asarray(s.orientation)) for s in (start, end))
            tilt = np.arccos(np.clip((after @ before.T)[2, 2], -1.0, 1.0))
            if quiet >= 30 and tilt < np.deg2rad(60.0):
                differ.append((i, str(error)))
        else:
            end, _ = simulated(world, rest, 1.0, 1.0)
            if np.linalg.norm(end.position - rest.position) > 2e-3:
                differ.append((i, "moves"))
    assert len(differ) <= 1, differ


@pytest.mark.slow
def test_creatures_that_cannot_rest_are_refused():
    """The steep slope exceeds the angle of friction, 26.6 degrees."""
    stone, cork = (alone(Box((0.2, 0.2, 0.2)), density) for density in (2000.0, 500.0))
    a = np.deg2rad(28.0)
    steep = Plane(normal=(-float(np.sin(a)), 0.0, float(np.cos(a))))
    cases = [
        (in_water(stone, surface=0.0), 0.0, r"it sinks, .* mass is 16 kg, .* at most 8 kg"),
        (in_water(cork), 0.0, r"it rises, .* mass is 4 kg"),
        (World(build_tree(cork), 9.81), 0.0, "neither ground nor water"),
        (on_ground(legged(2000.0, [(0.1, 0.0)], length=1.0)), 1.05, r"it falls over .*\d\d deg"),
        (on_ground(alone(Box((0.4, 0.3, 0.1)), 300.0), steep), 0.2, "no rest within 20 s"),
    ]
    for world, height, words in cases:
        with pytest.raises(NoRestError, match=words):
            settled(world, (0.0, 0.0, height))


@pytest.mark.slow
def test_a_motor_without_a_spring_needs_the_torque_to_hold():
    """A board on a motor hangs over the edge of a raft. The torque is weight times lever."""
    flesh = Material(500.0)
    arm = hinge("raft", (0.5, 0, 0.3), (-0.2, 0, 0), "y", actuator=Actuator(5.0, 1.0))
    parts = (
        Body("raft", Box((1.0, 1.0, 0.2)), flesh),
        Body("arm", Box((0.4, 0.1, 0.1)), flesh, arm),
    )
    world = in_water(Creature("crane", parts), surface=0.0)
    with pytest.raises(NoRestError, match=r"arm.y would have to hold 3.\d* N m, but its"):
        settled(world)


@pytest.mark.slow
def test_a_nearly_neutral_box_sinks_to_the_ground():
    """It weighs a fiftieth in water, so the 2 m take seven times as long as on dry land."""
    creature = alone(Box((0.4, 0.3, 0.1)), 1020.0)
    floor = on_ground(creature).contact_model
    world = dataclasses.replace(in_water(creature, surface=5.0), contact_model=floor)
    found = settled(world, (0.0, 0.0, 2.0))
    assert found.start_position == pytest.approx((0.0, 0.0, 0.05), abs=1e-4)
