"""Torque of a pair of muscles about each joint axis: Ekeberg's springs, Hill's contraction.

Two antagonists pull on every axis. ``ML`` and ``MR`` are their activations, 0 to 1. The first one
pulls towards positive angles. Ekeberg 1993:

    T = alpha (ML - MR) - beta (ML + MR + gamma) phi - delta phi'

Hill's dependence on length and velocity multiplies each muscle's pull (Hill 1938, Zajac 1989):

    T = alpha (ML fl(l_L) fv(q_L) - MR fl(l_R) fv(q_R)) - beta (ML + MR + gamma) phi - delta phi'

    l_L = 1 - e phi,    q_L = e phi' / vmax,    e = arm / fibre length,    the other one with -phi
    fl(l) = exp(-((l - 1) / 0.45)^2)
    fv(q) = (1 - q) / (1 + q / k),   0 for q > 1                 shortening, q > 0
    fv(q) = 1.8 - 0.8 (1 + q) / (1 - 7.56 q / k)                 lengthening, q < 0

Both branches have the form ``fv(q) = 1 - c(q) q`` with a positive c:

    c = (1 + 1/k) / (1 + q / k), at most 1/q    for q > 0
    c = 0.8 (1 + 7.56 / k) / (1 - 7.56 q / k)   for q < 0

so Hill's velocity term is a damper. A step keeps c at the present rate and takes q at the end.
That is stable at any step and any stiffness, and exact at constant rates. The damping delta acts on
the rate at the end of the step, too. The springs act on the mean of three successive angles, with
the weights 1/4, 1/2, 1/4 (Newmark 1959). They are stable at any stiffness, and neither damp the
motion nor do work in a closed cycle. The length factor fl is taken at the start.

| symbol | name |
|---|---|
| alpha, beta | ``strength`` (N m), ``stiffening`` (N m/rad) |
| beta gamma | ``rest_stiffness`` (N m/rad) |
| delta | ``damping`` (N m s/rad) |
| e, e / vmax | ``strain`` (1/rad), ``slowness`` (s/rad) |
| k | ``curvature`` |
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import expand_dims_like
from evo_cpg.creature.laws import Muscles

# Width of the force-length curve, in fibre lengths (Zajac 1989).
_WIDTH = 0.45

# Force of a quickly stretched muscle (isometric force: 1), and slope of its curve. Both are those
# of Minetti and Alexander 1997.
_STRETCHED, _STEEPNESS = 1.8, 7.56

# Minetti and Alexander 1997: numerator and denominator of the metabolic power over q.
_METABOLIC = (0.054, 0.506, 2.46), (1.0, -1.13, 12.8, -1.64)


class Pull(NamedTuple):
    """Torque of the muscles about each axis: ``drive - stiffness phi - damping phi'``.

    Attributes:
        drive: torque at angle and rate 0, N m.
        stiffness: N m/rad.
        damping: N m s/rad.
    """

    drive: Float[Array, "d *n"]
    stiffness: Float[Array, "d *n"]
    damping: Float[Array, "d *n"]

    def torque(self, q: Float[Array, "d *n"], rate: Float[Array, "d *n"]) -> Float[Array, "d *n"]:
        """Return the torque at angles (rad) and rates (rad/s), N m."""
        return self.drive - self.stiffness * q - self.damping * rate


def pull_of(
    muscles: Muscles,
    activation: Float[Array, "2 d *n"] | None,
    q: Float[Array, "d *n"],
    rate: Float[Array, "d *n"],
) -> Pull:
    """Return the torque of the muscles as a function of angle and rate, near the present ones.

    The first activation is that of the muscles that pull to positive angles. Activations are 0 to
    1, or None for relaxed muscles.
    """
    rest, damping = (expand_dims_like(x, q) for x in (muscles.rest_stiffness, muscles.damping))
    if activation is None:
        return Pull(jnp.zeros_like(q), rest + jnp.zeros_like(q), damping + jnp.zeros_like(q))
    strength, stiffening = (expand_dims_like(x, q) for x in (muscles.strength, muscles.stiffening))
    positive, negative = activation
    stiffness = rest + stiffening * (positive + negative)
    if not any(muscles.hill):
        return Pull(strength * (positive - negative), stiffness, damping + jnp.zeros_like(q))
    hill = np.array(muscles.hill, float)
    strain, slowness = (expand_dims_like(hill * x, q) for x in (muscles.strain, muscles.slowness))
    curvature = expand_dims_like(muscles.curvature, q)
    speed, change = slowness * rate, strain * q
    force = []
    for active, side in ((positive, -1.0), (negative, 1.0)):
        # fl, the force of an isometric muscle of this length over its largest force.
        away = (1.0 + side * change - 1.0) * (1.0 / _WIDTH)
        force.append(active * jnp.exp(-away * away))
    resisted = force[0] * resistance(speed, curvature) + force[1] * resistance(-speed, curvature)
    return Pull(
        strength * (force[0] - force[1]), stiffness, damping + strength * slowness * resisted
    )


def resistance(speed: Array, curvature: Array) -> Array:
    """Return c, the fraction of the force that a muscle loses per speed: fv(q) = 1 - c(q) q."""
    bend = 1.0 / curvature
    shortens, fast = speed > 0, jnp.abs(speed)
    slope = jnp.where(shortens, 1.0 + bend, (_STRETCHED - 1.0) * (1.0 + _STEEPNESS * bend))
    chord = slope / (1.0 + jnp.where(shortens, bend, _STEEPNESS * bend) * fast)
    # A muscle that shortens faster than its largest speed has no force: c = 1/q.
    return jnp.where(speed > 1.0, 1.0 / jnp.maximum(fast, 1.0), chord)


def metabolic_power(
    muscles: Muscles, activation: Float[Array, "2 d *n"] | None, rate: Float[Array, "d *n"]
) -> Float[Array, "d *n"]:
    """Return the metabolic power of both muscles about each axis, W (Minetti and Alexander 1997).

    ``P = a F0 vmax Phi(q)``, with q clipped to plus and minus 1. Phi is positive everywhere, so an
    active muscle always costs energy, even if it is stretched.
    """
    if activation is None:
        return jnp.zeros_like(rate)
    slowness, power = (expand_dims_like(x, rate) for x in (muscles.slowness, muscles.power))
    speed = jnp.clip(slowness * rate, -1.0, 1.0)
    positive, negative = activation
    return power * (positive * metabolic_rate(speed) + negative * metabolic_rate(-speed))


def metabolic_rate(speed: Array) -> Array:
    """Return Phi, the metabolic power over F0 vmax, at a speed q from -1 to 1."""
    above, below = _METABOLIC
    numerator = above[0] + speed * (above[1] + speed * above[2])
    return numerator / (below[0] + speed * (below[1] + speed * (below[2] + speed * below[3])))
