"""Lift of thin bodies, such as fins and flippers.

The water pushes a plate at an angle of attack a along its normal, with the force
``1/2 rho V^2 S C_N(a)``. Form drag already gives ``C_N(90) sin^2 a``. This law adds the rest,

    F = -1/2 rho V^2 S (C_N(a) - C_N(90) sin^2 a) n,

against the normal velocity, so that its power is never positive. The rest is 0 at 90 degrees.

At small angles the flow is attached, and beyond the stall angle it is separated:

    attached   C_N = 0.9 K sin a cos a + 2.2 sin^2 a,     K = 2 pi AR / (2 + sqrt(AR^2 + 4)),
    stalled    C_N = 2 (1 / (0.56 + 0.44 sin a) - 0.41 (1 - exp(-17 / AR))) sin a
                     (1 + 0.81 sin^4 a cos^2 a),
    stall      sin a_s = 0.1 + 0.74 / (1 + 1.1 AR), with a logistic function of sin a.

The attached form is Polhamus's (1966) with K by Helmbold. The numbers 0.9 and 2.2, and those of the
stall, are fitted to plates of aspect ratio 1 and 2 (Pelletier and Mueller 2000). The stalled form
is Lindenburg's. Its last factor is fitted to a plate of aspect ratio 2 at a Reynolds number of 100
(Taira et al. 2007).

The aspect ratio is ``span^2 / S``. The span is the extent across the flow's projection on the
plate. For flow along tangent 1 of a plate of lengths L_1 and L_2 it is L_2, in general
``span^2 = (L_2^2 v_1^2 + L_1^2 v_2^2) / (v_1^2 + v_2^2)``. The mean chord is ``S / span``.

The whole normal force acts ahead of the centre, at a quarter of the chord for small angles and at
the centre for 90 degrees. Its lever is ``chord / 4 (1 - sin a)``. Added mass has such a moment of
its own (Munk), which is the whole moment of a long plate. Then the law has no moment.

V is the velocity of the centre through the water. At a surface the force is proportional to the
fraction of the body under water.

| symbol | name |
|---|---|
| C_N / sin a | ``per_sine`` |
| AR | ``aspect`` |
| v_n, v_1, v_2 | velocity along the rows of ``PlateLift.frame`` |
"""

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.decisions import Condition, all_hold, chosen
from evo_cpg.creature.algebra.linear import (
    as_matrix_of,
    cross,
    dot,
    expand_dims_like,
    matvec,
    matvec_t,
)
from evo_cpg.creature.algebra.numerics import Numbers, smooth_step, xp
from evo_cpg.creature.creature import Creature
from evo_cpg.creature.per_body import spread, take
from evo_cpg.creature.slender import LEAST_BODIES, slender_chains
from evo_cpg.creature.surface import PointLayout
from evo_cpg.creature.tree import Tree
from evo_cpg.physics.water.force_law import Bodies, ForceLaw, WrenchPart

# Reduction of the potential slope, and vortex lift of a rectangular plate. Polhamus's 3.14 is for
# deltas, and too large for rectangles.
_SLOPE, _VORTEX = 0.9, 2.2

# Lindenburg's coefficients: drag of an infinite plate, shape of the nose, and finite span.
_LONG_PLATE, _NOSE, _FINITE, _SPAN = 2.0, 0.44, 0.41, 17.0

# Increase of Lindenburg's force at 55 degrees. Without it, the lift of a plate of aspect ratio 2 at
# 60 degrees and Re 100 is 24 % too small.
_OBLIQUE = 0.12

# Sine of the stall angle of a long plate, its increase at aspect ratio 0, and the decay.
_STALL, _STALL_MORE, _STALL_DECAY = 0.1, 0.74, 1.1

# Width of the stall in the sine of the angle.
_STALL_WIDTH = 0.04

# Centre of pressure at small angles ahead of the centre, as a fraction of the chord.
_AHEAD = 0.25

# Thickness over the smaller other extent up to which a body is a plate, and from which it is not.
_THIN, _THICK = 0.25, 0.75

# Squared speed (m^2/s^2) added under roots, so that their derivatives exist at rest.
_SPEED_FLOOR = 1e-12

# Resolution of the surface points from which the area of a plate is found.
_RESOLUTION = 16


