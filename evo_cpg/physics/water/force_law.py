"""Force laws: forces on the bodies of a creature besides weight, joints and contact.

A law computes the wrench on every body. The implicit step (`evo_cpg.physics.step.equations`)
also needs the derivative ``S = d wrench / d V`` by the velocity V of the body. The step uses the
symmetric and skew parts of S and takes the wrench as

    wrench(V_0) + 1/2 S_sym (V_1 - V_0) + 1/2 S_skew (V_p - V_0).

This is the mean of the wrenches at the start and the end, to second order. The symmetric part is
solved for together with the final velocity V_1, so stiff drag stays stable. The matrices of the
solver are symmetric, so the skew part, which does no work, uses a predicted velocity V_p.

A new law only has to define `ForceLaw.wrench`. A law with more knowledge overrides other methods:
drag has a better D than its derivative, and added mass has an inertia.
"""

import abc
import dataclasses
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import cross, expand_dims_like, matvec, matvec_t
from evo_cpg.creature.algebra.numerics import Number, xp
from evo_cpg.creature.tree import Tree
from evo_cpg.native.fuse import fuse
from evo_cpg.physics.tree.kinematics import Kinematics
from evo_cpg.physics.water.buoyancy import Cells, DisplacedWater, displacement
from evo_cpg.physics.water.water import Water


@dataclasses.dataclass(frozen=True)
class Bodies:
    """Poses and motion of the bodies, and the water if any, for force laws.

    All vectors are in the axes of their body unless stated otherwise. The origin of a body is its
    joint. The origin of the root is the centre of its shape.

    Attributes:
        tree: the creature: ``tree.mass`` (kg), ``tree.com`` (from the origin to the centre of mass,
            m), ``tree.centre`` (to the centre of the shape, m), ``tree.volume`` (m^3).
        gravity: gravitational acceleration, m/s^2.
        water: the water, or None on dry land.
        cells: simple volumes that make up the bodies. Empty without a water surface.
        h: length of the physics step, s.
        kin: positions, rotations and velocities in world axes, at the start of the step.
        velocity: velocity of every origin: angular (rad/s), then linear (m/s).
        stream: velocity of the water at the centres of the shapes, m/s, or 0 on dry land.
        pose: upward unit vector, then the height of the origin above the surface, m. It is None
            without a surface.
        displaced: volume under water of each body (m^3), and its first moment (m^4). It is None
            without a surface.
    """

    tree: Tree
    gravity: Number
    water: Water | None
    cells: tuple[Cells, ...]
    h: float
    kin: Kinematics
    velocity: Float[Array, "6 b *n"]
    stream: Float[Array, "3 #b *#n"]
    pose: Float[Array, "4 b *n"] | None
    displaced: DisplacedWater | None

    @property
    def relative(self) -> Float[Array, "6 b *n"]:
        """Velocity of every origin relative to the water."""
        return jnp.concatenate([self.velocity[:3], self.velocity[3:] - self.stream])

    @property
    def through_water(self) -> Float[Array, "3 b *n"]:
        """Velocity of the centres of the shapes relative to the water, m/s."""
        relative = self.relative
        return relative[3:] + cross(relative[:3], expand_dims_like(self.tree.centre, relative))

    @property
    def under_water(self) -> Float[Array, "b *n"]:
        """Fraction of each body's volume that is under water."""
        volume = expand_dims_like(self.tree.volume, self.velocity[0])
        if self.displaced is not None:
            return self.displaced.volume / volume
        return jnp.full_like(self.velocity[0], 0.0 if self.water is None else 1.0)

    def index(self, name: str) -> int:
        """Return the index of a body.

        Raises:
            ValueError: if there is no body with this name.
        """
        if name not in self.tree.names:
            raise ValueError(f"there is no body {name!r}. Allowed: {', '.join(self.tree.names)}")
        return self.tree.names.index(name)

    def wrench_on(
        self, name: str, force: Float[Array, "3 *n"], moment: Float[Array, "3 *n"] | None = None
    ) -> Float[Array, "6 b *n"]:
        """Return the wrench of a force on one body, and zero on the others.

        Args:
            name: name of the body.
            force: force at the body's centre of mass, in body axes, N.
            moment: moment about the body's centre of mass, N m, or None for zero.
        """
        i = self.index(name)
        about_origin = cross(expand_dims_like(self.tree.com[:, i], force), force)
        if moment is not None:
            about_origin = about_origin + moment
        own = jnp.concatenate([about_origin, force])
        here = np.arange(self.tree.body_count) == i
        return own[:, None] * expand_dims_like(here, own)[None]

    def moving(self, velocity: Float[Array, "6 b *n"]) -> "Bodies":
        """Return the bodies in the same pose with other velocities."""
        return dataclasses.replace(self, velocity=velocity)


