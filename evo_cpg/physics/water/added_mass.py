"""Added mass: the water that a body sets in motion around itself.

A body of inertia I in ideal fluid carries water of inertia M (both 6x6). It moves by Kirchhoff's
equations (Lamb 1932, section 124), which have the form of the body's own equations. The velocity
relative to a stream s is ``V_r = V - (0, s)``, all in body axes:

    wrench = -M dV_r/dt - V_r x* (M V_r),     dV_r/dt = A + (0, w x s).

A is the spatial acceleration, so M joins I in the articulated inertia. M is computed for an
ellipsoid with the volume of the shape and the proportions of its bounding box. A mesh uses its
principal axes and the proportions of its second moments. Bodies do not shelter each other.

A body that crosses the surface carries M in proportion to its fraction under water. A body that
enters sets more water in motion, which takes the momentum ``dM V_r`` in a step (von Karman 1929).
A body that leaves gets no momentum back. So the surface never adds energy.
"""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.decisions import chosen
from evo_cpg.creature.algebra.linear import as_matrix_of, cross, expand_dims_like, matvec
from evo_cpg.creature.algebra.numerics import Number, Numbers, xp
from evo_cpg.creature.creature import Creature
from evo_cpg.creature.shapes import Shape
from evo_cpg.creature.tree import Tree
from evo_cpg.physics.water.buoyancy import displacement
from evo_cpg.physics.water.force_law import Bodies, ForceLaw, WrenchPart, blocks

# Points of the quadrature of Lamb's integrals: the error is 1e-9 for axes of 1 to 100.
_NODES = 200

# Relative difference of squared axes below which a body counts as round. A round body carries no
# water when it turns, and the closed form is 0 / 0.
_ROUND = 1e-6

# Least semi-axis, so that a body without size has no 0 / 0, m.
_LEAST = 1e-9


class AddedMass(ForceLaw):
    """Water that the bodies carry along, in proportion to their fraction under water.

    Attributes:
        carried: M of each body in deep water, in its working frame.
    """

    of_water: ClassVar[bool] = True

    carried: Float[Numbers, "6 6 b"]

    def wrench(self, bodies: Bodies) -> Float[Array, "6 b *n"]:
        """Return the wrench on bodies that neither accelerate nor enter the water."""
        return carried_water(self.inertia(bodies), bodies.velocity, bodies.stream)

    def parts(self, bodies: Bodies) -> tuple[WrenchPart, ...]:
        """Return the parts of the carried water and of the impact of water set in motion.

        The impact has no bounce: the water gets the velocity after the impact.
        """
        own, pose, displaced = self.inertia(bodies), bodies.pose, bodies.displaced
        steady = carried_water(own, bodies.velocity, bodies.stream)
        if pose is None or displaced is None:
            return (WrenchPart(steady, None, own),)
        sinking = bodies.h * jnp.concatenate(
            [cross(pose[:3], bodies.velocity[:3]), bodies.kin.linear[2:]]
        )
        ahead = displacement(bodies.cells, pose + sinking).volume
        entering = self._entering(bodies, ahead - displaced.volume)
        impact = -(matvec(entering, bodies.relative) / bodies.h)
        return WrenchPart(steady, None, own), WrenchPart(impact, blocks(entering))

    def averaged(self, start: Bodies, moving: Bodies) -> Float[Array, "6 b *n"]:
        """Return the wrench of the velocity products (`ForceLaw.averaged`)."""
        del start
        return self.wrench(moving)

    def inertia(self, bodies: Bodies) -> Float[Array, "6 6 b *#n"]:
        """Return M of the bodies' parts under water (`ForceLaw.inertia`)."""
        added = as_matrix_of(self.carried, bodies.velocity)
        if bodies.displaced is None:
            return added
        return added * bodies.under_water[None, None]

    def over_step(self, first: Bodies, middle: Bodies, last: Bodies) -> Float[Array, "6 b *n"]:
        """Return the wrench over a step from the motion (`ForceLaw.over_step`)."""
        added, velocity = self.inertia(middle), middle.velocity
        change = (last.relative - first.relative) / middle.h
        # `carried_water` includes the turn of the stream in body axes. The change of the relative
        # velocity includes it, too, so one of the two is cancelled here.
        turning = cross(velocity[:3], jnp.broadcast_to(middle.stream, velocity[3:].shape))
        steady = carried_water(added, velocity, middle.stream) + matvec(added[:, 3:], turning)
        wrench = steady - matvec(added, change)
        if first.displaced is None or last.displaced is None:
            return wrench
        entering = self._entering(middle, last.displaced.volume - first.displaced.volume)
        return wrench - matvec(entering, middle.relative) / middle.h

    def _entering(self, bodies: Bodies, gained: Float[Array, "b *n"]) -> Float[Array, "6 6 b *n"]:
        """Return the inertia of the water that entering volumes set in motion."""
        added = as_matrix_of(self.carried, bodies.velocity)
        volume = expand_dims_like(bodies.tree.volume, gained)
        return added * (jnp.maximum(gained, 0.0) / volume)[None, None]


