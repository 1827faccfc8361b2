"""Drag of water with a viscosity: creeping flow, boundary layer and form drag.

Three terms add up. Each one is small where it does not belong, so there is no switch:

- Creeping flow, ``-mu R V``. R (6x6) is constant: the resistance of the ellipsoid of the whole
  chain (`evo_cpg.physics.water.viscous_bodies`), divided among its bodies by their lengths.
- Boundary layer, ``-1/2 rho c_f s G V``. G (6x6) is the integral of the tangential velocities over
  the exposed surface. c_f is the local coefficient of a flat plate at ``Re_x = rho s x / mu``:
  ``0.664 Re_x^-1/2`` (laminar), ``0.0592 Re_x^-1/5`` (turbulent), with a smooth transition at 5e5.
- Form drag, ``-1/2 rho q k A |v_n| v_n n`` at surface points. The constant k gives the whole chain
  the drag of its shape (`evo_cpg.physics.water.viscous_bodies`). For round bodies
  ``q = 1 - 0.3 * 4 y / (1 + y)^2`` with ``y = Re_d / 2500``: the drag of spheres and cylinders is
  lowest at Re 2500.

The speed s is the root mean square over the body. The rate ``s / x`` is
``sqrt(sum_i (s_i / x_i)^2)``, s_i being the speed along an axis of the body. Along the centreline,
x is the distance from the animal's nose, or from its tail if the body moves backwards. Across it, x
is the path around the body. The distance is that of the mean coefficient over the body, a quarter
of the length for a single body.

D, the decrease of the force per change of velocity over a step, is half the slope of the force, as
in `evo_cpg.physics.water.fluid`: that of q for form drag, and 3/4 of the friction, which grows as
``s^1.5``. D has the part ``(1 + z) / (2 + z)`` of the creeping flow, z being the largest rate of a
free body's decay times the step. A free body then decays by ``2 / (2 + 2 z + z^2)`` in a step, of
second order and stable for any z.

Differs from nature: the drag crisis beyond Re 2e5 is missing, and so is the history of the flow.
"""

import dataclasses
import functools
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import expand_dims_like
from evo_cpg.creature.algebra.numerics import Number, Numbers
from evo_cpg.physics.water.fluid import DragOnPatches, PointPlaces, over_patches, wet_fraction
from evo_cpg.physics.water.force_law import Bodies, WrenchPart, blocks

# Local friction coefficients 0.664 Re^-1/2 (Blasius) and 0.0592 Re^-1/5 (Prandtl), and the power of
# the weight of the transition.
_LAMINAR, _TURBULENT, _STEEPNESS = 0.664, 0.0592, 4

# Part of the friction in D: half the power of the speed.
_FRICTION_IN_STEP = 0.75

# Reynolds number at which the form drag of round bodies is lowest.
_DIP_RE = 2500.0

# Floors under the squared speed (m^2/s^2) and the squared rate (1/s^2), for gradients at rest.
_SPEED_FLOOR, _RATE_FLOOR = 1e-12, 1e-12


class Wetted(NamedTuple):
    """Constants of one body in the water, in its working frame.

    Attributes:
        normal: rows for the normal velocity of the points, ``(points, 6)``.
        form: k A of each point, m^2.
        motion: rows for the velocities of the centre along the outline's axes, and for the angular
            velocities about them, ``(6, 6)``.
        speed: weights ``(1, 6)`` of the squares of these velocities in the mean squared speed.
        rate: weights ``(1, 6)`` of the squares in the squared rate, without the centreline, 1/m^2.
        friction: G, ``(6, 6)``.
        creep: R, ``(6, 6)``.
        decay: largest decay rate of the free body in creeping flow, over the viscosity, m/kg.
        fade: rate below which the boundary layer fades out, over the kinematic viscosity, 1/m^2.
        transition: Re_x of the transition to turbulent friction.
        diameter: thickness of the body, m.
        dip: depth of the dip of form drag, for the body or for each of its points.
    """

    normal: Float[Numbers, "p 6"]
    form: Float[Numbers, " p"]
    motion: Float[Numbers, "6 6"]
    speed: Float[Numbers, "1 6"]
    rate: Float[Numbers, "1 6"]
    friction: Float[Numbers, "6 6"]
    creep: Float[Numbers, "6 6"]
    decay: Float[Numbers, " 1"]
    fade: Float[Numbers, " 1"]
    transition: Float[Numbers, " 1"]
    diameter: Float[Numbers, " 1"]
    dip: Float[Numbers, " q"]


class ViscousPatch(NamedTuple):
    """Bodies that have the same constants, except for their distance from the nose.

    Attributes:
        bodies: indices in the tree, in increasing order.
        wetted: constants of each of the bodies.
        outer: blocks of the outer products of the rows of form drag, ``(27, points)``.
        forward: squared inverse distance from the nose, for each body, 1/m^2.
        backward: squared inverse distance from the tail, for each body, 1/m^2.
        places: places of the points of form drag, or None for water without a surface.
    """

    bodies: tuple[int, ...]
    wetted: Wetted
    outer: Float[Numbers, "27 p"]
    forward: Float[Numbers, " k"]
    backward: Float[Numbers, " k"]
    places: PointPlaces | None


