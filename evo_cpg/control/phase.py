"""Phase of a Matsuoka oscillator, and what the load of a limb does to it.

Let D = y_e - y_f be the output of an oscillator, and Z = z_e - z_f its adaptation. Eq. 5 of
`evo_cpg.control.matsuoka` gives T_a Z' = D - Z. If D = A sin(phi) with phi' = omega, then

    Z = A (sin(phi) - w cos(phi)) / (1 + w^2),    w = omega T_a,
    A cos(phi) = (D - (1 + w^2) Z) / w,    A sin(phi) = D.                                 (1)

So phi is the angle of a point in the plane of output and adaptation. The extensor is active from 0
to pi, and the flexor from pi to 2 pi. The ratio w only scales one axis of the plane. It follows
from harmonic balance: let x_e - x_f be D over a gain k. Then eqs. 4 and 5 without drive give

    (1 + i omega T_r) (1 + w i) = k (a (1 + w i) - b),
    k = (T_r + T_a) / (a T_a),    w^2 = ((T_r + T_a) b - T_r a) / (T_r a).                (2)

Here a is the sum of all inhibitions of the oscillator. Each neighbour swings as its coupling
demands: in phase if it inhibits the other side, and in antiphase if it inhibits the same side.

*Tegotae* (Owaki and Ishiguro 2017) lets the load N of a limb hold the oscillator in the stance:

    phi' = omega - sigma N cos(phi),    swing from 0 to pi, stance from pi to 2 pi.        (3)

A Matsuoka oscillator has no variable phi to add a term to. But a clock that runs at the rate r
multiplies every velocity by r, hence phi' = r omega exactly, also far from weak feedback. Eq. 3 is

    r = 1 - s n cos(phi),    s = sigma m g / omega,    n = N / (m g),                     (4)

limited to 0 <= r <= 3. So the extensor swings the limb, and the setting s has no unit.

*Phase reset* (Aoi and Tsuchiya 2005) sets phi at touch-down. Eq. 1 gives D and Z for the present
amplitude A and the new phi. The sums x_e + x_f and z_e + z_f stay.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from evo_cpg.control.matsuoka import MatsuokaNetwork, MatsuokaState, output
from evo_cpg.spatial.linear import expand_dims_like
from evo_cpg.spatial.numerics import Numbers, xp

# Largest rate of a clock. The Runge-Kutta steps are at most a quarter of T_r at the rate 1.
FASTEST = 3.0

# Smallest w^2. Eq. 2 gives less only if b is near the limit of oscillation.
_LEAST_RATIO = 0.25

# Added to a squared amplitude, so that a silent oscillator has a finite phase.
_SILENT = 1e-12


def inhibitions(network: MatsuokaNetwork) -> Float[Numbers, "o *m"]:
    """Return the sum of all inhibitions of each oscillator, a in eq. 2."""
    return xp.sum(network.weights, 0) + xp.sum(network.own_weights, 0)


def phasor(
    network: MatsuokaNetwork, state: MatsuokaState, adaptation_gain: Float[Array, "o *n"]
) -> tuple[Float[Array, "o *n"], Float[Array, "o *n"]]:
    """Return A cos(phi) and A sin(phi) of each oscillator (eq. 1)."""
    squared = _squared_ratio(network, adaptation_gain)
    signal, difference = output(state), state.adaptation[0] - state.adaptation[1]
    return (signal - (1 + squared) * difference) / jnp.sqrt(squared), signal


def clock_rate(
    network: MatsuokaNetwork,
    state: MatsuokaState,
    adaptation_gain: Float[Array, "o *n"],
    strength: Float[Array, "o *n"],
) -> Float[Array, "o *n"]:
    """Return the rate of each oscillator's clock (eq. 4).

    Args:
        network: the oscillators.
        state: state of the neurons.
        adaptation_gain: b of each oscillator.
        strength: s n of each oscillator.
    """
    cosine, sine = phasor(network, state, adaptation_gain)
    cosine = cosine / jnp.sqrt(cosine * cosine + sine * sine + _SILENT)
    return jnp.clip(1 - strength * cosine, 0.0, FASTEST)


def with_phase(
    network: MatsuokaNetwork,
    state: MatsuokaState,
    adaptation_gain: Float[Array, "o *n"],
    phase: Float[Array, "o *#n"],
    which: Bool[Array, "o *n"],
) -> MatsuokaState:
    """Return a state in which some oscillators have another phase.

    Args:
        network: the oscillators.
        state: state of the neurons.
        adaptation_gain: b of each oscillator.
        phase: phi to set, rad.
        which: oscillators to set.
    """
    squared = _squared_ratio(network, adaptation_gain)
    cosine, sine = phasor(network, state, adaptation_gain)
    size = jnp.sqrt(cosine * cosine + sine * sine + _SILENT)
    signal = size * jnp.sin(phase)
    difference = (signal - jnp.sqrt(squared) * size * jnp.cos(phase)) / (1 + squared)
    mean = 0.5 * (state.potential[0] + state.potential[1])
    # If one neuron is silent, the other one's potential is the whole output.
    apart = jnp.maximum(jnp.abs(signal), 2 * (jnp.abs(signal) - mean))
    apart = jnp.where(signal < 0, -apart, apart)
    centre = 0.5 * (state.adaptation[0] + state.adaptation[1])

    def around(middle: Array, span: Array, old: Array) -> Array:
        return jnp.where(which, jnp.stack([middle + 0.5 * span, middle - 0.5 * span]), old)

    return MatsuokaState(
        around(mean, apart, state.potential), around(centre, difference, state.adaptation)
    )


def _squared_ratio(
    network: MatsuokaNetwork, adaptation_gain: Float[Array, "o *n"]
) -> Float[Array, "o *n"]:
    """Return w^2 of each oscillator (eq. 2)."""
    rise, adaptation = network.rise_time, network.adaptation_time
    inhibition = expand_dims_like(inhibitions(network), adaptation_gain)
    squared = ((rise + adaptation) / rise) * adaptation_gain / inhibition - 1
    return jnp.maximum(squared, _LEAST_RATIO)
