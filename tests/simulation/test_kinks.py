"""Points without a derivative of the fitness, and gradients on both sides of these points.

Each case is a part of a trial as a function of one number. The point is known in closed form. On
each side, the gradient equals central differences that stay on that side. The sides differ by a
kink, or by a jump, which no gradient shows.
"""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from creatures import box_chain, in_water, quick_jit
from evo_cpg.control import matsuoka
from evo_cpg.control.brain_cpg import BrainCpgSettings, build_brain_cpg
from evo_cpg.control.controller import Observation
from evo_cpg.control.matsuoka import MatsuokaState
from evo_cpg.creature.creature import Actuator
from evo_cpg.creature.shapes import Sphere
from evo_cpg.creature.tree import build_tree
from evo_cpg.physics.step.step import step
from evo_cpg.physics.tree.state import resting_state
from evo_cpg.simulation.sensors import light_strength
from on_ground import GRAVITY, H, alone, released

pytestmark = pytest.mark.usefixtures("x64")

RADIUS, FRICTION = 0.1, 0.5
# Speed that gravity adds in a step, m/s.
FALL = GRAVITY * H
# Stiffness of the ground against a single body, in units of the body's mass over h. A push at the
# rim of a rolling ball changes the rim's speed `RIM` times as much as the centre's speed.
STIFF = 60.0
RIM = 3.5


@functools.cache
def graded(outcome):
    """Return a compiled function for values and derivatives of an outcome by its first argument."""

    def total(x, *given):
        values = outcome(x, *given)
        return values.sum(), values

    return quick_jit(jax.value_and_grad(total, has_aux=True))


def both_sides(outcome, places, scales, *given) -> tuple[np.ndarray, np.ndarray]:
    """Return values and derivatives just below (first) and just above places ``(k,)``.

    Derivatives must equal central differences that do not reach the place.

    Args:
        outcome: elementwise function of numbers ``(6 k,)``, with alternating places.
        places: points between the sides.
        scales: lengths over which the outcome changes. The sides lie a ten-thousandth of it away.
        given: further arguments of the outcome.
    """
    places, scales = np.atleast_1d(places), np.atleast_1d(scales)
    away = 1e-4 * scales
    points = places + away * np.array([[-1.0], [1.0]])
    reach = away / 2
    arguments = np.stack([points, points + reach, points - reach]).ravel()
    (_, values), slopes = graded(outcome)(arguments, *given)
    here, up, down = np.asarray(values).reshape(3, *points.shape)
    slopes = np.asarray(slopes).reshape(3, *points.shape)[0]
    np.testing.assert_allclose(slopes, (up - down) / (2 * reach), rtol=1e-6, atol=1e-7)
    return here.squeeze(), slopes.squeeze()


# Unit vectors of position and velocity (angular first) of a single ball.
X_SPEED, Z = np.eye(9)[[6, 2]]


def after_a_step(x, start, along, restitution):
    """Return a component of a single ball's position or velocity after a step.

    Args:
        x: values of this component before the step.
        start: position and velocity (9,) before the step, 0 for this component.
        along: unit vector (9,) of this component.
        restitution: restitution of the ball.
    """
    world = alone(Sphere(RADIUS), static=FRICTION, dynamic=FRICTION)
    given_back = jnp.broadcast_to(restitution, world.contact_model.restitution.shape)
    world = eqx.tree_at(
        lambda w: w.contact_model, world, world.contact_model._replace(restitution=given_back)
    )
    both = start[:, None] + along[:, None] * x[None]
    after = step(world, released(world, both[:3], both[3:]), jnp.zeros((0, len(x))), H)[0]
    return along @ jnp.concatenate([after.position, after.velocity])


@pytest.mark.slow
def test_the_first_touch_is_a_kink():
    """The derivative by the initial height is 1 above this point, and 1/61 below."""
    start = np.array([0.0, 0, 0, 0, 0, 0, 0, 0, -1])
    # The ground holds a ball that would end the step below it.
    values, slopes = both_sides(after_a_step, RADIUS + H * (1.0 + FALL), H, start, Z, 0.0)
    np.testing.assert_allclose(slopes, [1 / (1 + STIFF), 1.0], rtol=1e-9)
    assert np.ptp(values) < 2e-4 * H


@pytest.mark.slow
def test_a_bounce_begins_with_a_jump():
    """A ball bounces if its speed at the start of a step would carry it into the ground."""
    speed, restitution = 1.0, 0.5
    start = np.array([0.0, 0, 0, 0, 0, 0, 0, 0, -speed])
    values, slopes = both_sides(after_a_step, RADIUS + H * speed, H, start, Z, restitution)
    jump = (1 + restitution) * speed * STIFF / (1 + STIFF) * H
    assert values[0] - values[1] == pytest.approx(jump, rel=1e-3)
    # The derivative by the height is 1 if the ball bounces. Otherwise the ground slows the ball.
    np.testing.assert_allclose(slopes, [1.0, 1 / (1 + STIFF)], rtol=1e-9)


@pytest.mark.slow
def test_slipping_begins_with_a_kink():
    """A ball sticks after a weak push (its rim keeps 1/211 of its speed), and slides after more."""
    start = np.array([0.0, 0, RADIUS, 0, 0, 0, 0, 0, 0])
    support = FALL * STIFF / (1 + STIFF)
    held = 1 + RIM * STIFF
    place = FRICTION * support * held / STIFF
    values, slopes = both_sides(after_a_step, place, place, start, X_SPEED, 0.0)
    # The rim keeps 1 / held of its speed. The centre loses the impulse of friction.
    assert slopes[0] == pytest.approx(1 - STIFF / held, rel=1e-9)
    assert slopes[1] > slopes[0] + 0.01
    assert np.ptp(values) < 2e-4 * place


