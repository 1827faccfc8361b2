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

The laws have kinks; `evo_cpg.physics.passes` finds the motion that obeys them, with lines in their
place (a `ContactLaw` holds their slopes). What is imposed in the end has ``f_n >= 0`` and
``|f_t| <= mu_s f_n``: no contact ever pulls and no friction leaves its cone, converged or not. The
contact of an edge or a face is that of its corners. Bodies of one creature do not touch each other,
nor do creatures.

Vectors of the laws are in the ground's own frame: two tangents, then the normal.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from evo_cpg.fusion.fuse import symmetric
from evo_cpg.physics.articulated import Accelerations
from evo_cpg.physics.footing import Footing, lowest_points
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

# Share of a penetration that is undone in a step, and the fastest way out (m/s).
_PUSH_SHARE, _PUSH_SPEED = 0.2, 0.5

# Below the first speed of approach (m/s) nothing bounces, above twice that everything does.
_BOUNCE_SPEED = 0.1

# v* of a point that is not to be held, m/s; infinity would spoil gradients.
_OUT_OF_REACH = -1e4

# 1 + z of a normal below which the ground is a ceiling, whose tangents are not exact.
_CEILING = 1e-2

# Squared speed (m^2/s^2) and force (N^2) added under roots so that they have gradients at rest.
_FLOOR = 1e-20

# Work of all contact forces (W) that counts as none. Gradients divide by its square, which must not
# vanish in float32.
_NO_WORK = 1e-15


class Contacts(NamedTuple):
    """Where the places touch, or would, and what holds throughout one step.

    Velocities are those of the lowest points, in the ground's frame, in m/s.

    Attributes:
        arm: from the body's origin to the lowest point, world axes, m.
        coasting: their mean over the step, if the recursion's accelerations were zero.
        wanted: v*; far below any velocity where the point is out of reach.
        push: the part of it that lifts a point out of the ground.
        frame: rows are two tangents and the normal of the ground at every place.
    """

    arm: Float[Array, "3 p *n"]
    coasting: Float[Array, "3 p *n"]
    wanted: Float[Array, "p *n"]
    push: Float[Array, "p *n"]
    frame: Float[Array, "3 3 p *n"]


class ContactLaw(NamedTuple):
    """Lines in the place of the laws: ``f_t = -s_t v_t`` and ``f_n = s_n (v* - v_n)``.

    Attributes:
        tangential: s_t, N s/m.
        normal: s_n, N s/m; 0 where the point does not touch.
    """

    tangential: Float[Array, "p *n"]
    normal: Float[Array, "p *n"]


def find_contacts(footing: Footing, kin: Kinematics, h: float) -> Contacts:
    """The lowest point of every place, and the normal velocity that it should come to.

    Args:
        footing: the places.
        kin: kinematics of the creature at the start of the step.
        h: s.
    """
    bodies = np.array(footing.bodies)
    ground = footing.ground
    arm, spoke, gap, normal = lowest_points(footing, kin)
    frame = _frame(normal)
    angular, linear = take(kin.angular, bodies), take(kin.linear, bodies)
    velocity = linear + cross(angular, arm)
    # A ball's lowest point keeps below its centre: only the centre's way round is centripetal.
    turning = cross(angular, linear + cross(angular, spoke))
    drift = take(kin.bias_linear, bodies) + cross(take(kin.bias_angular, bodies), arm) + turning

    velocity, coasting = (matvec(frame, v) for v in (velocity, velocity + 0.5 * h * drift))
    approach = -velocity[2]
    push = jnp.clip(-_PUSH_SHARE / h * gap, 0.0, _PUSH_SPEED)
    share = jnp.clip(approach / _BOUNCE_SPEED - 1.0, 0.0, 1.0)
    bounce = expand_dims_like(footing.restitution, approach) * share * approach
    rest = jnp.where(gap > 0, -gap / h, push)
    bounces = (gap <= h * approach) & (bounce > 0)
    wanted = jnp.where(bounces, jnp.maximum(rest, bounce), rest)
    wanted = jnp.where(gap < ground.margin, wanted, _OUT_OF_REACH)
    return Contacts(arm, coasting, wanted, push, frame)


def resting_stiffness(footing: Footing, h: float) -> Float[Numbers, " p"]:
    """Normal force on a place that rests per depth, N/m: there ``v* = v_n + f_n / c`` lifts it.

    It holds up to the depth from which the way out is no faster, ``5/2 h`` m/s.
    """
    return footing.stiffness * _PUSH_SHARE / h**2