def added_inertia(creature: Creature, tree: Tree, density: Number) -> Float[Numbers, "6 6 b"]:
    """Return the inertia M of the water around each body, in the body's working frame."""
    shapes = {body.name: body.shape for body in creature.bodies}
    inertias = []
    for name, centre in zip(tree.names, tree.centre.T, strict=True):
        x, y, z = centre
        shift = xp.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
        to_centre = xp.block([[np.eye(3), np.zeros((3, 3))], [shift, np.eye(3)]])
        turn = np.kron(np.eye(2), shapes[name].stretch[1])
        own = turn @ xp.diag(density * ellipsoid(shapes[name])) @ turn.T
        inertias.append(to_centre.T @ own @ to_centre)
    return xp.stack(inertias, -1)


def ellipsoid(shape: Shape) -> Float[Numbers, " 6"]:
    """Return the added inertia over density about the centre (Lamb 1932, sections 114 and 115).

    With ``alpha_i = abc int_0^inf dl / ((a_i^2 + l) sqrt((a^2 + l) (b^2 + l) (c^2 + l)))``,

        M_x = V alpha / (2 - alpha),
        I_x = V/5 (b^2 - c^2)^2 (gamma - beta) / (2 (b^2 - c^2) + (b^2 + c^2) (beta - gamma)).

    Returns:
        Three values about the axes of `Shape.stretch` (m^5), then three along the axes (m^3).
    """
    axes = xp.maximum(shape.ellipsoid, _LEAST)
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    # l = a^2 (x / (1 - x))^2 maps (0, 1) to (0, infinity) and leaves a smooth integrand.
    x = (nodes + 1) / 2
    scale = axes.min() * axes.max()
    shifted = xp.square(axes)[:, None] + (scale * (x / (1 - x)) ** 2)[None]
    measure = weights / 2 * scale * 2 * x / (1 - x) ** 3
    alpha = xp.prod(axes) * (measure / (shifted * xp.sqrt(shifted.prod(0)))).sum(-1)
    linear = alpha / (2 - alpha)
    angular = [0.0, 0.0, 0.0]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        difference, total = axes[j] ** 2 - axes[k] ** 2, axes[j] ** 2 + axes[k] ** 2
        if chosen(lambda d=difference, t=total: abs(d) > _ROUND * t):
            turn = alpha[j] - alpha[k]
            angular[i] = -(difference**2) * turn / (2 * difference + total * turn) / 5
    return shape.volume * xp.concatenate([xp.array(angular), linear])


def carried_water(
    inertia: Float[Array, "6 6 b *#n"],
    velocity: Float[Array, "6 b *n"],
    stream: Float[Array, "3 #b *#n"],
) -> Float[Array, "6 b *n"]:
    """Return the wrench of the carried water on bodies that do not accelerate, in body axes."""
    w, s = velocity[:3], jnp.broadcast_to(stream, velocity[3:].shape)
    v = velocity[3:] - s
    momentum = matvec(inertia, jnp.concatenate([w, v]))
    moment = cross(w, momentum[:3]) + cross(v, momentum[3:])
    gyration = jnp.concatenate([moment, cross(w, momentum[3:])])
    return -gyration - matvec(inertia[:, 3:], cross(w, s))