class ViscousDrag(DragOnPatches):
    """Creeping flow, boundary layer and form drag.

    Attributes:
        viscosity: dynamic viscosity mu, Pa s.
        form_drag: factor of the form coefficients.
        factor: factor of the whole drag.
    """

    viscosity: Number
    form_drag: Number
    patches: tuple[ViscousPatch, ...] = ()
    factor: Number = 1.0

    def parts(self, bodies: Bodies) -> tuple[WrenchPart]:
        """Return the drag wrench with the D of the module docstring (`ForceLaw.parts`)."""
        velocity = bodies.relative
        inputs = [velocity]
        if bodies.pose is not None:
            inputs += [bodies.pose, bodies.under_water[None]]
        evaluate = functools.partial(self._patch, bodies)
        wrench, derivative = over_patches(self.patches, inputs, evaluate)
        return (WrenchPart(wrench, bodies.h * derivative),)

    def scaled(self, factor: float) -> "ViscousDrag":
        """Return the law with all its forces multiplied by a factor."""
        return dataclasses.replace(self, factor=self.factor * factor)

    def _patch(
        self,
        bodies: Bodies,
        patch: ViscousPatch,
        run: slice,
        velocity: Float[Array, "6 k *n"],
        pose: Float[Array, "4 k *n"] | None = None,
        under: Float[Array, "1 k *n"] | None = None,
    ) -> tuple[Float[Array, "6 k *n"], Float[Array, "3 3 3 k *n"]]:
        """Return the wrench and D of some bodies of a patch."""
        assert bodies.water is not None
        own, density = patch.wetted, bodies.water.density
        batch = velocity.shape[1:]
        flat = velocity.reshape(6, -1)

        def product(constant: Numbers, x: Array) -> Array:
            return jnp.asarray(constant, flat.dtype) @ x

        def each(weights: Numbers) -> Array:
            part = jnp.asarray(weights, flat.dtype)[patch.bodies.index(run.start) :][: batch[0]]
            return jnp.broadcast_to(expand_dims_like(part, velocity[0]), batch).reshape(1, -1)

        viscosity = self.viscosity / density
        moving = product(own.motion, flat)
        squares = moving * moving
        along = jnp.where(moving[:1] > 0, each(patch.forward), each(patch.backward))
        speed = product(own.speed, squares) + _SPEED_FLOOR
        rate = jnp.sqrt(product(own.rate, squares) + squares[:1] * along + _RATE_FLOOR)
        # 1/2 c_f s, m/s. The speed is s^2, the rate s / x.
        fading = rate / jnp.sqrt(rate + own.fade[0] * viscosity)
        laminar = (0.5 * _LAMINAR) * jnp.sqrt(viscosity) * fading
        reynolds = speed / (rate * viscosity)
        ratio = _TURBULENT / _LAMINAR * jnp.exp(0.3 * jnp.log(reynolds))
        power = (reynolds / own.transition[0]) ** _STEEPNESS
        friction = laminar * (1.0 + power / (1.0 + power) * (ratio - 1.0))
        friction = (self.factor * density) * friction
        y = jnp.sqrt(speed) * (own.diameter[0] / (_DIP_RE * viscosity))
        # Flat ends have no dip, so each point of a cylinder has its own.
        of_points = len(own.dip) > 1
        depth = own.dip[:, None] if of_points else own.dip[0]
        below = depth * y / ((1.0 + y) * (1.0 + y))
        dip = 1.0 - 4.0 * below
        # Half the slope of dip * speed^2.
        in_step = dip - 2.0 * below * (1.0 - y) / (1.0 + y)
        creep = jnp.full_like(speed, self.factor * self.viscosity)

        normal = product(own.normal, flat)
        pressure = jnp.abs(normal)
        if pose is not None and under is not None:
            pressure = pressure * wet_fraction(patch.places, pose)
            friction, creep = friction * under.reshape(1, -1), creep * under.reshape(1, -1)
        form = (0.5 * self.factor * self.form_drag) * density * own.form
        if of_points:
            wrench = -product(own.normal.T * form[None], dip * pressure * normal)
        else:
            wrench = dip * -product(own.normal.T * form[None], pressure * normal)
        wrench = wrench - friction * product(own.friction, flat) - creep * product(own.creep, flat)
        if of_points:
            derivative = product(patch.outer * form[None], in_step * pressure)
        else:
            derivative = in_step * product(patch.outer * form[None], pressure)
        of_friction, of_creep = (
            blocks(jnp.asarray(matrix, flat.dtype)).reshape(27, 1)
            for matrix in (own.friction, own.creep)
        )
        derivative = derivative + (_FRICTION_IN_STEP * friction) * of_friction
        z = bodies.h * self.factor * self.viscosity * own.decay[0]
        derivative = derivative + ((1 + z) / (2 + z) * creep) * of_creep
        return wrench.reshape(velocity.shape), derivative.reshape(3, 3, 3, *batch)
