"""Where the water streams: a current that is uniform or changes linearly, and vortices.

    v(x) = v_0 + G x + sum_k Gamma_k / (2 pi) (z x r_k) / (|r_k|^2 + c_k^2),

with r_k the level vector from the axis of vortex k.

G with one element is a shear (with the height, or along the way), antisymmetric it is a rotation of
all the water. A vortex stands upright; outside its core it is the potential vortex, inside it
turns like a solid (Scully 1975).
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.spatial.linear import array_of, expand_dims_like, matvec
from evo_cpg.spatial.numerics import Number, Triple

Gradient = tuple[Triple, Triple, Triple]


class Vortex(NamedTuple):
    """Water that circles an upright axis.

    Attributes:
        centre: x and y of the axis, m.
        circulation: far from the axis, counterclockwise seen from above, m^2/s.
        core: radius at which it streams fastest, m.
    """

    centre: tuple[Number, Number]
    circulation: Number
    core: Number


def stream(
    current: Triple,
    gradient: Gradient | None,
    vortices: tuple[Vortex, ...],
    places: Float[Array, "3 b *n"],
) -> Float[Array, "3 #b *#n"]:
    """Velocity of the water, in world axes, m/s.

    Args:
        current: at the origin of the world, m/s.
        gradient: of its components (rows) along x, y and z, 1/s.
        vortices: on top of that.
        places: in the world, m.
    """
    velocity = expand_dims_like(array_of(current), places)
    if gradient is not None:
        velocity = velocity + matvec(
            expand_dims_like(array_of(gradient), places, places.ndim + 1), places
        )
    for vortex in vortices:
        x, y = places[0] - vortex.centre[0], places[1] - vortex.centre[1]
        rate = vortex.circulation / (2 * np.pi) / (x * x + y * y + vortex.core**2)
        velocity = velocity + jnp.stack([-rate * y, rate * x, jnp.zeros_like(x)])
    return velocity
