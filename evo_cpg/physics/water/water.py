"""Water as a medium: its density, its surface and its flow.

    v(x) = v_0 + G x + sum_k Gamma_k / (2 pi) (z x r_k) / (|r_k|^2 + c_k^2),

with r_k the horizontal vector from the axis of vortex k. Each term is a `Stream`. A stream that
changes has a velocity at each time t (s). Its numbers are those of t = 0, and `Stream.at` moves it.

G with one nonzero element is a velocity gradient along one axis. An antisymmetric G is a rotation
of all the water. A vortex has an upright axis. It is a potential vortex outside its core, and turns
like a solid inside (Scully 1975).
"""

import abc
import dataclasses
import functools
import operator

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import array_of, as_matrix_of, expand_dims_like, matvec
from evo_cpg.creature.algebra.numerics import Number, Triple, xp

Gradient = tuple[Triple, Triple, Triple]

# Rows of a street flow as at this distance everywhere beyond it, in spacings / pi. Their velocity
# differs by e^-40 from its limit, and the squares of cosh are finite in float32.
_FAR = 20.0


class Stream(eqx.Module):
    """A part of the water's motion.

    Attributes:
        changes: whether the velocity changes in time.
    """

    changes = False

    def at(self, time: Number) -> "Stream":
        """Return the stream as it is at a time, s. A steady stream is always the same."""
        del time
        return self

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
        drift: velocity of the axis along x and y, m/s, or None for an axis at rest.
    """

    centre: tuple[Number, Number]
    circulation: Number
    core: Number
    drift: tuple[Number, Number] | None = None

    @property
    def changes(self) -> bool:
        """Whether the vortex drifts."""
        return self.drift is not None

    def at(self, time: Number) -> "Vortex":
        """Return the vortex at a time, s."""
        if self.drift is None:
            return self
        x, y = (place + time * rate for place, rate in zip(self.centre, self.drift, strict=True))
        return dataclasses.replace(self, centre=(x, y))

    def velocity(self, places: Float[Array, "3 b *n"]) -> Float[Array, "3 #b *#n"]:
        """Return the velocity (see `Stream.velocity`)."""
        x, y = places[0] - self.centre[0], places[1] - self.centre[1]
        rate = self.circulation / (2 * np.pi) / (x * x + y * y + self.core**2)
        return jnp.stack([-rate * y, rate * x, jnp.zeros_like(x)])


class Oscillation(Stream):
    """A uniform current ``amplitude * sin(2 pi t / period + phase)``.

    Attributes:
        amplitude: largest velocity, m/s.
        period: period, s.
        phase: phase at t = 0, rad.
    """

    amplitude: Triple
    period: Number
    phase: Number = 0.0
    changes = True

    def at(self, time: Number) -> "Oscillation":
        """Return the oscillation that begins at a time, s."""
        return dataclasses.replace(self, phase=self.phase + 2 * np.pi * time / self.period)

    def velocity(self, places: Float[Array, "3 b *n"]) -> Float[Array, "3 #b *#n"]:
        """Return the velocity (see `Stream.velocity`)."""
        return expand_dims_like(array_of(self.amplitude), places) * xp.sin(self.phase)


class Street(Stream):
    """Two endless rows of upright vortices, as in the wake of a cylinder or of a fish.

    A row along x with the spacing a has a closed form (Lamb 1932, art. 156). It gets the core c of
    `Vortex`, so that both agree near an axis. With X = pi x / a, Y = pi y / a and k = pi c / a:

        (u, v) = Gamma / 2 a (-sinh Y cosh Y, sin X cos X) / (sinh^2 Y + sin^2 X + k^2).

    The rows have opposite circulations, and are staggered by half a spacing.

    Attributes:
        spacing: distance of neighbours in a row, m.
        width: distance of the rows, m.
        circulation: circulation of each vortex in the left row, counterclockwise seen from above,
            m^2/s. If it is positive, water flows ahead between the rows, as behind a swimming fish.
        core: radius of a core, m.
        speed: speed of the vortices along the heading, m/s.
        heading: bearing of the rows from the x axis, rad.
        place: x and y of a point midway between the rows, m.
        phase: distance from ``place`` to a vortex of the left row at t = 0, in spacings.
    """

    spacing: Number
    width: Number
    circulation: Number
    core: Number
    speed: Number
    heading: Number = 0.0
    place: tuple[Number, Number] = (0.0, 0.0)
    phase: Number = 0.0
    changes = True

    def at(self, time: Number) -> "Street":
        """Return the street at a time, s."""
        return dataclasses.replace(self, phase=self.phase + self.speed * time / self.spacing)

    def velocity(self, places: Float[Array, "3 b *n"]) -> Float[Array, "3 #b *#n"]:
        """Return the velocity (see `Stream.velocity`)."""
        cosine, sine = xp.cos(self.heading), xp.sin(self.heading)
        x, y = places[0] - self.place[0], places[1] - self.place[1]
        along = np.pi * ((cosine * x + sine * y) / self.spacing - self.phase)
        aside = cosine * y - sine * x
        sin, cos = jnp.sin(along), jnp.cos(along)
        u, v = self._row(sin, cos, aside - 0.5 * self.width)
        # Half a spacing ahead, X is less by pi / 2.
        other_u, other_v = self._row(-cos, sin, aside + 0.5 * self.width)
        rate = 0.5 * self.circulation / self.spacing
        u, v = rate * (u - other_u), rate * (v - other_v)
        return jnp.stack([cosine * u - sine * v, sine * u + cosine * v, jnp.zeros_like(u)])

    def _row(self, sin: Array, cos: Array, aside: Array) -> tuple[Array, Array]:
        """Return the velocity along and across a row, in circulations / 2 spacings."""
        scale = np.pi / self.spacing
        growth = jnp.exp(jnp.clip(scale * aside, -_FAR, _FAR))
        sinh, cosh = 0.5 * (growth - 1 / growth), 0.5 * (growth + 1 / growth)
        below = sinh * sinh + sin * sin + (scale * self.core) ** 2
        return -sinh * cosh / below, sin * cos / below


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

    @property
    def flows(self) -> bool:
        """Whether the water may move: a number of a stream is not 0."""
        return any(np.any(number) for number in jax.tree.leaves(self.streams))

    @property
    def changes(self) -> bool:
        """Whether the velocity changes in time."""
        return any(stream.changes for stream in self.streams)

    def at(self, time: Number) -> "Water":
        """Return the water at a time, s, or the same water if it does not change."""
        if not self.changes:
            return self
        return dataclasses.replace(self, streams=tuple(each.at(time) for each in self.streams))

    def velocity(self, places: Float[Array, "3 b *n"]) -> Float[Array, "3 #b *#n"]:
        """Return the velocity of the water at places in the world, in world axes, m/s."""
        return functools.reduce(operator.add, (each.velocity(places) for each in self.streams))

    def along(self, path: Float[Array, "3 t"], time: Float[Array, " t"]) -> Float[Array, "3 t"]:
        """Return the velocity at places, each at its own time (s), m/s."""

        def velocity(place: Array, time: Array) -> Array:
            return self.at(time).velocity(place[:, None])[:, 0]

        return jax.vmap(velocity, -1, -1)(path, time)