def bodies_in(
    tree: Tree,
    gravity: Number,
    water: Water | None,
    cells: tuple[Cells, ...],
    h: float,
    kin: Kinematics,
) -> Bodies:
    """Return the bodies of a creature for force laws. `Bodies` has the arguments."""
    velocity = in_body_axes(kin.rotation, kin.angular, kin.linear)
    pose, displaced = None, None
    if water is None:
        stream = jnp.zeros((3, 1) + (1,) * (velocity.ndim - 2), velocity.dtype)
    else:
        centres = kin.origin + matvec(kin.rotation, expand_dims_like(tree.centre, kin.origin))
        stream = matvec_t(kin.rotation, water.velocity(centres))
        if water.surface is not None:
            pose = jnp.concatenate([kin.rotation[2], (kin.origin[2] - water.surface)[None]])
            displaced = displacement(cells, pose)
    return Bodies(tree, gravity, water, cells, h, kin, velocity, stream, pose, displaced)


def in_body_axes(
    rotation: Float[Array, "3 3 b *n"], angular: Float[Array, "3 b *n"], linear: Array
) -> Float[Array, "6 b *n"]:
    """Return the motion of every body in body axes."""
    return jnp.concatenate([matvec_t(rotation, angular), matvec_t(rotation, linear)])


def blocks(m: Float[Array, "6 6 *rest"]) -> Float[Array, "3 3 3 *rest"]:
    """Return the angular, mixed and linear blocks of a symmetric matrix."""
    return jnp.stack([m[:3, :3], m[:3, 3:], m[3:, 3:]])


class WrenchPart(NamedTuple):
    """Part of a law in the form of the implicit step: ``wrench - D (V_1 - V_0) - M A``.

    Attributes:
        wrench: wrench at the start of the step on bodies that do not accelerate.
        resistance: ``h D``, as `blocks`, or None for 0.
        inertia: M about the origins, added to the bodies' own inertias, or None for 0.
    """

    wrench: Float[Array, "6 b *n"]
    resistance: Float[Array, "3 3 3 b *n"] | None = None
    inertia: Float[Array, "6 6 b *n"] | None = None


