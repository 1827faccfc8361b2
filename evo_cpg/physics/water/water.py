"""Water as a medium: its density, its surface and its flow.

    v(x) = v_0 + G x + sum_k Gamma_k / (2 pi) (z x r_k) / (|r_k|^2 + c_k^2),

with r_k the horizontal vector from the axis of vortex k. Each term is a `Stream`.

G with one nonzero element is a velocity gradient along one axis. An antisymmetric G is a rotation
of all the water. A vortex has an upright axis. It is a potential vortex outside its core, and turns
like a solid inside (Scully 1975).
"""

import abc
import functools
import operator

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import array_of, as_matrix_of, expand_dims_like, matvec
from evo_cpg.creature.algebra.numerics import Number, Triple

Gradient = tuple[Triple, Triple, Triple]


class Stream(eqx.Module):
    """A part of the water's motion."""

    @abc.abstractmethod
    def velocity(self, places: Float[Array, "3 b *n"]) -> Float[Array, "3 #b *#n"]:
        """Return the velocity of the water at places in the world, in world axes, m/s."""


class Current(Stream):
    """A current that is uniform or changes linearly.

    Attributes:
        origin: velocity at the origin of the world, m/s.
        gradient: gradient of the velocity's components (rows) along x, y and z, 1/s.
    """

    origin: Triple = (0.0, 0.0, 0.0)
    gradient: Gradient | None = None

    def velocity(self, places: Float[Array, "3 b *n"]) -> Float[Array, "3 #b *#n"]:
        """Return the velocity (see `Stream.velocity`)."""
        velocity = expand_dims_like(array_of(self.origin), places)
        if self.gradient is None:
            return velocity
        rows = as_matrix_of(array_of(self.gradient), places)
        return velocity + matvec(rows, places)


class Vortex(Stream):
    """Water that circles an upright axis.

    Attributes:
        centre: x and y of the axis, m.
        circulation: circulation far from the axis, counterclockwise seen from above, m^2/s.
        core: radius at which the flow is fastest, m.
    """

    centre: tuple[Number, Number]
    circulation: Number
    core: Number

    def velocity(self, places: Float[Array, "3 b *n"]) -> Float[Array, "3 #b *#n"]:
        """Return the velocity (see `Stream.velocity`)."""
        x, y = places[0] - self.centre[0], places[1] - self.centre[1]
        rate = self.circulation / (2 * np.pi) / (x * x + y * y + self.core**2)
        return jnp.stack([-rate * y, rate * x, jnp.zeros_like(x)])


class Water(eqx.Module):
    """Still or flowing water, around the whole creature or up to a surface.

    Attributes:
        density: density of the water, kg/m^3.
        surface: height of the surface, m; None if water is everywhere.
        streams: terms of the flow, whose velocities add up.
    """

    density: Number
    surface: Number | None = None
    streams: tuple[Stream, ...] = (Current(),)

    def velocity(self, places: Float[Array, "3 b *n"]) -> Float[Array, "3 #b *#n"]:
        """Return the velocity of the water at places in the world, in world axes, m/s."""
        return functools.reduce(operator.add, (each.velocity(places) for each in self.streams))
