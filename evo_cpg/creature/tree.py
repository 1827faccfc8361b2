"""The creature as the physics sees it: a static tree and constant arrays.

Bodies stand level by level (see `topological_order`); those of one level from which limbs of the
same build grow form a `Group`, which the recursions treat at once. Each body's working frame sits
at its joint (the root's at its centre), with the axes of the body's own frame.

| symbol | name |
|---|---|
| r_i | ``joint_offset``: joint of body i in the frame of its parent |
| c_i | ``com``: centre of mass in the body's working frame |
| I_i | ``inertia``: 6x6 spatial inertia about the working frame's origin, angular part first |
"""

import itertools
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from evo_cpg.creature.creature import Creature, neutral_pose, topological_order

# A soft limit is a critically damped spring on the inertia that the joint sees, slow enough for
# a step of 1/120 s to resolve it; on top of that it balances the joint's own motor, which would
# otherwise push through: one that asks for 1 rad/s, or pulls to 1 rad, beyond it gets 0.016 rad.
LIMIT_FREQUENCY = 10.0
LIMIT_DAMPING_RATIO = 1.0


class Group(NamedTuple):
    """Bodies of one level from which limbs of the same build grow, such as all four thighs.

    The physics treats them side by side: of the same build are limbs with equally many joint axes
    and, at each, as many limbs of the same build. A trunk segment beside two hands is a group of
    its own.

    Attributes:
        bodies: slice of the tree's bodies.
        dofs: slice of the tree's degrees of freedom.
        axes: joint axes of each body.
        parents: index of each body's parent.
    """

    bodies: slice
    dofs: slice
    axes: int
    parents: tuple[int, ...]


class Tree(eqx.Module):
    """A free-floating tree of rigid bodies in the order of the recursions.

    Attributes:
        names: body names.
        parents: index of each body's parent, -1 for the root.
        groups: every body but the root, in groups that the recursions treat together.
        dof_names: ``body.axis`` names.
        dof_bodies: index of the body that each degree of freedom moves.
        joint_offset: joint position in the parent's frame, m.
        joint_orientation: child frame to parent frame in the neutral pose.
        joint_axes: unit vectors in the child's neutral frame.
        mass: kg.
        volume: m^3.
        com: centre of mass (and of volume) in the working frame, m.
        inertia: spatial inertia in the working frame, kg m^2, kg m and kg.
        stiffness: passive spring, N m/rad.
        damping: passive damping, N m s/rad.
        armature: rotor inertia, kg m^2.
        lower: lower joint limit, rad.
        upper: upper joint limit, rad.
        servo_gain: N m s/rad; 0 for a passive axis.
        servo_stiffness: of the motors' springs, N m/rad.
        torque_limit: N m.
        limit_stiffness: of the soft limits, N m/rad.
        limit_damping: of the soft limits, N m s/rad.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    parents: tuple[int, ...] = eqx.field(static=True)
    groups: tuple[Group, ...] = eqx.field(static=True)
    dof_names: tuple[str, ...] = eqx.field(static=True)
    dof_bodies: tuple[int, ...] = eqx.field(static=True)
    joint_offset: Float[np.ndarray, "3 b"]
    joint_orientation: Float[np.ndarray, "3 3 b"]
    joint_axes: Float[np.ndarray, "3 d"]
    mass: Float[np.ndarray, " b"]
    volume: Float[np.ndarray, " b"]
    com: Float[np.ndarray, "3 b"]
    inertia: Float[np.ndarray, "6 6 b"]
    stiffness: Float[np.ndarray, " d"]
    damping: Float[np.ndarray, " d"]
    armature: Float[np.ndarray, " d"]
    lower: Float[np.ndarray, " d"]
    upper: Float[np.ndarray, " d"]
    servo_gain: Float[np.ndarray, " d"]
    servo_stiffness: Float[np.ndarray, " d"]
    torque_limit: Float[np.ndarray, " d"]
    limit_stiffness: Float[np.ndarray, " d"]
    limit_damping: Float[np.ndarray, " d"]

    @property
    def body_count(self) -> int:
        """Number of rigid bodies."""
        return len(self.names)

    @property
    def dof_count(self) -> int:
        """Number of joint axes; the free root's six degrees are not counted."""
        return len(self.dof_names)


