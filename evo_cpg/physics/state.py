"""What the integrator carries from step to step."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from evo_cpg.creature.tree import Tree
from evo_cpg.spatial.linear import array_of


class State(eqx.Module):
    """Pose and velocity of a free-floating tree; trailing axes are individuals.

    Attributes:
        position: of the root's centre in the world, m.
        orientation: unit quaternion (w, x, y, z), root to world.
        velocity: of the root in the world: angular (rad/s), then linear at its centre (m/s).
        q: joint angles, rad.
        qd: joint rates, rad/s.
    """

    position: Float[Array, "3 *n"]
    orientation: Float[Array, "4 *n"]
    velocity: Float[Array, "6 *n"]
    q: Float[Array, "d *n"]
    qd: Float[Array, "d *n"]


def resting_state(
    tree: Tree,
    batch: tuple[int, ...] = (),
    dtype: jnp.dtype | type = jnp.float32,
    position: tuple[ArrayLike, ...] = (0.0, 0.0, 0.0),
    orientation: tuple[ArrayLike, ...] = (1.0, 0.0, 0.0, 0.0),
    angles: tuple[ArrayLike, ...] | None = None,
) -> State:
    """A pose at rest, the neutral one unless told otherwise.

    Args:
        tree: the creature.
        batch: trailing axes, such as ``(population,)``.
        dtype: floating-point type of every array.
        position: of the root, m.
        orientation: of the root, unit quaternion (w, x, y, z).
        angles: of the joints, rad; None for the neutral pose.
    """

    def fill(values) -> Array:
        column = array_of(values).reshape(-1, *(1,) * len(batch))
        return jnp.broadcast_to(jnp.asarray(column, dtype), (column.shape[0], *batch))

    still = np.zeros(tree.dof_count)
    bent = still if angles is None else angles
    return State(fill(position), fill(orientation), fill(np.zeros(6)), fill(bent), fill(still))
