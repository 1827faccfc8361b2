"""Slip: speed over the ground of everything that touches it, weighted by load.

With the load N_p of a contact point p (the vertical force of the ground, N) and the horizontal
velocity v_p of the material at the point (m/s), the slip speed of a trial is

    v_s = int sum_p N_p |v_p| dt / int sum_p N_p dt.                                     (1)

A rolling or pivoting foot does not slip, because the material at its lowest point is at rest. A
point without load counts nothing. A body needs no name to be a foot: all contact points of the
creature count, and those of the belly and the tail too. On level ground with one coefficient of
sliding friction mu, the numerator times mu is the energy that friction dissipates.

Differs from a mean over the time of contact: a foot that lands or leaves counts by its load, so
there is no touch-down to detect, and equation (1) has derivatives.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from evo_cpg.simulation.task import Transition

# Squared speed (m^2/s^2) added under the root, so that a point at rest has a derivative.
_FLOOR = 1e-20
# Load (N) below which nothing touches.
_NO_LOAD = 1e-9


class Slip(NamedTuple):
    """Sums over control steps, for equation (1).

    Attributes:
        slide: load times speed, all contact points together, N m/s.
        load: load of all contact points, N.
    """

    slide: Float[Array, " *n"]
    load: Float[Array, " *n"]

    def speed(self) -> Float[Array, " *n"]:
        """Return the slip speed, m/s, or 0 if nothing has touched the ground."""
        return self.slide / jnp.maximum(self.load, _NO_LOAD)

    def plus(self, other: "Slip") -> "Slip":
        """Return the sums with further control steps."""
        return Slip(self.slide + other.slide, self.load + other.load)


def no_slip(batch: tuple[int, ...], dtype: jnp.dtype) -> Slip:
    """Return the sums before a trial."""
    none = jnp.zeros(batch, dtype)
    return Slip(none, none)


def slip_of_points(force: Float[Array, "3 p *n"], velocity: Float[Array, "3 p *n"]) -> Slip:
    """Return the slip of contact points at an instant.

    Args:
        force: force of the ground on every contact point, world axes, N.
        velocity: velocity of the material at every contact point, m/s.
    """
    x, y, _ = velocity
    load = jnp.maximum(force[2], 0.0)
    return Slip((load * jnp.sqrt(x * x + y * y + _FLOOR)).sum(0), load.sum(0))


def slip_of_step(transition: Transition) -> Slip:
    """Return the slip in a control step: mean load, and velocities at the end of the step."""
    return slip_of_points(transition.forces.contact_force, transition.after.contact_velocity)