def build_tree(creature: Creature) -> Tree:
    """Arrange a creature's bodies for the recursions.

    Raises:
        CreatureError: the bodies do not form one tree (see `topological_order`).
    """
    order = topological_order(creature)
    bodies = [creature.bodies[i] for i in order]
    names = [body.name for body in bodies]
    parents = [names.index(body.joint.parent) if body.joint else -1 for body in bodies]
    child_anchor = np.array(
        [body.joint.child_anchor if body.joint else (0, 0, 0) for body in bodies], float
    )
    # A joint's place is given in its parent's geometric frame, whose origin lies at
    # -child_anchor of the parent's working frame.
    offset = np.array(
        [
            np.array(body.joint.parent_anchor) - child_anchor[parent] if body.joint else np.zeros(3)
            for body, parent in zip(bodies, parents, strict=True)
        ]
    )
    orientation = np.array(
        [np.array(body.joint.orientation) if body.joint else np.eye(3) for body in bodies]
    )
    mass = np.array([body.shape.volume * body.material.density for body in bodies])
    com = -child_anchor
    inertia = np.stack(
        [
            spatial_inertia(m, c, body.shape.inertia_tensor(m))
            for m, c, body in zip(mass, com, bodies, strict=True)
        ],
        axis=-1,
    )
    joints = [body.joint for body in bodies if body.joint]
    actuators = [(joint.actuator, len(joint.axes)) for joint in joints]
    dof_bodies = [i for i, body in enumerate(bodies) if body.joint for _ in body.joint.axes]
    limit_rate = 2 * np.pi * LIMIT_FREQUENCY
    leverage = _effective_inertia(creature, order)
    gain = _per_dof([(a.gain if a else 0.0, n) for a, n in actuators])
    spring = _per_dof([(a.stiffness if a else 0.0, n) for a, n in actuators])
    return Tree(
        names=tuple(names),
        parents=tuple(parents),
        groups=_groups(bodies, parents, dof_bodies),
        dof_names=tuple(
            f"{body.name}.{_axis_name(axis)}"
            for body in bodies
            if body.joint
            for axis in body.joint.axes
        ),
        dof_bodies=tuple(dof_bodies),
        joint_offset=offset.T,
        joint_orientation=np.moveaxis(orientation, 0, -1),
        joint_axes=np.array([axis for j in joints for axis in j.axes], float).reshape(-1, 3).T,
        mass=mass,
        volume=np.array([body.shape.volume for body in bodies]),
        com=com.T,
        inertia=inertia,
        stiffness=_per_dof([(j.stiffness, len(j.axes)) for j in joints]),
        damping=_per_dof([(j.damping, len(j.axes)) for j in joints]),
        armature=_per_dof([(j.armature, len(j.axes)) for j in joints]),
        lower=np.array([limit for j in joints for limit in j.lower], float),
        upper=np.array([limit for j in joints for limit in j.upper], float),
        servo_gain=gain,
        servo_stiffness=spring,
        torque_limit=_per_dof([(a.torque_limit if a else 0.0, n) for a, n in actuators]),
        limit_stiffness=leverage * limit_rate**2 + (gain + spring) * limit_rate,
        limit_damping=2 * LIMIT_DAMPING_RATIO * leverage * limit_rate,
    )


def spatial_inertia(mass: float, com: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """Spatial inertia ``(6, 6)`` about a frame's origin, angular part first.

    Args:
        mass: kg.
        com: centre of mass in the frame, m.
        inertia: rotational inertia ``(3, 3)`` about the centre of mass, kg m^2.
    """
    x, y, z = com
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.block(
        [
            [inertia - mass * cross @ cross, mass * cross],
            [-mass * cross, mass * np.eye(3)],
        ]
    )


def _effective_inertia(creature: Creature, order: list[int]) -> np.ndarray:
    """Inertia ``(d,)`` that each axis sees in the neutral pose, kg m^2.

    The two halves of the animal on either side of the joint turn against each other, so it is
    the product of their inertias about the axis over the sum.
    """
    centres, rotations = neutral_pose(creature)
    names = [body.name for body in creature.bodies]
    effective = []
    for i in order:
        joint = creature.bodies[i].joint
        if joint is None:
            continue
        distal = {names[i]}
        for j in order:
            other = creature.bodies[j].joint
            if other is not None and other.parent in distal:
                distal.add(names[j])
        anchor = centres[i] + rotations[i] @ np.array(joint.child_anchor)
        for axis in joint.axes:
            direction = rotations[i] @ np.array(axis)
            halves = {True: 0.0, False: 0.0}
            for j, body in enumerate(creature.bodies):
                mass = body.shape.volume * body.material.density
                spin = rotations[j] @ body.shape.inertia_tensor(mass) @ rotations[j].T
                arm = np.cross(direction, centres[j] - anchor)
                halves[body.name in distal] += direction @ spin @ direction + mass * arm @ arm
            effective.append(halves[True] * halves[False] / (halves[True] + halves[False]))
    return np.array(effective)


def _groups(bodies: list, parents: list[int], dof_bodies: list[int]) -> tuple[Group, ...]:
    depth = [0]
    for parent in parents[1:]:
        depth.append(depth[parent] + 1)
    build: dict[int, tuple] = {}
    for i in reversed(range(1, len(bodies))):
        limbs = sorted(build[j] for j in range(i + 1, len(bodies)) if parents[j] == i)
        build[i] = len(bodies[i].joint.axes), *limbs
    groups: list[Group] = []
    for _, run in itertools.groupby(range(1, len(bodies)), lambda i: (depth[i], build[i])):
        members = list(run)
        start, axes = members[0], len(bodies[members[0]].joint.axes)
        first_dof = dof_bodies.index(start)
        groups.append(
            Group(
                bodies=slice(start, members[-1] + 1),
                dofs=slice(first_dof, first_dof + axes * len(members)),
                axes=axes,
                parents=tuple(parents[i] for i in members),
            )
        )
    return tuple(groups)


def _per_dof(values: list[tuple[float, int]]) -> np.ndarray:
    return np.array([value for value, axes in values for _ in range(axes)], float)


def _axis_name(axis: tuple[float, float, float]) -> str:
    for name, unit in zip("xyz", np.eye(3), strict=True):
        if np.allclose(np.abs(axis), unit):
            return name
    return "(" + ",".join(f"{value:g}" for value in axis) + ")"