class ForceLaw(eqx.Module):
    """A force on the bodies that depends on their poses and velocities.

    Subclass `ForceLaw` to write a new law. The constructor gets the keyword arguments in the
    config's ``options`` and, if it accepts them, ``creature`` and ``tree``. The methods must be
    pure JAX functions of arrays whose trailing axes are individuals.

    Attributes:
        of_water: whether the water exerts the force. Energy budgets then count its work as work of
            the water. Such a force must be zero on a creature at rest in still water, because the
            search for a settled start ignores it.

    Example:
        A spring that pulls a body to the origin of the world::

            class Leash(ForceLaw):
                body: str = eqx.field(static=True)
                stiffness: float = 10.0

                def wrench(self, bodies):
                    i = bodies.index(self.body)
                    pull = -self.stiffness * bodies.kin.origin[:, i]
                    # From world axes to body axes.
                    turned = (bodies.kin.rotation[:, :, i] * pull[:, None]).sum(0)
                    return bodies.wrench_on(self.body, turned)
    """

    of_water: ClassVar[bool] = False

    @abc.abstractmethod
    def wrench(self, bodies: Bodies) -> Float[Array, "6 b *n"]:
        """Return the wrench on every body, in body axes.

        Returns:
            The moment about each body's origin (N m), then the force (N). `Bodies.wrench_on`
            returns the wrench of a force at a centre of mass.
        """

    def derivative(self, bodies: Bodies) -> Float[Array, "6 6 b *n"]:
        """Return the derivative of each body's wrench (rows) by its velocity (columns).

        By default JAX differentiates `wrench` in forward mode. For a law that couples bodies, this
        is the derivative by equal changes of all bodies.
        """
        velocity = bodies.velocity

        def along(direction: Float[Array, "6"]) -> Float[Array, "6 b *n"]:
            tangent = jnp.broadcast_to(expand_dims_like(direction, velocity), velocity.shape)
            return jax.jvp(lambda v: self.wrench(bodies.moving(v)), (velocity,), (tangent,))[1]

        return jax.vmap(along, out_axes=1)(jnp.asarray(np.eye(6), velocity.dtype))

    def parts(self, bodies: Bodies) -> tuple[WrenchPart, ...]:
        """Return the parts of the law for the step, by default one, with ``D = -1/2 S_sym``."""

        def equations(kin: Kinematics) -> tuple[Array, Array]:
            now = bodies_in(bodies.tree, bodies.gravity, bodies.water, bodies.cells, bodies.h, kin)
            derivative = self.derivative(now)
            mirrored = jnp.swapaxes(derivative, 0, 1)
            return self.wrench(now), (-0.25 * bodies.h) * blocks(derivative + mirrored)

        # A separate program, so that a message names a law that native code does not support.
        name = f"{type(self).__name__}.wrench"
        found = fuse(equations, bodies.kin, batch_ndim=bodies.velocity.ndim - 2, name=name)
        return (WrenchPart(*found),)

    def averaged(self, start: Bodies, moving: Bodies) -> Float[Array, "6 b *n"] | None:
        """Return the part of the wrench that a step averages over its start and its end.

        The default is the wrench of the skew part of the derivative.

        Args:
            start: the bodies at the start of the step.
            moving: the bodies in the same pose, with the velocities of the start or of the end.
        """
        derivative = self.derivative(start)
        return matvec(0.5 * (derivative - jnp.swapaxes(derivative, 0, 1)), moving.velocity)

    def inertia(self, bodies: Bodies) -> Float[Array, "6 6 b *n"] | None:
        """Return the sum of M over all parts, or None for 0."""
        del bodies
        return None

    def over_step(self, first: Bodies, middle: Bodies, last: Bodies) -> Float[Array, "6 b *n"]:
        """Return the wrench over a step from the motion alone, for energy and momentum budgets.

        Args:
            first: the bodies half a step before the start.
            middle: the bodies in the initial pose with the mean velocities of the step.
            last: the bodies half a step before the end.
        """
        del first, last
        return self.wrench(middle)

    def scaled(self, factor: float) -> "ForceLaw":
        """Return the law with its drag multiplied by a factor. By default it has no drag."""
        del factor
        return self


def weight(bodies: Bodies) -> Float[Array, "6 b *n"]:
    """Return the wrench of weight and buoyancy on every body, in body axes.

    They are one law, and no `ForceLaw`. In deep water their difference ``(rho V - m) g`` is one
    number (Iwadate 2010, eq. 7), because a sum of two forces has larger rounding errors. A body
    whose centre of mass is not that of its volume has both forces, each at its own centre. Both are
    gradients of a potential, which energy balances count as stored energy.
    """
    tree, water, displaced = bodies.tree, bodies.water, bodies.displaced
    under = water.density * tree.volume if water is not None and displaced is None else 0.0
    up, com = bodies.kin.rotation[2], expand_dims_like(tree.com, bodies.kin.rotation[2])
    if tree.centre_of_volume is None:
        force = expand_dims_like((under - tree.mass) * bodies.gravity, up[0])[None] * up
        wrench = jnp.concatenate([cross(com, force), force])
    else:
        pull = expand_dims_like(-tree.mass * bodies.gravity, up[0])[None] * up
        displaced_weight = xp.broadcast_to(under * bodies.gravity, tree.mass.shape)
        lift = expand_dims_like(displaced_weight, up[0])[None] * up
        moment = cross(com, pull) + cross(expand_dims_like(tree.centre, up), lift)
        wrench = jnp.concatenate([moment, pull + lift])
    if water is None or displaced is None:
        return wrench
    lift = jnp.concatenate([cross(displaced.moment, up), displaced.volume[None] * up])
    return wrench + water.density * bodies.gravity * lift


def buoyancy_alone(bodies: Bodies) -> Float[Array, "6 b *n"]:
    """Return the wrench of buoyancy on every body, in body axes."""
    up = bodies.kin.rotation[2]
    pull = expand_dims_like(bodies.tree.mass * bodies.gravity, up[0])[None] * up
    offset = expand_dims_like(bodies.tree.com, up)
    return weight(bodies) + jnp.concatenate([cross(offset, pull), pull])
