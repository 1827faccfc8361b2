"""Equations of a tree in generalized coordinates: accelerations, forces and mass matrix.

The accelerations of a tree are one vector y, ``(6 + d, *n)``. First comes the acceleration of the
root (angular, rad/s^2, then linear, m/s^2), then all joint accelerations in the order of the tree.
The matching forces are the root's wrench (moment, N m, then force, N) and the joint torques (N m).
J_i is the Jacobian of a body:

| what | function |
|---|---|
| ``a_i = J_i y`` | `body_accelerations` |
| ``sum J_i^T f_i`` | `generalized_force` |
| ``sum J_i^T I_i J_i`` | `mass_matrix` |

`mass_matrix` is the composite-rigid-body algorithm (Featherstone 2008, table 6.2). All is in world
axes and refers to the bodies' origins, as in `evo_cpg.physics.tree.articulated`. The inertias and
wrenches may include contacts.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from evo_cpg.creature.algebra.linear import cross, expand_dims_like
from evo_cpg.creature.per_body import PerBody, in_dof_order, of_joints, take
from evo_cpg.creature.tree import Tree
from evo_cpg.creature.walk import TreeWalk
from evo_cpg.creature.walked import inwards, outwards
from evo_cpg.physics.tree import joints, root
from evo_cpg.physics.tree.kinematics import Kinematics
from evo_cpg.physics.tree.spatial_algebra import (
    Inertia,
    Motion,
    Wrench,
    inertia_at_parent,
    motion_at_child,
    wrench_at_parent,
)


def body_accelerations(tree: Tree, kin: Kinematics, y: Float[Array, "v *n"]) -> Motion:
    """Return the accelerations ``(3, b, *n)`` of all bodies, without those of `Kinematics`."""
    batch_ndim, qdd = y.ndim - 1, y[root.JOINTS]
    a = outwards(tree, Motion(y[:3], y[3 : root.ROOT_DOFS]), batch_ndim)
    if tree.hanging is not None:
        still = Motion(*(jnp.zeros_like(kin.offset[:, :1]) for _ in range(2)))
        i = tree.hanging
        S, x = kin.axes.of(i, batch_ndim), of_joints(qdd, i, batch_ndim)
        a = PerBody.of(joints.accelerated(still, S, x), batch_ndim)
    for i in tree.groups:
        a_i = motion_at_child(a.of_parents(i), kin.offset[:, i.bodies])
        S, x = kin.axes.of(i, batch_ndim), of_joints(qdd, i, batch_ndim)
        a = a.followed_by(joints.accelerated(a_i, S, x))
    return a[:]


def generalized_force(tree: Tree, kin: Kinematics, wrench: Wrench) -> Float[Array, "v *n"]:
    """Return the generalized force of wrenches ``(3, b, *n)`` on all bodies."""
    batch_ndim = wrench.force.ndim - 2
    f, torques = inwards(tree, wrench, batch_ndim), []
    for i in reversed(tree.groups):
        f_i = f[i.bodies]
        torque = joints.torque_of(kin.axes.of(i, batch_ndim), f_i)
        torques.append(in_dof_order(torque, batch_ndim))
        f = f.plus_to_parents(i, wrench_at_parent(f_i, kin.offset[:, i.bodies]))
    on_root = f.root()
    if tree.hanging is not None:
        S = kin.axes.of(tree.hanging, batch_ndim)
        torques.append(in_dof_order(joints.torque_of(S, f[:1]), batch_ndim))
        on_root = jax.tree.map(jnp.zeros_like, on_root)
    return jnp.concatenate([*on_root, *torques[::-1]])


def generalized_equations(
    tree: Tree,
    kin: Kinematics,
    inertia: Inertia,
    bias: Wrench,
    torque: Float[Array, "d *n"],
    resistance: Float[Array, "d *#n"],
) -> tuple[Float[Array, "v v *n"], Float[Array, "v *n"]]:
    """Return the matrix and the force of the equation that `articulated.solve` solves."""
    matrix, dofs = mass_matrix(tree, kin, inertia), root.ROOT_DOFS + np.arange(tree.dof_count)
    matrix = matrix.at[dofs, dofs].add(resistance)
    force = generalized_force(tree, kin, Wrench(-bias.moment, -bias.force))
    return matrix, force.at[root.JOINTS].add(torque)


def mass_matrix(tree: Tree, kin: Kinematics, inertia: Inertia) -> Float[Array, "v v *n"]:
    """Return the mass matrix of the inertias ``(3, 3, b, *n)`` of all bodies."""
    I_c = inwards(tree, inertia, inertia.linear.ndim - 3)
    for i in reversed(tree.groups):
        carried = inertia_at_parent(I_c[i.bodies], kin.offset[:, i.bodies])
        I_c = I_c.plus_to_parents(i, carried)
    whole, size = I_c.root(), root.ROOT_DOFS + tree.dof_count
    rows = [[whole.angular, whole.mixed], [jnp.swapaxes(whole.mixed, 0, 1), whole.linear]]
    block = jnp.concatenate([jnp.concatenate(row, 1) for row in rows])
    if tree.hanging is not None:
        one = expand_dims_like(np.eye(len(block)), block)
        block = jnp.broadcast_to(one, block.shape).astype(block.dtype)
    H = jnp.zeros((size, size, *block.shape[2:]), block.dtype)
    H = H.at[: len(block), : len(block)].set(block)
    if not tree.dof_count:
        return H
    if tree.walk is not None:
        return _with_joints_of_walk(tree, tree.walk, kin, I_c[:], H)
    # Joint elements on and below the diagonal. The force f = I^c S that a unit acceleration of a
    # degree of freedom needs climbs from its body to the root. All degrees of freedom climb
    # together, one body in each round of the loop. At every body, the product of f with the axes of
    # the body's joint gives elements of the row. Axes of one joint meet twice, so only those up to
    # the degree of freedom itself count. At a free root, the components of f are the elements.
    body, dofs = np.array(tree.dof_bodies, int), np.arange(tree.dof_count)
    of_dofs = jax.tree.map(lambda x: take(x, body, 2), I_c[:])
    needed = joints.momentum(of_dofs, jax.tree.map(lambda x: x[:, None], kin.axes))
    f = Wrench(needed.moment[:, 0], needed.force[:, 0])
    places, values = [], []
    while len(dofs):
        met = [
            (one, other)
            for one, dof in enumerate(dofs)
            for other, owner in enumerate(tree.dof_bodies)
            if owner == body[one] and other <= dof
        ]
        one, other = np.array(met, int).reshape(-1, 2).T
        values.append(joints.torque_on_each(kin.axes, f, (other, one)))
        places.append(root.ROOT_DOFS + np.stack([dofs[one], other], 1))
        f, body = wrench_at_parent(f, take(kin.offset, body)), np.array(tree.parents)[body]
        top, below = np.flatnonzero(body == 0), np.flatnonzero(body > 0)
        if tree.hanging is not None:
            top, below = top[:0], np.flatnonzero(body >= 0)
        for k, part in enumerate([*f.moment, *f.force] if len(top) else []):
            values.append(take(part, top, 0))
            places.append(np.stack([root.ROOT_DOFS + dofs[top], np.full(len(top), k)], 1))
        f = Wrench(take(f.moment, below), take(f.force, below))
        body, dofs = body[below], dofs[below]
    rows, columns = np.concatenate(places).T
    values = jnp.concatenate(values)
    return H.at[rows, columns].set(values).at[columns, rows].set(values)


def _with_joints_of_walk(
    tree: Tree, walk: TreeWalk, kin: Kinematics, I_c: Inertia, H: Float[Array, "v v *n"]
) -> Float[Array, "v v *n"]:
    """Return the mass matrix with its joint elements, for any parents.

    The element of two degrees of freedom is ``S_j^T I^c_i S_i`` about the root's origin, if one
    moves the body of the other.
    """
    body, dofs = np.array(tree.dof_bodies, int), root.ROOT_DOFS + np.arange(tree.dof_count)
    arm = take(kin.origin, body) - kin.origin[:, :1]
    of_dofs = jax.tree.map(lambda x: take(x, body, 2), I_c)
    needed = joints.momentum(of_dofs, jax.tree.map(lambda x: x[:, None], kin.axes))
    force = needed.force[:, 0]
    f = jnp.concatenate([needed.moment[:, 0] + cross(arm, force), force])
    S = jnp.concatenate([kin.axes.angular, cross(arm, kin.axes.angular)])
    one, other = np.tril_indices(tree.dof_count)
    moves = jnp.asarray(walk.above, H.dtype)[body[one], body[other]]
    values = expand_dims_like(moves, f[0]) * (S[:, other] * f[:, one]).sum(0)
    rows, columns = dofs[one], dofs[other]
    H = H.at[rows, columns].set(values).at[columns, rows].set(values)
    H = H.at[dofs, : root.ROOT_DOFS].set(jnp.swapaxes(f, 0, 1))
    return H.at[: root.ROOT_DOFS, dofs].set(f)
