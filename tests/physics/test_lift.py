"""Lift of plates against measured plates, closed forms and finite differences."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

from creatures import (
    coast,
    hinge,
    in_water,
    quick_jit,
    random_state,
    resting,
    single,
    slope,
    surfaces_of,
    whole,
)
from evo_cpg.creature.algebra.decisions import recording_decisions, replaying_decisions
from evo_cpg.creature.creature import Actuator, Body, Creature, Joint, Material
from evo_cpg.creature.shapes import Box, Ellipsoid, Sphere
from evo_cpg.creature.tree import build_tree
from evo_cpg.io.build import build_simulation
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.load import load_config
from evo_cpg.physics.step.step import step
from evo_cpg.physics.step.world import World
from evo_cpg.physics.tree.kinematics import kinematics
from evo_cpg.physics.tree.state import resting_state
from evo_cpg.physics.water.force_law import Bodies
from evo_cpg.physics.water.lift import PlateLift, make_plate_lift
from evo_cpg.physics.water.viscous_bodies import make_viscous_drag
from evo_cpg.physics.water.water import Current, Water
from measured_water import LIFT
from tiny_run import CONFIG, VISCOUS

WATER, GRAVITY = 1000.0, 9.81


def lifted(creature: Creature, viscosity: float | None = None, **options) -> World:
    """A creature in water with lift; with a viscosity, with its drag, too."""
    tree = build_tree(creature)
    forces = (make_plate_lift(creature, tree, **options),)
    if viscosity is not None:
        form, skin = surfaces_of(creature, 2, 1)
        forces += (make_viscous_drag(creature, tree, form, skin, viscosity),)
    return World(tree, 0.0, Water(WATER), forces)


def towed(world: World, velocity: np.ndarray) -> Bodies:
    """A single body with velocities ``(6, n)`` in its own axes."""
    state = resting_state(world.tree, velocity.shape[1:], jnp.float64)
    bodies = world.bodies(kinematics(world.tree, state), 0.01)
    return bodies.moving(jnp.asarray(velocity)[:, None])


def wrench(world: World, velocity: np.ndarray) -> np.ndarray:
    """The wrench ``(6, n)`` of all laws on a single body."""

    @quick_jit
    def total(velocity):
        bodies = towed(world, velocity)
        return sum(law.wrench(bodies)[:, 0] for law in world.forces)

    return np.asarray(total(velocity))


def at_angles(angles: np.ndarray, direction: tuple[float, float] = (1.0, 0.0)) -> np.ndarray:
    """Twists of 1 m/s at angles (rad) to the plane of x and y."""
    along = np.cos(angles)
    zero = np.zeros_like(angles)
    return np.stack([zero, zero, zero, direction[0] * along, direction[1] * along, -np.sin(angles)])


def added(angle, aspect):
    """C_N(a) - C_N(90) sin^2 a of the page on water, and C_N(a)."""
    s, c = np.sin(angle), np.cos(angle)
    slope = 2 * np.pi * aspect / (2 + np.sqrt(aspect**2 + 4))
    attached = 0.9 * slope * s * c + 2.2 * s**2
    finite = 0.41 * (1 - np.exp(-17 / aspect))
    stalled = 2 * (1 / (0.56 + 0.44 * s) - finite) * s * (1 + 0.81 * s**4 * c**2)
    stall = 0.1 + 0.74 / (1 + 1.1 * aspect)
    weight = 1 / (1 + np.exp((stall - s) / 0.04))
    whole = attached + weight * (stalled - attached)
    return whole - 2 * (1 - finite) * s**2, whole


@pytest.mark.parametrize(("aspect", "reynolds", "table"), LIFT)
def test_lift_of_plates_equals_measurements(aspect, reynolds, table, x64):
    """Within 20 % with the drag of the plate, whose chord is along x."""
    chord = 0.2
    plate = single(Box((chord, aspect * chord, 0.02 * chord)))
    angles, expected = np.transpose([pair for pair in table if pair[0] <= 60])
    angles = np.deg2rad(angles)
    world = lifted(plate, viscosity=WATER * chord / reynolds)
    force = wrench(world, at_angles(angles))[3:] / (0.5 * WATER * chord**2 * aspect)
    lift = force[0] * np.sin(angles) + force[2] * np.cos(angles)
    np.testing.assert_allclose(lift, expected, rtol=0.2)


@pytest.mark.parametrize("lengths", [(0.1, 0.2), (0.3, 0.1)])
def test_force_is_the_stated_formula(lengths, x64):
    """For flow along either side and obliquely: the span is that of the extents across the flow."""
    area = lengths[0] * lengths[1]
    world = lifted(single(Box((*lengths, 0.004))))
    angles = np.deg2rad(np.linspace(0, 89.9, 19))
    for turn in np.deg2rad((0.0, 35.0, 90.0)):
        direction = np.cos(turn), np.sin(turn)
        span = np.hypot(lengths[1] * direction[0], lengths[0] * direction[1])
        found = wrench(world, at_angles(angles, direction))
        force, whole = added(angles, span**2 / area)
        scale = 0.5 * WATER * area
        np.testing.assert_allclose(found[5], scale * force, rtol=1e-6, atol=1e-5)
        np.testing.assert_allclose(found[3:5], 0.0, atol=1e-9)
        # The whole force acts ahead of the centre, and turns the leading edge up.
        moment = found[0] * direction[1] - found[1] * direction[0]
        lever = area / span / 4 * (1 - np.sin(angles))
        np.testing.assert_allclose(moment, scale * whole * lever, rtol=1e-6, atol=1e-5)


@pytest.mark.slow
def test_derivatives_equal_finite_differences(x64):
    """Of the wrench, and of the two parts of the step: D and the averaged rest."""
    wing = Body("b0", Box((0.1, 0.2, 0.005)), Material(WATER))
    joint = hinge("b0", (0, 0.1, 0), (0, -0.12, 0), "x", 9.0)
    tip = Body("b1", Ellipsoid((0.1, 0.04, 0.006)), Material(WATER), joint)
    world = lifted(Creature("wing", (wing, tip)))
    law = world.forces[0]
    assert isinstance(law, PlateLift) and law.bodies == (0, 1)
    state = random_state(world.tree, np.random.default_rng(0), (3,))

    def bodies():
        return world.bodies(kinematics(world.tree, state), 0.01)

    velocity = np.asarray(quick_jit(lambda: bodies().velocity)())
    other = jnp.asarray(np.random.default_rng(1).normal(size=velocity.shape))
    wrench = quick_jit(lambda velocity: law.wrench(bodies().moving(velocity)))

    @quick_jit
    def parts(velocity):
        now = bodies().moving(velocity)
        (part,) = law.parts(now)
        return law.derivative(now), part.resistance, law.averaged(now, now.moving(other))

    derivative, resistance, rest = map(np.asarray, parts(velocity))
    for column in range(6):
        step = 1e-6 * np.eye(6)[column][:, None, None]
        difference = slope(wrench, velocity, step)
        np.testing.assert_allclose(derivative[:, column], difference, rtol=1e-6, atol=1e-5)
    damping = whole(resistance / 0.01)
    expected = np.einsum("ijbn,jbn->ibn", derivative + 2 * damping, other)
    np.testing.assert_allclose(rest, expected, rtol=1e-9, atol=1e-9)
    least = np.linalg.eigvalsh(np.moveaxis(damping, (0, 1), (-2, -1))).min()
    assert least > -1e-9 * np.abs(damping).max()


def test_lift_takes_energy_and_moves_with_the_current(x64):
    """At the centre its power is negative; in a current of its own velocity there is no force."""
    plate = single(Box((0.1, 0.3, 0.01)))
    world = lifted(plate, has_moment=False)
    velocity = np.random.default_rng(2).normal(size=(6, 200))
    velocity[5] *= 10.0 ** np.linspace(-4, 0, 200)
    force = wrench(world, velocity)
    assert ((force * velocity).sum(0) < 0).all()
    flowing = dataclasses.replace(world, water=Water(WATER, None, (Current((0.3, -0.4, 0.2)),)))
    still = wrench(world, velocity)
    carried = velocity + np.array([0, 0, 0, 0.3, -0.4, 0.2])[:, None]
    np.testing.assert_allclose(wrench(flowing, carried), still, rtol=1e-10, atol=1e-10)


def test_a_half_submerged_plate_has_half_the_lift(x64):
    plate = single(Box((0.2, 0.1, 0.01)))
    floating = in_water(plate, surface=0.0)
    floating = dataclasses.replace(floating, forces=lifted(plate).forces)
    velocity = at_angles(np.deg2rad(np.array([12.0, 50.0])))
    afloat = wrench(floating, velocity)
    deep = wrench(lifted(plate), velocity)
    np.testing.assert_allclose(afloat, deep / 2, rtol=1e-6, atol=1e-9)


def test_thin_bodies_outside_chains_have_lift(x64):
    """A cube and a sphere have none, and the weight falls from 1 to 0 without a jump."""
    weights = []
    for thickness in np.linspace(0.01, 0.099, 90):
        tree = build_tree(single(Box((0.2, 0.1, thickness))))
        law = make_plate_lift(single(Box((0.2, 0.1, thickness))), tree)
        weights.append(0.0 if law is None else float(law.weight[0]))
    assert weights[0] == 1.0 and weights[-1] == 0.0
    assert (np.diff(weights) <= 0).all() and np.abs(np.diff(weights)).max() < 0.04
    for shape in (Sphere(0.1), Box((0.1, 0.1, 0.1))):
        assert make_plate_lift(single(shape), build_tree(single(shape))) is None

    def row(count):
        bodies = [Body("b0", Box((0.1, 0.01, 0.08)), Material(WATER))]
        for i in range(1, count):
            joint = hinge(f"b{i - 1}", (-0.05, 0, 0), (0.05, 0, 0))
            bodies.append(Body(f"b{i}", Box((0.1, 0.01, 0.08)), Material(WATER), joint))
        return Creature("row", tuple(bodies))

    assert make_plate_lift(row(3), build_tree(row(3))) is None
    pair = make_plate_lift(row(2), build_tree(row(2)))
    assert pair is not None and pair.bodies == (0, 1)


@pytest.mark.slow
def test_bodies_of_a_batch_keep_thick_and_empty_bodies(x64):
    """With the layout "complete" every body has finite numbers and thick ones have no force."""
    joint = hinge("b0", (0.1, 0, 0), (0, 0.0, 0), "x")
    empty = Body("b1", Box((0.0, 0.0, 0.0)), Material(WATER), joint)
    creature = Creature("two", (Body("b0", Box((0.1, 0.1, 0.1)), Material(WATER)), empty))
    law = make_plate_lift(creature, build_tree(creature), layout="complete")
    assert law is not None and law.bodies == (0, 1)
    velocity = at_angles(np.deg2rad(np.array([0.0, 10.0, 90.0])))
    one = single(Box((0.1, 0.1, 0.1)))
    for k in range(2):
        kept = law.frame[..., k : k + 1], law.lengths[:, k : k + 1], law.area[k : k + 1]
        own = PlateLift((0,), *kept, law.weight[k : k + 1])
        world = World(build_tree(one), 0.0, Water(WATER), (own,))
        slopes = quick_jit(
            lambda velocity, world=world, own=own: own.derivative(towed(world, velocity))
        )
        for found in (wrench(world, velocity), slopes(velocity)):
            np.testing.assert_array_equal(found, 0.0)


def tilted(angle: float) -> np.ndarray:
    """Orientation of a body whose nose points down by an angle, rad."""
    return np.array([np.cos(angle / 2), 0.0, np.sin(angle / 2), 0.0])


def test_a_tilted_plate_glides_at_its_closed_form_speed(x64):
    """Lift carries the plate along a path that the balance of forces gives.

    Its nose points down by 6 degrees. Form drag is 2 k on each front, so that along the normal
    ``W cos t = 1/2 rho V^2 S (added C_N + 2 k sin^2 a)``, and along the chord
    ``W sin t = 1/2 rho V^2 S_e 2 k cos^2 a``. Without lift the glide ratio is 1.3.
    """
    chord, span, thickness, k, tilt = 0.1, 0.3, 0.004, 0.55, np.deg2rad(6.0)
    plate = single(Box((chord, span, thickness)), density=1500.0)
    world = in_water(plate, gravity=GRAVITY, form_drag=k, skin_drag=0.0)
    lift = make_plate_lift(plate, world.tree, has_moment=False)
    assert lift is not None
    world = dataclasses.replace(world, forces=(*world.forces, lift))

    def normal(angle):
        return chord * span * (added(angle, span / chord)[0] + 2 * k * np.sin(angle) ** 2)

    edge = span * thickness * 2 * k

    def unbalance(angle):
        return normal(angle) * np.sin(tilt) - edge * np.cos(angle) ** 2 * np.cos(tilt)

    angle = scipy.optimize.brentq(unbalance, 1e-3, 1.5)
    weight = 500.0 * chord * span * thickness * GRAVITY
    speed = np.sqrt(weight * np.cos(tilt) / (0.5 * WATER * normal(angle)))
    start = resting(world.tree, orientation=tilted(tilt))
    end = coast(world, start, 20.0, 1 / 60).velocity[-1]
    path = angle + tilt
    np.testing.assert_allclose(end[3], speed * np.cos(path), rtol=1e-6)
    np.testing.assert_allclose(end[5], -speed * np.sin(path), rtol=1e-6)
    assert 1 / np.tan(path) > 4.0


@pytest.mark.slow
def test_the_step_is_of_second_order(x64):
    """Half the step gives a quarter of the error, for a plate that turns its leading edge up."""
    world = lifted(single(Box((0.1, 0.2, 0.02))))
    state = resting(world.tree, velocity=jnp.array([0.0, 0.0, 0.0, 0.3, 0.06, -0.1]))
    ends = [coast(world, state, 0.2, 0.2 / n).velocity[-1] for n in (64, 128, 1024)]
    errors = [np.abs(end - ends[-1]).max() for end in ends[:2]]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.15)


def flyer() -> Creature:
    """A trunk with two flippers, which stroke about x and twist about -y."""
    bodies = [Body("trunk", Ellipsoid((0.2, 0.08, 0.06)), Material(WATER))]
    for name, side in (("left", 1.0), ("right", -1.0)):
        joint = Joint(
            "trunk",
            (0.05, 0.08 * side, 0),
            (0.01, -0.13 * side, 0),
            ((side, 0.0, 0.0), (0.0, -1.0, 0.0)),
            (-1.2, -1.2),
            (1.2, 1.2),
            actuator=Actuator(5.0),
        )
        bodies.append(Body(name, Box((0.08, 0.24, 0.008)), Material(WATER), joint))
    return Creature("flyer", tuple(bodies))


def flight(world: World, steps: int):
    """Displacement and mean velocity along x as a function of the stroke, rad."""
    h, twist = 1 / 120, 0.3

    def fly(stroke):
        def advance(state, n):
            phase = 2 * np.pi * n * h
            rate = 2 * np.pi * jnp.stack([stroke * jnp.cos(phase), -twist * jnp.sin(phase)] * 2)
            state, _ = step(world, state, rate, h)
            return state, state.velocity[3]

        start = resting(world.tree, q=jnp.array([0.0, twist] * 2))
        state, speeds = jax.lax.scan(advance, start, jnp.arange(steps))
        return state.position[0], speeds[-120:].mean()

    return fly


@pytest.mark.slow
def test_flippers_fly_under_water(x64):
    """A stroke of 40 degrees with a twist of 17 degrees at 1 Hz, compared with drag alone."""
    whole = lifted(flyer(), viscosity=1e-3)
    assert whole.forces[0].bodies == (1, 2)
    drag = dataclasses.replace(whole, forces=whole.forces[1:])
    speeds = [float(quick_jit(flight(world, 600))(0.7)[1]) for world in (whole, drag)]
    assert speeds[0] > 1.3 * speeds[1] > 0.2


@pytest.mark.slow
def test_gradient_of_a_flight_equals_differences(x64):
    fly = flight(lifted(flyer(), viscosity=1e-3), 40)
    displacement = quick_jit(lambda stroke: fly(stroke)[0])
    found = quick_jit(jax.grad(lambda stroke: fly(stroke)[0]))(0.7)
    assert float(found) == pytest.approx(float(slope(displacement, 0.7, 1e-5)), rel=1e-6)


def configured_lift(**water) -> PlateLift | None:
    """The law of a configured pair, whose rear body is thin."""
    body = "creature.bodies.1"
    changes = [f"{body}.repeat=1", f"{body}.shape.size.1=0.02", *VISCOUS]
    changes += [f"world.water.{key}={value}" for key, value in water.items()]
    return build_simulation(load_config(CONFIG, changes))[1].world.law(PlateLift)


def test_the_configuration_adds_the_law():
    """Added mass has the moment, so the law has none with it."""
    law, heavy = (configured_lift(lift="true", added_mass=x) for x in ("false", "true"))
    assert law is not None and law.bodies == (1,) and law.has_moment
    assert heavy is not None and not heavy.has_moment
    assert configured_lift(lift="false") is None


def test_lift_needs_a_viscosity():
    with pytest.raises(ConfigError, match="lift completes the drag of water with a viscosity"):
        load_config(CONFIG, ["world.water.lift=true"])


def test_numbers_of_a_plate_have_derivatives(x64):
    """By the lengths of a box between thin and thick, against closed forms."""
    size = (0.08, 0.24, 0.03)
    tree = build_tree(single(Box(size)))

    def numbers(size):
        law = make_plate_lift(single(Box(tuple(size))), tree)
        assert law is not None
        return jnp.stack([*law.lengths[:, 0], law.area[0], law.weight[0]])

    with recording_decisions() as decisions:
        numbers(size)

    def traced(size):
        with replaying_decisions(decisions), jax.numpy_rank_promotion("allow"):
            return numbers(size)

    both = quick_jit(lambda size: (jax.jacfwd(traced)(size), traced(size)))
    slopes, values = both(jnp.array(size))
    x = 0.75 - 0.03 / 0.08
    weight = (x / 0.5) ** 2 * (3 - 2 * x / 0.5)
    np.testing.assert_allclose(values, [0.08, 0.24, 0.08 * 0.24, weight])
    by_ratio = -6 * (x / 0.5) * (1 - x / 0.5) / 0.5
    expected = [
        [1, 0, 0],
        [0, 1, 0],
        [0.24, 0.08, 0],
        [-by_ratio * 0.03 / 0.08**2, 0, by_ratio / 0.08],
    ]
    np.testing.assert_allclose(slopes, expected, rtol=1e-9, atol=1e-12)
