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
last not at all (`contact_work`, `bounded`).

The laws have kinks; `evo_cpg.physics.newton` finds the motion that obeys them, linearizing them as
it goes (`ContactLinearization`). The contact of an edge or a face with the floor is that of its
corners. Bodies of one creature that meet are in `evo_cpg.physics.pairs`.

Vectors of the laws are in the contact frame: two tangents, then the normal.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.fusion.fuse import symmetric
from evo_cpg.physics.articulated import Accelerations
from evo_cpg.physics.contact_points import contact_points
from evo_cpg.physics.footing import Footing
from evo_cpg.physics.kinematics import Kinematics
from evo_cpg.physics.per_body import PerBody, take
from evo_cpg.physics.spatial_algebra import Inertia, Wrench
from evo_cpg.spatial.linear import (
    cross,
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
BAUMGARTE_SHARE, BAUMGARTE_SPEED = 0.2, 0.5

# Restitution threshold: below this speed of approach (m/s) nothing bounces, above twice that
# everything does.
_RESTITUTION_THRESHOLD = 0.1

# v* of a point that is not to be held, m/s; infinity would spoil gradients.
_OUT_OF_REACH = -1e4

# 1 + z of a normal below which the ground is a ceiling, whose tangents are not exact.
_CEILING = 1e-2

# Squared speed (m^2/s^2) and force (N^2) added under roots so that they have gradients at rest.
_FLOOR = 1e-20


class Contacts(NamedTuple):
    """Where points touch, or would, and what holds throughout one step.

    Velocities are those of the lowest points, in the contact frame, in m/s.

    Attributes:
        arm: from the body's origin to the lowest point, world axes, m.
        before: at the start of the step.
        coasting: their mean over the step, if the recursion's accelerations were zero.
        wanted: v*; far below any velocity where the point is out of reach.
        push: the part of it that lifts a point out of the ground.
        bounce: v_bounce of points that hit the ground within the step; 0 of all others.
        frame: rows are two tangents and the normal of the ground at every contact point.
    """

    arm: Float[Array, "3 p *n"]
    before: Float[Array, "3 p *n"]
    coasting: Float[Array, "3 p *n"]
    wanted: Float[Array, "p *n"]
    push: Float[Array, "p *n"]
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


def find_contacts(footing: Footing, kin: Kinematics, h: float) -> Contacts:
    """The lowest point of every part, and the normal velocity that it should come to.

    Args:
        footing: what may touch.
        kin: kinematics of the creature at the start of the step.
        h: s.
    """
    bodies = np.array(footing.bodies)
    ground = footing.ground
    arm, spoke, gap, normal, bend = contact_points(footing, kin, h)
    frame = _frame(normal)
    angular, linear = take(kin.angular, bodies), take(kin.linear, bodies)
    velocity = linear + cross(angular, arm)
    turning = cross(angular, linear + cross(angular, spoke)) + bend[None] * normal
    drift = take(kin.bias_linear, bodies) + cross(take(kin.bias_angular, bodies), arm) + turning

    before, coasting = (matvec(frame, v) for v in (velocity, velocity + 0.5 * h * drift))
    approach = -before[2]
    push = jnp.clip(-BAUMGARTE_SHARE / h * gap, 0.0, BAUMGARTE_SPEED)
    share = jnp.clip(approach / _RESTITUTION_THRESHOLD - 1.0, 0.0, 1.0)
    bounce = expand_dims_like(footing.restitution, approach) * share * approach
    rest = jnp.where(gap > 0, -gap / h, push)
    near = gap < ground.margin
    bounce = jnp.where(near & (gap <= h * approach), bounce, 0.0)
    rest = jnp.where(near, rest, _OUT_OF_REACH)
    return Contacts(arm, before, coasting, rest, push, bounce, frame)


def bounded(contacts: Contacts, share: Float[Array, "*n"]) -> Contacts:
    """The contacts of a step in which each individual has a share (0 to 1) of its restitution."""
    bounce = jnp.expand_dims(share, 0) * contacts.bounce
    wanted = jnp.where(bounce > 0, jnp.maximum(contacts.wanted, bounce), contacts.wanted)
    return contacts._replace(wanted=wanted)


def contact_work(
    contacts: Contacts, velocity: Float[Array, "3 p *n"], force: Float[Array, "3 p *n"], h: float
) -> Float[Array, "*n"]:
    """Kinetic energy that contact forces give a creature in a step, J.

    By the mean of the points' velocities at its start and end; lifting points out of the ground
    does not count.

    Args:
        contacts: of this step.
        velocity: at its end, m/s.
        force: N, contact frame.
        h: s.
    """
    mean = 0.5 * (contacts.before + velocity)
    return h * ((mean * force).sum(0) - contacts.push * force[2]).sum(0)


def resting_stiffness(footing: Footing, h: float) -> Float[Numbers, " p"]:
    """Normal force on a point that rests per depth, N/m: there ``v* = v_n + f_n / c`` lifts it.

    It holds up to the depth from which the way out is no faster, ``5/2 h`` m/s.
    """
    return footing.stiffness * BAUMGARTE_SHARE / h**2


def cone_radius(
    footing: Footing, contacts: Contacts, velocity: Float[Array, "3 p *n"], h: float
) -> Float[Array, "p *n"]:
    """Radius of the friction cone of every point, ``mu(|v_t|) f_n``, N."""
    stiffness = expand_dims_like(footing.stiffness / h, velocity[2])
    normal_force = stiffness * jnp.maximum(contacts.wanted - velocity[2], 0.0)
    static, dynamic = (
        expand_dims_like(mu, normal_force)
        for mu in (footing.static_friction, footing.dynamic_friction)
    )
    ratio = _length(velocity) / footing.ground.stribeck_speed
    return (dynamic + (static - dynamic) / (1.0 + ratio * ratio)) * normal_force


def linearize_contacts(
    footing: Footing,
    contacts: Contacts,
    radius: Float[Array, "p *n"],
    velocity: Float[Array, "3 p *n"],
    h: float,
) -> ContactLinearization:
    """The laws linearized at some velocity.

    Args:
        footing: what may touch.
        contacts: of this step.
        radius: of the friction cones, N.
        velocity: m/s.
        h: s.
    """
    stiffness = expand_dims_like(footing.stiffness / h, radius)
    speed = _length(velocity)
    short = contacts.wanted - velocity[2]
    sticks = stiffness * speed <= radius
    share = _resistance(stiffness, radius, speed)
    normal_force = stiffness * jnp.maximum(short, 0.0)
    force = jnp.stack([-share * velocity[0], -share * velocity[1], normal_force])
    # Sliding friction keeps its size and turns with the velocity.
    along = jnp.where(sticks, 0.0, share / (speed * speed))
    x, y, _ = velocity
    tangential = jnp.stack([share - along * x * x, -along * x * y, share - along * y * y])
    return ContactLinearization(velocity, force, tangential, jnp.where(short > 0, stiffness, 0.0))


def friction_change(
    footing: Footing,
    radius: Float[Array, "p *n"],
    other: Float[Array, "p *n"],
    velocity: Float[Array, "3 p *n"],
    h: float,
) -> Float[Array, "p *n"]:
    """By how much tangential forces (N) at some velocity differ under two friction cones."""
    stiffness, speed = expand_dims_like(footing.stiffness / h, radius), _length(velocity)
    change = _resistance(stiffness, other, speed) - _resistance(stiffness, radius, speed)
    return change * speed


def _resistance(stiffness: Array, radius: Array, speed: Array) -> Array:
    """Tangential force per speed, N s/m."""
    return jnp.where(stiffness * speed <= radius, stiffness, radius / speed)


def linearized_force(
    linear: ContactLinearization, velocity: Float[Array, "3 p *n"]
) -> Float[Array, "3 p *n"]:
    """What linearized laws give at some velocity, N."""
    x, y, z = velocity - linear.velocity
    xx, xy, yy = linear.tangential
    return linear.force - jnp.stack([xx * x + xy * y, xy * x + yy * y, linear.normal * z])


def contact_equations(
    footing: Footing,
    contacts: Contacts,
    linear: ContactLinearization,
    inertia: Inertia,
    bias: Wrench,
    h: float,
) -> tuple[Inertia, Wrench]:
    """The equations of the bodies with the contacts linearized."""
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
    shift = skew(contacts.arm)
    mixed = matmul(shift, slope)
    blocks = Inertia(symmetric(matmul_t(mixed, shift)), mixed, slope)
    loaded = pressed(footing, contacts, linearized_force(linear, contacts.coasting), bias)
    bodies = PerBody.of(inertia, slope.ndim - 3).plus(footing.bodies, blocks)
    return bodies.stacked(), loaded


def pressed(
    footing: Footing, contacts: Contacts, force: Float[Array, "3 p *n"], bias: Wrench
) -> Wrench:
    """The bodies' bias wrenches with given contact forces (N, contact frame)."""
    force = matvec_t(contacts.frame, force)
    load = Wrench(-cross(contacts.arm, force), -force)
    return PerBody.of(bias, force.ndim - 2).plus(footing.bodies, load).stacked()


def end_velocity(
    footing: Footing, contacts: Contacts, found: Accelerations, h: float
) -> Float[Array, "3 p *n"]:
    """Velocity of every contact point at the end of the step, contact frame, m/s."""
    bodies = np.array(footing.bodies)
    change = take(found.linear, bodies) + cross(take(found.angular, bodies), contacts.arm)
    return contacts.coasting + h * matvec(contacts.frame, change)


def _frame(normal: Float[Array, "3 p *n"]) -> Float[Array, "3 3 p *n"]:
    """Rows: two tangents and the normal of the ground; the world's axes where it is level."""
    # The rotation that takes z to the normal the short way, transposed; not for a ceiling.
    x, y, z = normal
    k = 1.0 / jnp.maximum(1.0 + z, _CEILING)
    return jnp.stack(
        [
            jnp.stack([1 - k * x * x, -k * x * y, -x]),
            jnp.stack([-k * x * y, 1 - k * y * y, -y]),
            normal,
        ]
    )


def _length(vector: Float[Array, "3 p *n"]) -> Float[Array, "p *n"]:
    """Of the tangential part."""
    return jnp.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + _FLOOR)
