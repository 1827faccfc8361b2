"""State of the integrator: pose and velocity of a tree."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import array_of, cross, expand_dims_like, matvec
from evo_cpg.creature.algebra.rotation import integrate_quaternion, matrix_to_quaternion
from evo_cpg.creature.tree import Tree
from evo_cpg.physics.tree import joint_kinds, root
from evo_cpg.physics.tree.hanging import Base, fixed_link


class State(eqx.Module):
    """Pose and velocity of a tree. Trailing axes are individuals.

    The first three fields belong to the root (`evo_cpg.physics.tree.root`), the next two to the
    joints (`evo_cpg.physics.tree.joint_kinds`). If the root hangs on the world, its three fields
    follow from the others (`placed`), and its joint is the first one.

    Attributes:
        position: position of the root's centre in the world, m.
        orientation: unit quaternion (w, x, y, z), root to world.
        velocity: velocity of the root in the world: angular (rad/s), then linear at its centre
            (m/s).
        q: joint angles, rad, displacements of slides, m, and rotation vectors of balls, rad.
        qd: their rates. A ball's are the angular velocity relative to the parent, along the axes
            of the ball that the child carries, rad/s.
        base: frame on which the root hangs, or None for a free root.
    """

    position: Float[Array, "3 *n"]
    orientation: Float[Array, "4 *n"]
    velocity: Float[Array, "6 *n"]
    q: Float[Array, "d *n"]
    qd: Float[Array, "d *n"]
    base: Base | None = None

    @property
    def angular_velocity(self) -> Float[Array, "3 *n"]:
        """Angular velocity of the root in the world, rad/s."""
        return self.velocity[:3]

    @property
    def linear_velocity(self) -> Float[Array, "3 *n"]:
        """Linear velocity of the root's centre in the world, m/s."""
        return self.velocity[3:]

    @property
    def rates(self) -> Float[Array, "v *n"]:
        """Velocities of the root and the joints as one generalized vector."""
        return jnp.concatenate([self.velocity, self.qd])

    def moved(self, tree: Tree, h: float) -> "State":
        """Return the state after h seconds (negative: before) at constant velocities."""
        q = joint_kinds.displaced(tree, self.q, h * self.qd)
        if self.base is not None:
            return dataclasses.replace(self, q=q).placed(tree)
        turned = integrate_quaternion(self.orientation, self.velocity[:3], h)
        return State(self.position + h * self.velocity[3:], turned, self.velocity, q, self.qd)

    def displaced(self, tree: Tree, x: Float[Array, " v"]) -> "State":
        """Return the state at static coordinates from this pose (`step.statics`)."""
        q = joint_kinds.displaced(tree, self.q, x[root.JOINTS])
        if self.base is not None:
            return dataclasses.replace(self, q=q).placed(tree)
        turned = integrate_quaternion(self.orientation, x[root.LENGTHS : root.ROOT_DOFS], 1.0)
        return State(self.position + x[: root.LENGTHS], turned, self.velocity, q, self.qd)

    def placed(self, tree: Tree) -> "State":
        """Return the state with a root that hangs put where its joint holds it."""
        group = tree.hanging
        if self.base is None or group is None:
            return self
        local = joint_kinds.local_frames(tree, self.q)[group.bodies]
        link, _, _ = joint_kinds.linked(tree, group, fixed_link(self.base), local, self.qd)
        rotation, origin, angular, linear = link.rotation[:, :, 0], *(x[:, 0] for x in link[1:4])
        arm = matvec(rotation, expand_dims_like(tree.root_centre, origin))
        velocity = jnp.concatenate([angular, linear + cross(angular, arm)])
        turned = matrix_to_quaternion(rotation)
        return State(origin + arm, turned, velocity, self.q, self.qd, self.base)


def integrate(
    tree: Tree,
    state: State,
    acceleration: Float[Array, "6 *n"],
    qdd: Float[Array, "d *n"],
    h: float,
) -> State:
    """Take a semi-implicit Euler step: the new velocities move the positions."""
    velocity, qd = state.velocity + h * acceleration, state.qd + h * qdd
    return dataclasses.replace(state, velocity=velocity, qd=qd).moved(tree, h)


def resting_state(
    tree: Tree,
    batch: tuple[int, ...] = (),
    dtype: jnp.dtype | type = jnp.float32,
    position: tuple[ArrayLike, ...] = (0.0, 0.0, 0.0),
    orientation: tuple[ArrayLike, ...] = (1.0, 0.0, 0.0, 0.0),
    angles: Sequence[ArrayLike] | Array | None = None,
) -> State:
    """Return a pose at rest, by default the neutral pose.

    Args:
        tree: the creature.
        batch: trailing axes, such as ``(population,)``.
        dtype: floating-point type of every array.
        position: position of the root, m. A root that hangs on the world moves with the world's
            frame, which is put there.
        orientation: orientation of the root or that frame, unit quaternion (w, x, y, z).
        angles: joint angles, rad, or None for the neutral pose.
    """

    def fill(values) -> Array:
        column = array_of(values).reshape(-1, *(1,) * len(batch))
        return jnp.broadcast_to(jnp.asarray(column, dtype), (column.shape[0], *batch))

    still = np.zeros(tree.dof_count)
    bent = still if angles is None else angles
    velocity = np.zeros(root.ROOT_DOFS)
    base = None if tree.hanging is None else Base(fill(position), fill(orientation))
    state = State(fill(position), fill(orientation), fill(velocity), fill(bent), fill(still), base)
    return state.placed(tree)