def first_law(gravity: ArrayLike, footing: Footing, contacts: Contacts, h: float) -> ContactLaw:
    """A guess: what lies on the ground stays and sticks there, what slides has no friction yet."""
    v = contacts.coasting
    stiffness = expand_dims_like(footing.stiffness / h, v[2])
    # What gravity adds in a step decides for those that rest.
    fall = 2 * h * gravity
    touches = contacts.wanted > v[2] - fall
    sticks = touches & (v[0] * v[0] + v[1] * v[1] < fall * fall)
    return ContactLaw(jnp.where(sticks, stiffness, 0.0), jnp.where(touches, stiffness, 0.0))


def next_law(
    footing: Footing,
    contacts: Contacts,
    law: ContactLaw,
    velocity: Float[Array, "3 p *n"],
    h: float,
) -> ContactLaw:
    """Lines that meet the laws at the velocity found with the last ones.

    Tangents for the normal forces, secants for friction, under the normal forces found.
    """
    stiffness = expand_dims_like(footing.stiffness / h, law.normal)
    short = contacts.wanted - velocity[2]
    speed = _length(velocity)
    static, dynamic = (
        expand_dims_like(mu, speed) for mu in (footing.static_friction, footing.dynamic_friction)
    )
    ratio = speed / footing.ground.stribeck_speed
    friction = dynamic + (static - dynamic) / (1.0 + ratio * ratio)
    limit = jnp.where(law.normal > 0, friction * law.normal * jnp.maximum(short, 0.0), 0.0)
    return ContactLaw(jnp.minimum(stiffness, limit / speed), jnp.where(short > 0, stiffness, 0.0))


def line_force(
    contacts: Contacts, law: ContactLaw, velocity: Float[Array, "3 p *n"]
) -> Float[Array, "3 p *n"]:
    """What the lines give at some velocity, N."""
    touches = law.normal > 0
    support = jnp.where(touches, law.normal * (contacts.wanted - velocity[2]), 0.0)
    return jnp.stack([-law.tangential * velocity[0], -law.tangential * velocity[1], support])


def imposed_force(
    footing: Footing, contacts: Contacts, law: ContactLaw, velocity: Float[Array, "3 p *n"]
) -> Float[Array, "3 p *n"]:
    """The forces found last, cut back to what the ground can give, N."""
    force = line_force(contacts, law, velocity)
    support = jnp.maximum(force[2], 0.0)
    limit = expand_dims_like(footing.static_friction, support) * support
    share = jnp.minimum(limit / _length(force), 1.0)
    return jnp.stack([share * force[0], share * force[1], support])


def work_share(
    contacts: Contacts,
    force: Float[Array, "3 p *n"],
    velocity: Float[Array, "3 p *n"],
    without: Float[Array, "3 p *n"],
) -> Float[Array, "*n"]:
    """Share of imposed forces with which the ground does no work on the creature.

    Ground that rests cannot. Contact forces F that change the points' velocities at the end of the
    step from v_0 to v_1 add ``h F . (v_0 + v_1) / 2`` to the kinetic energy. Lifting points out of
    the ground is allowed for.

    Args:
        contacts: of this step.
        force: imposed on the points, N.
        velocity: of the points at the end of the step under them.
        without: the same without contact forces.
    """
    lost = 2.0 * (force[2] * contacts.push - (force * without).sum(0)).sum(0)
    growth = (force * (velocity - without)).sum((0, 1))
    return jnp.clip(lost / jnp.maximum(growth, _NO_WORK), 0.0, 1.0)


def contact_equations(
    footing: Footing, contacts: Contacts, law: ContactLaw, inertia: Inertia, bias: Wrench, h: float
) -> tuple[Inertia, Wrench]:
    """The equations of the bodies with the contacts' lines in them."""
    turn = transpose(contacts.frame)
    diagonal = jnp.stack([law.tangential, law.tangential, law.normal])
    slope = symmetric(h * matmul_t(turn * diagonal[None], turn))
    shift = skew(contacts.arm)
    mixed = matmul(shift, slope)
    blocks = Inertia(symmetric(matmul_t(mixed, shift)), mixed, slope)
    loaded = pressed(footing, contacts, line_force(contacts, law, contacts.coasting), bias)
    bodies = PerBody.of(inertia, slope.ndim - 3).plus(footing.bodies, blocks)
    return bodies.stacked(), loaded


def pressed(
    footing: Footing, contacts: Contacts, force: Float[Array, "3 p *n"], bias: Wrench
) -> Wrench:
    """The bodies' bias wrenches with given contact forces (N, ground's frame)."""
    force = matvec_t(contacts.frame, force)
    load = Wrench(-cross(contacts.arm, force), -force)
    return PerBody.of(bias, force.ndim - 2).plus(footing.bodies, load).stacked()


def end_velocity(
    footing: Footing, contacts: Contacts, found: Accelerations, h: float
) -> Float[Array, "3 p *n"]:
    """Velocity of every place at the end of the step, ground's frame, m/s."""
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
