"""Contact with the ground: it holds, lets slide and throws back.

Each point of a body that may touch the ground obeys, with its velocity v *after* the forces have
acted (the mean over the step, so that h v is the point's way),

    f_n = max(0, c (v* - v_n)),      v* = max(v_gap, v_bounce),
    f_t = -c v_t                     while |f_t| <= mu_s f_n         (it sticks)
    f_t = -mu(|v_t|) f_n v_t/|v_t|   else                            (it slides)

with c so stiff that v_n = v* but for a per cent. ``v_gap = -gap / h`` lets a point that is still
above the ground come just down to it, so nothing falls through and nothing hovers; below the ground
it is a slow way out. ``v_bounce`` is the restitution times the speed of approach, where the point
would hit within the step. Friction falls from static to dynamic with the sliding speed (Stribeck),
``mu = mu_d + (mu_s - mu_d) / (1 + (v / v_s)^2)``.

Differs from a spring and damper under each point, of which a step of 1/240 s cannot return more
than 0.68 of the speed: here the step is told the velocity at its end.

Restitution point by point (Newton's hypothesis) can add energy to a tree. Where the forces of a
step with impacts would do work, ``v_bounce`` of all points of that animal is taken less, and at
last not at all (`StepProblem.must_reduce_restitution`, `bounded`).

The laws have kinks. `evo_cpg.physics.step_solver` finds the motion that obeys them and linearises
them on the way (`ContactLinearization`). An edge or a face touches the floor with its corners.
`evo_cpg.physics.pairs` has the contacts between bodies of one creature.

Vectors of the laws are in the contact frame: two tangents, then the normal.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.fusion.fuse import symmetric
from evo_cpg.physics.contact_model import STIFFNESS, ContactModel
from evo_cpg.physics.contact_points import contact_points
from evo_cpg.physics.kinematics import Kinematics
from evo_cpg.physics.per_body import PerBody, take
from evo_cpg.physics.spatial_algebra import Inertia, Motion, Wrench
from evo_cpg.spatial.linear import (
    cross,
    dot,
    expand_dims_like,
    matmul,
    matmul_t,
    matvec,
    matvec_t,
    skew,
    transpose,
)
from evo_cpg.spatial.numerics import Numbers

# Baumgarte stabilisation: share of a penetration that is undone in a step, and the fastest way out
# (m/s).
BAUMGARTE_FRACTION, BAUMGARTE_SPEED = 0.2, 0.5

# Restitution threshold: below this speed of approach (m/s) nothing bounces, above twice that
# everything does.
_RESTITUTION_THRESHOLD = 0.1

# v* of a point that is not to be held, m/s; infinity would spoil gradients.
_OUT_OF_REACH = -1e4

# Squared speed (m^2/s^2) and force (N^2) added under roots so that they have gradients at rest.
_FLOOR = 1e-20


class Contacts(NamedTuple):
    """Where points touch, or would, and what holds throughout one step.

    Velocities are those of the lowest points, in the contact frame, in m/s.

    Attributes:
        offset: from the body's origin to the lowest point, world axes, m.
        unconstrained_velocity: mean over the step, with the accelerations of `Kinematics` alone.
        target_velocity: v*; far below any velocity where the point is out of reach.
        rest_velocity: v* without restitution; positive where it lifts a point out of the ground.
        bounce: v_bounce of points that hit the ground within the step; 0 of all others.
        frame: rows are two tangents and the normal of the ground at every contact point.
    """

    offset: Float[Array, "3 p *n"]
    unconstrained_velocity: Float[Array, "3 p *n"]
    target_velocity: Float[Array, "p *n"]
    rest_velocity: Float[Array, "p *n"]
    bounce: Float[Array, "p *n"]
    frame: Float[Array, "3 3 p *n"]


class ContactLinearization(NamedTuple):
    """The laws linearized at a velocity: ``f = force - K (v - velocity)``.

    Attributes:
        velocity: at which they are, m/s.
        force: there, N.
        tangential: xx, xy and yy of K, N s/m.
        normal: zz of K, N s/m.
    """

    velocity: Float[Array, "3 p *n"]
    force: Float[Array, "3 p *n"]
    tangential: Float[Array, "3 p *n"]
    normal: Float[Array, "p *n"]


def find_contacts(contact_model: ContactModel, kin: Kinematics, h: float) -> Contacts:
    """The lowest point of every part, and the normal velocity that it should come to.

    Args:
        contact_model: what may touch.
        kin: kinematics of the creature at the start of the step.
        h: s.
    """
    bodies = np.array(contact_model.bodies)
    ground = contact_model.ground
    offset, material, gap, normal, curvature, ahead = contact_points(contact_model, kin, h)
    frame = _frame(normal)
    angular, linear = take(kin.angular, bodies), take(kin.linear, bodies)
    velocity = linear + cross(angular, offset)
    turning = cross(angular, linear + cross(angular, material)) + curvature[None] * normal
    drift = take(kin.bias_linear, bodies) + cross(take(kin.bias_angular, bodies), offset) + turning

    approach, unconstrained = -dot(normal, velocity), matvec(frame, velocity + 0.5 * h * drift)
    place, left = gap, h
    if ahead is not None:
        # The gap is that of later on; until then the point comes nearer.
        gap, left = gap + ahead * approach, h - ahead
    push = jnp.clip(-BAUMGARTE_FRACTION / h * gap, 0.0, BAUMGARTE_SPEED)
    fraction = jnp.clip((1.0 / _RESTITUTION_THRESHOLD) * approach - 1.0, 0.0, 1.0)
    bounce = expand_dims_like(contact_model.restitution, approach) * fraction * approach
    # Times a reciprocal: to divide takes a processor many times as long.
    rest = jnp.where(gap > 0, (-1.0 / h) * gap, push)
    # The law gives way by a share of the speed, and a point that moves farther in a step than the
    # margin would sink in by millimetres.
    hit = jnp.clip((h / ground.margin) * approach - 1.0, 0.0, 1.0)
    rest = rest + hit * (1.0 / STIFFNESS) * jnp.maximum(rest + approach, 0.0)
    # What comes from far within the step is near, too.
    near = place < jnp.maximum(ground.margin, left * approach)
    bounce = jnp.where(near & (gap <= h * approach), bounce, 0.0)
    rest = jnp.where(near, rest, _OUT_OF_REACH)
    return Contacts(offset, unconstrained, rest, rest, bounce, frame)


def bounded(contacts: Contacts, fraction: Float[Array, "*n"]) -> Contacts:
    """Return the contacts with a fraction (0 to 1) of the restitution for each individual."""
    bounce = jnp.expand_dims(fraction, 0) * contacts.bounce
    rest = contacts.rest_velocity
    target = jnp.where(bounce > 0, jnp.maximum(rest, bounce), rest)
    return contacts._replace(target_velocity=target)


def lifting_power(contacts: Contacts, force: Float[Array, "3 p *n"]) -> Float[Array, "*n"]:
    """Of contact forces (N, contact frame) that lift points out of the ground, W."""
    return jnp.maximum(contacts.rest_velocity * force[2], 0.0).sum(0)


def resting_stiffness(contact_model: ContactModel, h: float) -> Float[Numbers, " p"]:
    """Normal force on a point that rests per depth, N/m: there ``v* = v_n + f_n / c`` lifts it.

    It holds up to the depth from which the way out is no faster, ``5/2 h`` m/s.
    """
    return contact_model.stiffness * BAUMGARTE_FRACTION / h**2


def cone_radius(
    contact_model: ContactModel, contacts: Contacts, velocity: Float[Array, "3 p *n"], h: float
) -> Float[Array, "p *n"]:
    """Radius of the friction cone of every point, ``mu(|v_t|) f_n``, N."""
    stiffness = expand_dims_like(contact_model.stiffness / h, velocity[2])
    normal_force = stiffness * jnp.maximum(contacts.target_velocity - velocity[2], 0.0)
    dynamic, more = (
        expand_dims_like(mu, normal_force)
        for mu in (
            contact_model.dynamic_friction,
            contact_model.static_friction - contact_model.dynamic_friction,
        )
    )
    ratio = _square(velocity) * (1.0 / contact_model.ground.stribeck_speed**2)
    return (dynamic + more * (1.0 / (1.0 + ratio))) * normal_force


def linearize_contacts(
    contact_model: ContactModel,
    contacts: Contacts,
    radius: Float[Array, "p *n"],
    velocity: Float[Array, "3 p *n"],
    h: float,
) -> ContactLinearization:
    """The laws linearized at some velocity.

    Args:
        contact_model: what may touch.
        contacts: of this step.
        radius: of the friction cones, N.
        velocity: m/s.
        h: s.
    """
    stiffness = expand_dims_like(contact_model.stiffness / h, radius)
    square, short = _square(velocity), contacts.target_velocity - velocity[2]
    inverse = 1.0 / jnp.sqrt(square)
    sticks = stiffness * square * inverse <= radius
    secant = jnp.where(sticks, stiffness, radius * inverse)
    normal_force = stiffness * jnp.maximum(short, 0.0)
    force = jnp.stack([-secant * velocity[0], -secant * velocity[1], normal_force])
    # Sliding friction keeps its size and turns with the velocity.
    along = jnp.where(sticks, 0.0, secant * inverse * inverse)
    x, y, _ = velocity
    tangential = jnp.stack([secant - along * x * x, -along * x * y, secant - along * y * y])
    return ContactLinearization(velocity, force, tangential, jnp.where(short > 0, stiffness, 0.0))


def friction_change(
    contact_model: ContactModel,
    radius: Float[Array, "p *n"],
    other: Float[Array, "p *n"],
    velocity: Float[Array, "3 p *n"],
    h: float,
) -> Float[Array, "p *n"]:
    """By how much tangential forces (N) at some velocity differ under two friction cones."""
    sticking = expand_dims_like(contact_model.stiffness / h, radius) * jnp.sqrt(_square(velocity))
    return jnp.minimum(sticking, other) - jnp.minimum(sticking, radius)


def linearized_force(
    linear: ContactLinearization, velocity: Float[Array, "3 p *n"]
) -> Float[Array, "3 p *n"]:
    """What linearized laws give at some velocity, N."""
    x, y, z = velocity - linear.velocity
    xx, xy, yy = linear.tangential
    return linear.force - jnp.stack([xx * x + xy * y, xy * x + yy * y, linear.normal * z])


def contact_inertia(
    contact_model: ContactModel,
    contacts: Contacts,
    linear: ContactLinearization,
    like: Inertia,
    h: float,
) -> Inertia:
    """``h sum J^T K J`` of all points of every body: inertias that linearized contacts add to them.

    Args:
        contact_model: what may touch.
        contacts: of this step.
        linear: their laws, linearized.
        like: inertias of the bodies, for their shapes and type.
        h: s.
    """
    turn = transpose(contacts.frame)
    xx, xy, yy = linear.tangential
    none = jnp.zeros_like(xx)
    K = jnp.stack(
        [
            jnp.stack([xx, xy, none]),
            jnp.stack([xy, yy, none]),
            jnp.stack([none, none, linear.normal]),
        ]
    )
    slope = symmetric(h * matmul(turn, matmul_t(K, turn)))
    shift = skew(contacts.offset)
    mixed = matmul(shift, slope)
    blocks = Inertia(symmetric(matmul_t(mixed, shift)), mixed, slope)
    bodies = PerBody.of(jax.tree.map(jnp.zeros_like, like), slope.ndim - 3)
    return bodies.plus(contact_model.bodies, blocks).stacked()


def contact_wrench(
    contact_model: ContactModel, contacts: Contacts, force: Float[Array, "3 p *n"], like: Wrench
) -> Wrench:
    """The wrenches of contact forces (N, contact frame) on all bodies.

    Args:
        contact_model: what may touch.
        contacts: of this step.
        force: on every point.
        like: wrenches of the bodies, likewise.
    """
    force = matvec_t(contacts.frame, force)
    bodies = PerBody.of(jax.tree.map(jnp.zeros_like, like), force.ndim - 2)
    return bodies.plus(contact_model.bodies, Wrench(cross(contacts.offset, force), force)).stacked()


def change_of_velocity(
    contact_model: ContactModel, contacts: Contacts, accelerations: Motion, h: float
) -> Float[Array, "3 p *n"]:
    """What accelerations of the bodies change at every contact point, contact frame, m/s."""
    bodies = np.array(contact_model.bodies)
    angular = take(accelerations.angular, bodies)
    change = take(accelerations.linear, bodies) + cross(angular, contacts.offset)
    return h * matvec(contacts.frame, change)


def _frame(normal: Float[Array, "3 p *n"]) -> Float[Array, "3 3 p *n"]:
    """Rows: two tangents and the normal of the ground; the world's axes where it is level."""
    # The rotation that takes z to the normal the short way, transposed; of a ceiling, whose normal
    # may point straight down, the mirror image.
    x, y, z = normal
    k, sign = 1.0 / (1.0 + jnp.abs(z)), jnp.where(z < 0, 1.0, -1.0)
    return jnp.stack(
        [
            jnp.stack([1 - k * x * x, -k * x * y, sign * x]),
            jnp.stack([-k * x * y, 1 - k * y * y, sign * y]),
            normal,
        ]
    )


def _square(vector: Float[Array, "3 p *n"]) -> Float[Array, "p *n"]:
    """Of the length of the tangential part."""
    return vector[0] * vector[0] + vector[1] * vector[1] + _FLOOR