class _Flow(NamedTuple):
    """Flow at the plates.

    Attributes:
        centre: centres of the plates from the bodies' origins, m.
        frame: normal and two tangents of each plate, as rows.
        local: velocity of the centre through the water along the normal and the tangents, m/s.
        speed: speed of the centre, m/s.
        slip: speed along the plate, m/s.
        sine: sine of the angle of attack.
        aspect: aspect ratio.
        per_sine: C_N over the sine.
        pressure: ``1/2 rho S`` of the parts under water, kg/m.
        resistance: additional force against the normal velocity, over this velocity, N s/m.
        row: row of the normal velocity for the velocity of the body.
    """

    centre: Float[Array, "3 p *#n"]
    frame: Float[Array, "3 3 p *#n"]
    local: Float[Array, "3 p *n"]
    speed: Float[Array, "p *n"]
    slip: Float[Array, "p *n"]
    sine: Float[Array, "p *n"]
    aspect: Float[Array, "p *n"]
    per_sine: Float[Array, "p *n"]
    pressure: Float[Array, "p *n"]
    resistance: Float[Array, "p *n"]
    row: Float[Array, "6 p *n"]


class PlateLift(ForceLaw):
    """Lift of plates, in addition to their form drag.

    The force over a step is ``-c(v_0) v_n``, with the normal velocity v_n at the end. So light
    plates are stable. The rest of the derivative is averaged with the predicted velocity, and the
    step is of second order. The symmetric part of the whole derivative does not serve as D: it
    could make the inertia of a light plate negative.

    Attributes:
        bodies: indices of the plates in the tree.
        frame: normal and two tangents of each plate, as rows in the axes of its body.
        lengths: extents along the tangents, m.
        area: area of one side, m^2.
        weight: fraction of the force, 1 for thin bodies and 0 for thick ones.
        has_moment: whether the force acts ahead of the centre.
    """

    of_water: ClassVar[bool] = True

    bodies: tuple[int, ...] = eqx.field(static=True)
    frame: Float[Numbers, "3 3 p"]
    lengths: Float[Numbers, "2 p"]
    area: Float[Numbers, " p"]
    weight: Float[Numbers, " p"]
    has_moment: bool = eqx.field(static=True, default=True)

    def wrench(self, bodies: Bodies) -> Float[Array, "6 b *n"]:
        """Return the lift on every body (`ForceLaw.wrench`)."""
        flow = self._flow(bodies)
        force = -flow.frame[0] * (flow.resistance * flow.local[0])[None]
        moment = cross(flow.centre, force)
        if self.has_moment:
            # The moment of the whole normal force about the centre, in plate axes.
            whole = -flow.pressure * flow.speed * flow.local[0] * flow.per_sine
            chord = jnp.sqrt(expand_dims_like(self.area, flow.slip) / flow.aspect)
            # The lever 1 - sin a along the flow is (cos a)^2 / (1 + sin a), here over the slip.
            lever = _AHEAD * chord * flow.slip / (flow.speed * flow.speed * (1.0 + flow.sine))
            turning = whole * lever
            none = jnp.zeros_like(turning)
            own = jnp.stack([none, turning * flow.local[2], -turning * flow.local[1]])
            moment = moment + matvec_t(flow.frame, own)
        return spread(jnp.concatenate([moment, force]), self.bodies, bodies.tree.body_count)

    def parts(self, bodies: Bodies) -> tuple[WrenchPart]:
        """Return the lift with ``c w w^T`` as D, for the row w of the normal velocity."""
        flow = self._flow(bodies)
        c, angular, linear = flow.resistance, flow.row[:3], flow.row[3:]
        pairs = ((angular, angular), (angular, linear), (linear, linear))
        outer = jnp.stack([c[None, None] * a[:, None] * b[None] for a, b in pairs])
        own = (bodies.h * outer).reshape(27, *c.shape)
        flat = spread(own, self.bodies, bodies.tree.body_count)
        return (WrenchPart(self.wrench(bodies), flat.reshape(3, 3, 3, *flat.shape[1:])),)

    def averaged(self, start: Bodies, moving: Bodies) -> Float[Array, "6 b *n"]:
        """Return the wrench of the derivatives that D leaves out (`ForceLaw.averaged`)."""
        velocities = (start.velocity,), (moving.velocity,)
        whole = jax.jvp(lambda v: self.wrench(start.moving(v)), *velocities)[1]
        flow = self._flow(start)
        row, c = flow.row, flow.resistance
        own = 2.0 * c * dot(row, take(moving.velocity, np.array(self.bodies)))
        return whole + spread(row * own[None], self.bodies, start.tree.body_count)

    def _flow(self, bodies: Bodies) -> _Flow:
        own = np.array(self.bodies)
        velocity = take(bodies.through_water, own)
        frame = as_matrix_of(self.frame, velocity)
        local = matvec(frame, velocity)
        normal, first, second = local
        along = first * first + second * second + _SPEED_FLOOR
        speed, slip = jnp.sqrt(normal * normal + along), jnp.sqrt(along)
        one, other = expand_dims_like(self.lengths, local)
        across = other * other * first * first + one * one * second * second
        square = (across + one * other * _SPEED_FLOOR) / along
        aspect, sine = square / expand_dims_like(self.area, normal), jnp.abs(normal) / speed
        cosine = slip / speed
        potential = 2.0 * jnp.pi * aspect / (2.0 + jnp.sqrt(aspect * aspect + 4.0))
        attached = _SLOPE * potential * cosine + _VORTEX * sine
        # C_N at 90 degrees by Lindenburg: 1.18 for a square, 2 for a long plate.
        broadside = _LONG_PLATE * (1.0 - _FINITE * (1.0 - jnp.exp(-_SPAN / aspect)))
        nose = 1.0 / (1.0 - _NOSE + _NOSE * sine)
        stalled = broadside + _LONG_PLATE * (nose - 1.0)
        stalled = stalled * (1.0 + _OBLIQUE * 6.75 * sine**4 * cosine * cosine)
        stall = _STALL + _STALL_MORE / (1.0 + _STALL_DECAY * aspect)
        separated = jax.nn.sigmoid((sine - stall) / _STALL_WIDTH)
        per_sine = attached + separated * (stalled - attached)
        assert bodies.water is not None
        wet = take(bodies.under_water, own, 0)
        area = expand_dims_like(self.weight * self.area, normal)
        pressure = 0.5 * bodies.water.density * area * wet
        centre = expand_dims_like(bodies.tree.centre[:, own], bodies.velocity)
        outward = jnp.broadcast_to(frame[0], local.shape)
        return _Flow(
            centre=centre,
            frame=frame,
            local=local,
            speed=speed,
            slip=slip,
            sine=sine,
            aspect=aspect,
            per_sine=per_sine,
            pressure=pressure,
            resistance=pressure * speed * (per_sine - broadside * sine),
            row=jnp.concatenate([cross(centre, outward), outward]),
        )


