"""Contact with the ground: normal force, friction and restitution.

Each contact point of a body obeys these laws. The velocity v is the velocity *after* the forces
have acted (the mean over the step, so ``h v`` is the point's displacement):

    f_n = max(0, c (v* - v_n)),      v* = max(v_gap, v_bounce),
    f_t = -c v_t                     while |f_t| <= mu_s f_n         (sticking)
    f_t = -mu(|v_t|) f_n v_t/|v_t|   else                            (sliding)

The stiffness c is so large that v_n = v* within about one per cent. ``v_gap = -gap / h`` lets a
point above the ground just reach it, so nothing falls through and nothing hovers. ``v_gap`` of a
point below the ground is a slow exit. ``v_bounce`` is the restitution times the speed of approach,
for a point that would hit within the step. Friction falls from static to dynamic with the sliding
speed (Stribeck), ``mu = mu_d + (mu_s - mu_d) / (1 + (v / v_s)^2)``.

Differs from a spring and damper under each point, which with steps of 1/240 s cannot return more
than 0.68 of the speed. The laws here use the velocity at the end of the step.

Restitution point by point (Newton's hypothesis) can add energy to a tree. If contact forces would
do positive work, ``v_bounce`` of all points of the individual is reduced, finally to zero
(`StepProblem.must_reduce_restitution`, `Contacts.bounded`).

The laws have kinks. `evo_cpg.physics.step.step_solver` finds the motion that obeys the laws, and
linearizes them repeatedly (`ContactLinearization`). An edge or a face touches the floor with its
corners. `evo_cpg.physics.contact.pairs` has the contacts between bodies of one creature.

Vectors of the laws are in the contact frame: two tangents, then the normal.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import (
    cross,
    dot,
    expand_dims_like,
    matmul,
    matmul_t,
    matvec,
    matvec_t,
    skew,
)
from evo_cpg.creature.per_body import PerBody, take
from evo_cpg.native.fuse import symmetric
from evo_cpg.physics.contact.contact_model import STIFFNESS, ContactModel
from evo_cpg.physics.contact.contact_points import contact_points
from evo_cpg.physics.tree.kinematics import Kinematics
from evo_cpg.physics.tree.spatial_algebra import Inertia, Wrench

# Baumgarte stabilisation: fraction of a penetration that is undone in a step, and the fastest exit
# (m/s).
BAUMGARTE_FRACTION, BAUMGARTE_SPEED = 0.2, 0.5

# Restitution threshold: below this speed of approach (m/s) nothing bounces, above twice this speed
# everything does.
_RESTITUTION_THRESHOLD = 0.1

# v* of a point without contact, m/s. Infinity would spoil gradients.
_OUT_OF_REACH = -1e4

# Squared speed (m^2/s^2) and force (N^2) added under roots so that they have gradients at rest.
_FLOOR = 1e-20


def rest_velocity(gap: Array, h: float) -> Array:
    """Return v* without restitution, m/s, for points with a gap (m)."""
    push = jnp.clip(-BAUMGARTE_FRACTION / h * gap, 0.0, BAUMGARTE_SPEED)
    # Multiply by a reciprocal: a division costs a processor many times as much.
    return jnp.where(gap > 0, (-1.0 / h) * gap, push)


class Contacts(NamedTuple):
    """Contact points, their laws, and quantities that are constant throughout one step.

    Velocities are velocities of the lowest points, in the contact frame, in m/s. Forces are forces
    on these points, in the contact frame, in N.

    Attributes:
        offset: vector from the body's origin to the lowest point, world axes, m.
        unconstrained_velocity: mean over the step, with the accelerations of `Kinematics` alone.
        target_velocity: v*, far below any velocity if the point is out of reach.
        rest_velocity: v* without restitution, positive if it lifts a point out of the ground.
        bounce: v_bounce of points that hit the ground within the step, and 0 of all others.
        frame: rows are two tangents and the normal of the ground at every contact point.
    """

    model: ContactModel
    h: float
    offset: Float[Array, "3 p *n"]
    unconstrained_velocity: Float[Array, "3 p *n"]
    target_velocity: Float[Array, "p *n"]
    rest_velocity: Float[Array, "p *n"]
    bounce: Float[Array, "p *n"]
    frame: Float[Array, "3 3 p *n"]

    def bounded(self, fraction: Float[Array, "*n"]) -> "Contacts":
        """Return the contacts with a fraction (0 to 1) of the restitution for each individual."""
        bounce = jnp.expand_dims(fraction, 0) * self.bounce
        rest = self.rest_velocity
        target = jnp.where(bounce > 0, jnp.maximum(rest, bounce), rest)
        return self._replace(target_velocity=target)

    def cone_radius(self, velocity: Float[Array, "3 p *n"]) -> Float[Array, "p *n"]:
        """Return the radius of the friction cone of every point, ``mu(|v_t|) f_n``, N."""
        model = self.model
        stiffness = expand_dims_like(model.stiffness / self.h, velocity[2])
        normal_force = stiffness * jnp.maximum(self.target_velocity - velocity[2], 0.0)
        more = model.static_friction - model.dynamic_friction
        dynamic, more = (expand_dims_like(x, normal_force) for x in (model.dynamic_friction, more))
        ratio = _square(velocity) * (1.0 / model.ground.stribeck_speed**2)
        return (dynamic + more * (1.0 / (1.0 + ratio))) * normal_force

    def linearized(
        self, radius: Float[Array, "p *n"], velocity: Float[Array, "3 p *n"]
    ) -> "ContactLinearization":
        """Return the laws linearized at a velocity, with the radii of the friction cones (N)."""
        stiffness = expand_dims_like(self.model.stiffness / self.h, radius)
        square, short = _square(velocity), self.target_velocity - velocity[2]
        inverse = 1.0 / jnp.sqrt(square)
        sticks = stiffness * square * inverse <= radius
        secant = jnp.where(sticks, stiffness, radius * inverse)
        normal_force = stiffness * jnp.maximum(short, 0.0)
        force = jnp.stack([-secant * velocity[0], -secant * velocity[1], normal_force])
        # Sliding friction keeps its magnitude and turns with the velocity.
        along = jnp.where(sticks, 0.0, secant * inverse * inverse)
        x, y, _ = velocity
        tangential = jnp.stack([secant - along * x * x, -along * x * y, secant - along * y * y])
        return ContactLinearization(
            velocity, force, tangential, jnp.where(short > 0, stiffness, 0.0)
        )

    def friction_change(
        self,
        radius: Float[Array, "p *n"],
        other: Float[Array, "p *n"],
        velocity: Float[Array, "3 p *n"],
    ) -> Float[Array, "p *n"]:
        """Return the change of tangential forces (N) at a velocity between two friction cones."""
        stiffness = expand_dims_like(self.model.stiffness / self.h, radius)
        sticking = stiffness * jnp.sqrt(_square(velocity))
        return jnp.minimum(sticking, other) - jnp.minimum(sticking, radius)

    def wrench(self, force: Float[Array, "3 p *n"], like: Wrench) -> Wrench:
        """Return the wrenches of contact forces on all bodies, world axes, shaped as ``like``."""
        force = matvec_t(self.frame, force)
        bodies = PerBody.of(jax.tree.map(jnp.zeros_like, like), force.ndim - 2)
        on_bodies = Wrench(cross(self.offset, force), force)
        return bodies.plus(self.model.bodies, on_bodies)[:]


class ContactLinearization(NamedTuple):
    """Contact laws linearized at a velocity: ``f = force - K (v - velocity)``.

    Attributes:
        velocity: velocity of the linearization, m/s.
        force: force at this velocity, N.
        tangential: elements xx, xy and yy of K, N s/m.
        normal: element zz of K, N s/m.
    """

    velocity: Float[Array, "3 p *n"]
    force: Float[Array, "3 p *n"]
    tangential: Float[Array, "3 p *n"]
    normal: Float[Array, "p *n"]

    def at(self, velocity: Float[Array, "3 p *n"]) -> Float[Array, "3 p *n"]:
        """Return the linearized contact forces at a velocity, contact frame, N."""
        x, y, z = velocity - self.velocity
        xx, xy, yy = self.tangential
        return self.force - jnp.stack([xx * x + xy * y, xy * x + yy * y, self.normal * z])

    def inertia(self, contacts: Contacts, like: Inertia) -> Inertia:
        """Return ``h sum J^T K J`` of every body, which the contacts add to its inertia."""
        turn = jnp.swapaxes(contacts.frame, 0, 1)
        xx, xy, yy = self.tangential
        none = jnp.zeros_like(xx)
        rows = [[xx, xy, none], [xy, yy, none], [none, none, self.normal]]
        K = jnp.stack([jnp.stack(row) for row in rows])
        translation = symmetric(contacts.h * matmul(turn, matmul_t(K, turn)))
        shift = skew(contacts.offset)
        mixed = matmul(shift, translation)
        blocks = Inertia(symmetric(matmul_t(mixed, shift)), mixed, translation)
        bodies = PerBody.of(jax.tree.map(jnp.zeros_like, like), translation.ndim - 3)
        return bodies.plus(contacts.model.bodies, blocks)[:]


def find_contacts(contact_model: ContactModel, kin: Kinematics, h: float) -> Contacts:
    """Return the contact points of every part and their target normal velocities."""
    bodies = np.array(contact_model.bodies)
    ground = contact_model.ground
    offset, material, gap, normal, curvature, ahead = contact_points(contact_model, kin, h)
    # Rows: two tangents and the normal (world axes on level ground), the transpose of the smallest
    # rotation that takes z to the normal. A ceiling gets the mirror image, since its normal may
    # point straight down.
    x, y, z = normal
    k, sign = 1.0 / (1.0 + jnp.abs(z)), jnp.where(z < 0, 1.0, -1.0)
    one = jnp.stack([1 - k * x * x, -k * x * y, sign * x])
    other = jnp.stack([-k * x * y, 1 - k * y * y, sign * y])
    frame = jnp.stack([one, other, normal])
    angular, linear = take(kin.angular, bodies), take(kin.linear, bodies)
    velocity = linear + cross(angular, offset)
    turning = cross(angular, linear + cross(angular, material)) + curvature[None] * normal
    drift = take(kin.bias_linear, bodies) + cross(take(kin.bias_angular, bodies), offset) + turning

    approach, unconstrained = -dot(normal, velocity), matvec(frame, velocity + 0.5 * h * drift)
    place, left = gap, h
    if ahead is not None:
        # The gap is the gap after ``ahead`` seconds. The point approaches during this time.
        gap, left = gap + ahead * approach, h - ahead
    fraction = jnp.clip((1.0 / _RESTITUTION_THRESHOLD) * approach - 1.0, 0.0, 1.0)
    bounce = expand_dims_like(contact_model.restitution, approach) * fraction * approach
    rest = rest_velocity(gap, h)
    # The law yields by a fraction of the speed. A point that moves farther in a step than the
    # margin would sink in by millimetres.
    hit = jnp.clip((h / ground.margin) * approach - 1.0, 0.0, 1.0)
    rest = rest + hit * (1.0 / STIFFNESS) * jnp.maximum(rest + approach, 0.0)
    # A distant point that arrives within the step is near, too.
    near = place < jnp.maximum(ground.margin, left * approach)
    bounce = jnp.where(near & (gap <= h * approach), bounce, 0.0)
    rest = jnp.where(near, rest, _OUT_OF_REACH)
    return Contacts(contact_model, h, offset, unconstrained, rest, rest, bounce, frame)


def _square(vector: Float[Array, "3 p *n"]) -> Float[Array, "p *n"]:
    """Return the squared length of the tangential part."""
    return vector[0] * vector[0] + vector[1] * vector[1] + _FLOOR