@pytest.mark.slow
def test_a_joint_stop_is_a_jump():
    """The damper of the stop acts at once on a moving joint. For a joint at rest it is a kink."""
    world = in_water(box_chain(2, "z", Actuator(1.0), limit=0.5), gravity=0.0)
    speeds = np.array([1.0, 0.0])

    def outcome(angle):
        rate = jnp.tile(speeds, len(angle) // 2)
        start = resting_state(world.tree, (len(angle),), jnp.float64)
        start = dataclasses.replace(start, q=angle[None], qd=rate[None])
        return step(world, start, jnp.zeros((1, len(angle))), H)[0].qd[0]

    # The stop acts if the joint would be beyond it after the step.
    values, slopes = both_sides(outcome, 0.5 - H * speeds, [0.1, 0.1])
    assert values[0, 0] - values[1, 0] > 0.01
    assert abs(values[0, 1] - values[1, 1]) < 1e-3
    assert slopes[0, 1] == pytest.approx(0, abs=1e-9)
    assert (slopes[1] < slopes[0] - 1).all()


def test_a_reversal_of_motion_in_water_is_a_kink():
    """The step uses the drag coefficient c |v| of the speed before the step.

    m v' = m v + h (F - c |v| v') gives derivatives of 1 -+ h^2 c F / m^2 at v = 0.
    """
    density, area = 500.0, 0.2 * 0.1
    world = in_water(box_chain(1, ""), density=density, skin_drag=0.0)

    def outcome(speed):
        start = resting_state(world.tree, (len(speed),), jnp.float64)
        start = dataclasses.replace(start, velocity=start.velocity.at[5].set(speed))
        return step(world, start, jnp.zeros((0, len(speed))), H)[0].velocity[5]

    values, slopes = both_sides(outcome, 0.0, 1e-2)
    volume = area * 0.1
    mass, force = 1000 * volume, (density - 1000) * volume * GRAVITY
    # Each of two faces has half of rho C_d A.
    bend = H**2 * density * area * force / mass**2
    np.testing.assert_allclose(slopes - 1, [bend, -bend], rtol=1e-2)
    assert np.ptp(values) < 1e-5


@pytest.mark.slow
def test_the_waterline_is_no_kink():
    """Derivatives agree if a box's lower or upper side is at the surface.

    At a hundredth of the distance they differ a hundred times less, because of curvature only.
    """
    world = in_water(box_chain(1, ""), surface=0.0)

    def outcome(height):
        start = resting_state(world.tree, (len(height),), jnp.float64)
        start = dataclasses.replace(
            start,
            position=start.position.at[2].set(height),
            velocity=start.velocity.at[3].set(1.0).at[5].set(-1.0),
        )
        return step(world, start, jnp.zeros((0, len(height))), H)[0].velocity[5]

    edges, scales = [0.05, -0.05, 0.05, -0.05], [0.1, 0.1, 0.001, 0.001]
    _, slopes = both_sides(outcome, edges, scales)
    far, near = np.abs(slopes[0] - slopes[1]).reshape(2, 2)
    assert (far > 1e-6).all()
    assert (near < 0.03 * far).all()


def test_the_largest_rate_is_a_kink():
    """The commanded rate is proportional to the angle off centre, up to the largest rate."""
    settings = BrainCpgSettings(centring=30.0)
    tree = build_tree(box_chain(2, "z", Actuator(5.0)))
    controller = build_brain_cpg(tree, 0, 0, settings)
    # All outputs of the brain are then 0.5, for any senses.
    genes = np.zeros((controller.gene_count, 1))

    def outcome(angle):
        none = jnp.zeros((0, len(angle)))
        seen = Observation(none, none, none, none, angle[None], jnp.zeros_like(angle)[None], none)
        state = controller.initial_state((len(angle),), jnp.float64)
        every = jnp.broadcast_to(genes, (len(genes), len(angle)))
        return controller.act(controller.decode(every), state, seen)[1].target_rate[0]

    centred = float(quick_jit(outcome)(jnp.zeros(6))[0])
    assert 0 < centred < settings.max_rate
    place = -(settings.max_rate - centred) / settings.centring
    values, slopes = both_sides(outcome, place, 0.1)
    np.testing.assert_allclose(slopes, [0.0, -settings.centring], rtol=1e-9)
    np.testing.assert_allclose(values, settings.max_rate, rtol=1e-3)


def test_a_neuron_that_begins_to_fire_is_a_kink():
    def outcome(potential):
        rest = jnp.zeros((2, 1, len(potential)))
        return matsuoka.output(MatsuokaState(rest.at[0, 0].set(potential), rest))[0]

    _, slopes = both_sides(outcome, 0.0, 1.0)
    np.testing.assert_allclose(slopes, [0.0, 1.0], atol=1e-12)


def test_the_edge_of_a_field_of_view_is_a_kink():
    """The derivative of cos(pi theta / R) by cos(theta) jumps to 0 at theta = R / 2."""
    field = 2.0

    def outcome(cosine):
        return light_strength(cosine[None], jnp.full((1, 1), field))[0]

    _, slopes = both_sides(outcome, np.cos(field / 2), 1e-2)
    np.testing.assert_allclose(slopes, [0.0, np.pi / field / np.sin(field / 2)], atol=1e-5)