def make_plate_lift(
    creature: Creature, tree: Tree, has_moment: bool = True, layout: PointLayout = "merged"
) -> PlateLift | None:
    """Return the lift of the thin bodies outside slender chains, or None if there are none.

    The layout "complete" keeps thick bodies, with a weight of 0.
    """
    chained = {
        creature.bodies[body].name
        for chain in slender_chains(creature)
        if len(chain.bodies) >= LEAST_BODIES
        for body in chain.bodies
    }
    shapes = {body.name: body.shape for body in creature.bodies}
    free = [i for i, name in enumerate(tree.names) if name not in chained]
    weights = []
    for i in free:
        thickness, width, _ = xp.sort(shapes[tree.names[i]].stretch[0])
        ratio = thickness / xp.maximum(width, 1e-12)
        thin = smooth_step((_THICK - ratio) / (_THICK - _THIN))
        # A body of size 0 has no lift.
        weights.append(xp.where(width > 0, thin, 0.0))

    def choose() -> tuple[int, ...]:
        kept = zip(free, weights, strict=True)
        return tuple(i for i, weight in kept if weight > 0 or layout == "complete")

    def still(plates: tuple[int, ...]) -> Condition:
        return all_hold(
            weight == 0 for i, weight in zip(free, weights, strict=True) if i not in plates
        )

    plates = chosen(choose, still)
    if not plates:
        return None
    frames, lengths, areas = [], [], []
    for i in plates:
        shape = shapes[tree.names[i]]
        half, axes = shape.stretch
        thinnest = xp.where(half <= xp.min(half), 1.0, 0.0)
        # The first of equal axes.
        thinnest = thinnest * xp.where(xp.cumsum(thinnest) > 1.0, 0.0, 1.0)
        normal, first = axes @ thinnest, axes @ xp.roll(thinnest, 1)
        tangents = first, xp.cross(normal, first)
        extents = [along @ (shape.support(along) - shape.support(-along)) for along in tangents]
        _, normals, of_points = shape.surface(_RESOLUTION)
        area = (of_points * xp.abs(normals @ normal)).sum() / 2
        # A body of size 0 has a weight of 0, and any lengths serve.
        sizes = [xp.where(size > 0, size, 1.0) for size in (*extents, area)]
        frames.append(xp.stack([normal, *tangents]))
        lengths.append(xp.array(sizes[:2]))
        areas.append(sizes[2])
    return PlateLift(
        plates,
        xp.stack(frames, -1),
        xp.stack(lengths, -1),
        xp.array(areas),
        xp.array([weight for i, weight in zip(free, weights, strict=True) if i in plates]),
        has_moment,
    )
