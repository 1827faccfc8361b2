"""The creature in the form of the physics: a static tree and constant arrays.

Bodies are ordered by depth in the tree (see `topological_order`). Adjacent bodies of one depth with
limbs of the same build form a `Group`, which the recursions treat at once. The origin of a body's
working frame is at its joint (a free root's at its centre), with the axes of the body's own frame.

| symbol | name |
|---|---|
| r_i | ``joint_offset``: joint of body i in the frame of its parent |
| c_i | ``com``: centre of mass in the body's working frame |
| I_i | ``inertia``: 6x6 spatial inertia about the working frame's origin, angular part first |
"""

import bisect
import dataclasses
import itertools
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from evo_cpg.creature.algebra.decisions import some_hold
from evo_cpg.creature.algebra.numerics import Number, Numbers, xp
from evo_cpg.creature.axis_kinds import SPANNING, AxisKind, names_of_dofs
from evo_cpg.creature.creature import (
    NO_LIMIT,
    Body,
    Creature,
    Joint,
    JointKind,
    neutral_pose,
    rigid_owners,
    topological_order,
)
from evo_cpg.creature.laws import (
    BallLimits,
    CoordinateLaws,
    Tendons,
    ball_limits_of,
    laws_of,
    tendons_of,
)
from evo_cpg.creature.walk import TreeWalk

# Least volume of a body, so that a body without size has a fraction under water, m^3.
LEAST_VOLUME = 1e-30


class Group(NamedTuple):
    """Bodies of one depth in the tree with limbs of the same build, such as all four thighs.

    The physics treats them side by side. Limbs have the same build if they have equally many joint
    axes, and carry equally many limbs of the same build. A trunk segment is not in a
    group with two hands.

    Attributes:
        bodies: slice of the tree's bodies.
        dofs: slice of the tree's degrees of freedom.
        axes: number of joint axes of each body.
        parents: index of each body's parent.
        kind: kind of the joints.
        kinds: kinds of their axes.
    """

    bodies: slice
    dofs: slice
    axes: int
    parents: tuple[int, ...]
    kind: JointKind
    kinds: tuple[AxisKind, ...]

    @property
    def at_once(self) -> bool:
        """Whether the axes turn at once, and not one after the other."""
        return any(kind.at_once for kind in self.kinds)


class Tree(CoordinateLaws):
    """A tree of rigid bodies in the order of the recursions, with the force laws of its axes.

    The root floats freely, or hangs on the fixed world (`evo_cpg.physics.tree.hanging`). The joint
    of a root that hangs comes first among the degrees of freedom.

    Attributes:
        names: body names.
        parents: index of each body's parent, -1 for the root.
        groups: all bodies except the root, in groups that the recursions treat together.
        hanging: the root as a group, if it hangs on the world, or None for a free root.
        dof_names: names of the degrees of freedom, ``body.axis``.
        dof_bodies: index of the body that each degree of freedom moves.
        dof_kinds: kind of each degree of freedom.
        owners: index of the body that each body is rigidly joined to, directly or by others: the
            first one of a rigid group, often the body itself.
        wholes: index of the body that each body is a part of, usually the body itself.
        joint_offset: joint position in the parent's frame (a root's in the world's), m.
        joint_orientation: rotation from child frame to parent frame in the neutral pose.
        joint_axes: unit vectors in the child's neutral frame.
        joint_places: positions of the axes in the working frame, m, or None if no joint moves the
            origin of its body, as only those of a "chain" do.
        mass: mass of each body, kg. A welded body has none: its owner has the mass of all bodies
            that are welded together.
        volume: volume of each body, m^3.
        com: centre of mass in the working frame, m.
        root_centre: origin of the root's own frame in its working frame, m.
        centre_of_volume: centre of the shape in the working frame, m, or None if it is ``com``.
        inertia: spatial inertia in the working frame, kg m^2, kg m and kg.
        rest: angles at which the passive springs are relaxed, rad, or None if all are 0.
        tendons: fixed tendons, or None if there are none.
        ball_limits: limits of the angles of balls, or None if there are none. The components of a
            ball have no limits of their own.
        walk: the parents of the bodies if they differ between individuals. The bodies are then in
            the order of the walk, each in a group of its own, and `parents` has no meaning.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    parents: tuple[int, ...] = eqx.field(static=True)
    groups: tuple[Group, ...] = eqx.field(static=True)
    hanging: Group | None = eqx.field(static=True)
    dof_names: tuple[str, ...] = eqx.field(static=True)
    dof_bodies: tuple[int, ...] = eqx.field(static=True)
    dof_kinds: tuple[AxisKind, ...] = eqx.field(static=True)
    owners: tuple[int, ...] = eqx.field(static=True)
    wholes: tuple[int, ...] = eqx.field(static=True)
    joint_offset: Float[Numbers, "3 b"]
    joint_orientation: Float[Numbers, "3 3 b"]
    joint_axes: Float[Numbers, "3 d"]
    joint_places: Float[Numbers, "3 d"] | None
    mass: Float[Numbers, " b"]
    volume: Float[Numbers, " b"]
    com: Float[Numbers, "3 b"]
    root_centre: Float[Numbers, "3"]
    centre_of_volume: Float[Numbers, "3 b"] | None
    inertia: Float[Numbers, "6 6 b"]
    rest: Float[Numbers, " d"] | None
    tendons: Tendons | None = None
    ball_limits: BallLimits | None = None
    walk: TreeWalk | None = None

    @property
    def body_count(self) -> int:
        """Number of rigid bodies."""
        return len(self.names)

    @property
    def dof_count(self) -> int:
        """Number of joint axes, without the free root's six degrees of freedom."""
        return len(self.dof_names)

    @property
    def centre(self) -> Float[Numbers, "3 b"]:
        """Centre of each body's shape, the centre of its volume, in the working frame, m."""
        return self.com if self.centre_of_volume is None else self.centre_of_volume

    @property
    def rigid_mass(self) -> Float[Numbers, " b"]:
        """Mass of all bodies that each body is welded to, and of the body itself, kg."""
        if self.owners == tuple(range(len(self.names))):
            return self.mass
        return self.mass[np.array(self.owners)]

    @property
    def torque_driven(self) -> tuple[bool, ...]:
        """Whether a torque motor, of the axis or of a tendon, follows each command."""
        own = (False,) * self.dof_count if self.torque_motors is None else self.torque_motors.driven
        if self.tendons is None:
            return own
        pulling = self.tendons.torque_gears
        return tuple(driven or dof in pulling for dof, driven in enumerate(own))

    @property
    def gears(self) -> Float[Numbers, " d"] | None:
        """Torque or force per unit of each command, 0 without a torque motor, None without any."""
        if self.tendons is None or not self.tendons.torque_gears:
            return None if self.torque_motors is None else self.torque_motors.gear
        own = [0.0] * self.dof_count if self.torque_motors is None else self.torque_motors.gear
        pulling = self.tendons.torque_gears
        return xp.array([pulling.get(dof, gear) for dof, gear in enumerate(own)], float)

    def of_commands(self, name: str) -> Float[Numbers, " d"]:
        """Return a number of the law that each command acts on: of its axis or of its tendon.

        Args:
            name: field of axes and tendons, such as ``servo_stiffness`` or ``upper``.
        """
        own = getattr(self, name)
        if self.tendons is None:
            return own
        each = zip(self.tendons.channels, getattr(self.tendons, name), strict=True)
        pulling = dict(each)
        return xp.array([pulling.get(dof, number) for dof, number in enumerate(own)], float)

    @property
    def slides(self) -> Bool[np.ndarray, " d"]:
        """Degrees of freedom whose coordinate is a length, with the units m, m/s and N."""
        return np.array([kind.unit == "m" for kind in self.dof_kinds], bool)

    @property
    def root_slides(self) -> tuple[int, ...]:
        """Degrees of freedom of the slides on which the root hangs."""
        count = 0 if self.hanging is None else self.hanging.axes
        return tuple(np.flatnonzero(self.slides[:count]).tolist())

    @property
    def balls(self) -> tuple[int, ...]:
        """First degree of freedom of each ball joint."""
        components = [i for i, kind in enumerate(self.dof_kinds) if kind.at_once]
        return tuple(components[::SPANNING])

    def without_motors(self, axes: Bool[np.ndarray, " d"]) -> "Tree":
        """Return the tree with idle motors about some axes, and muscles without active fibres.

        Idle motors and muscles have no torque and cost no energy. The springs and dampers of
        relaxed muscles stay. The motor of a tendon is idle if any of the tendon's joints is.
        """
        tendons = self.tendons
        if tendons is not None:
            pairs = zip(tendons.owners, tendons.dofs, strict=True)
            idle = np.zeros(len(tendons.names), bool)
            idle[[owner for owner, dof in pairs if axes[dof]]] = True
            tendons = tendons.with_idle(idle)
        return dataclasses.replace(self.with_idle(axes), tendons=tendons)


def build_tree(creature: Creature) -> Tree:
    """Arrange a creature's bodies for the recursions.

    Raises:
        CreatureError: the bodies do not form one tree (see `topological_order`), or a tendon spans
            no joints (see `tendons_of`).
    """
    order = topological_order(creature)
    bodies = [creature.bodies[i] for i in order]
    names = [body.name for body in bodies]
    parents = [names.index(body.joint.parent) if body.joint else -1 for body in bodies]
    own = [creature.joint_of(body) for body in bodies]
    child_anchor = xp.array(
        [joint.child_anchor if joint else (0.0, 0.0, 0.0) for joint in own], float
    )
    # `parent_anchor` is in the parent's geometric frame. The origin of that frame is at
    # -child_anchor in the parent's working frame.
    parent_anchor = xp.array(
        [joint.parent_anchor if joint else (0.0, 0.0, 0.0) for joint in own], float
    )
    jointed = np.array([[float(parent >= 0)] for parent in parents])
    offset = parent_anchor - jointed * child_anchor[np.array(parents)]
    orientation = xp.stack(
        [xp.array(joint.orientation) if joint else np.eye(3) for joint in own], axis=-1
    )
    centre, owners = -child_anchor, rigid_owners(bodies)
    mass, com, inertias = _masses(bodies, parents, owners, offset, orientation, centre)
    dofs = [dof for joint in own if joint for dof in joint.dofs]
    dof_bodies = [i for i, joint in enumerate(own) if joint for _ in joint.dofs]
    groups = _groups(bodies, parents, dof_bodies)
    root = creature.root_joint
    hanging = root and _group_of(root, slice(0, 1), 0, (-1,))
    dof_names = names_of_dofs(
        (names[i], dof.kind, dof.axis) for i, dof in zip(dof_bodies, dofs, strict=True)
    )
    inertia = _effective_inertia(creature, order)
    # A ball has one limit of its own (`ball_limits_of`), and its components have none.
    laws = laws_of(
        [x._replace(lower=-NO_LIMIT, upper=NO_LIMIT) if x.kind.at_once else x for x in dofs],
        inertia,
    )
    rest = xp.array([dof.rest for dof in dofs], float)
    carry = any(group.kind == "chain" for group in (*groups, hanging) if group)
    places = xp.array([dof.place for dof in dofs], float).reshape(-1, 3).T if carry else None
    return Tree(
        names=tuple(names),
        parents=tuple(parents),
        groups=groups,
        hanging=hanging,
        dof_names=dof_names,
        dof_bodies=tuple(dof_bodies),
        dof_kinds=tuple(dof.kind for dof in dofs),
        owners=tuple(owners),
        wholes=tuple(
            i if body.whole is None else names.index(body.whole) for i, body in enumerate(bodies)
        ),
        joint_offset=offset.T,
        joint_orientation=orientation,
        joint_axes=xp.array([dof.axis for dof in dofs], float).reshape(-1, 3).T,
        joint_places=places,
        mass=mass,
        volume=xp.maximum(xp.array([body.shape.volume for body in bodies]), LEAST_VOLUME),
        com=com.T,
        root_centre=-child_anchor[0],
        centre_of_volume=None if com is centre else centre.T,
        inertia=xp.stack(inertias, axis=-1),
        rest=rest if some_hold(lambda: rest != 0) else None,
        ball_limits=ball_limits_of(dofs, laws["limit_stiffness"], laws["limit_damping"]),
        tendons=tendons_of(creature.tendons, dof_names, dofs, inertia + laws["armature"]),
        **laws,
    )


def _masses(
    bodies: list[Body],
    parents: list[int],
    owners: list[int],
    offset: Numbers,
    orientation: Numbers,
    centre: Numbers,
) -> tuple[Numbers, Numbers, list[Numbers]]:
    """Return masses, centres of mass and spatial inertias, in working frames.

    Bodies that are welded together have given theirs to their owner.

    Offsets and orientations are those of `Tree`, and the centres those of the shapes.
    """
    mass, com = xp.array([body.mass for body in bodies]), centre
    if any(body.inertial is not None for body in bodies):
        com = centre + xp.array(
            [np.zeros(3) if body.inertial is None else body.inertial.centre for body in bodies]
        )
    tensors = [body.inertia for body in bodies]
    inertias = list(map(spatial_inertia, mass, com, tensors))
    if owners == list(range(len(bodies))):
        return mass, com, inertias
    places: list[tuple[Numbers, Numbers]] = []
    total: list[Any] = [0.0] * len(owners)
    moment: list[Any] = [np.zeros(3)] * len(owners)
    spatial: list[Any] = [np.zeros((6, 6))] * len(owners)
    for i, owner in enumerate(owners):
        if owner == i:
            places.append((np.zeros(3), np.eye(3)))
        else:
            place, turn = places[parents[i]]
            places.append((place + turn @ offset[i], turn @ orientation[..., i]))
        place, turn = places[i]
        within = place + turn @ com[i]
        if owner != i:
            inertias[i] = spatial_inertia(mass[i], within, turn @ tensors[i] @ turn.T)
        total[owner] = total[owner] + mass[i]
        moment[owner] = moment[owner] + mass[i] * within
        spatial[owner] = spatial[owner] + inertias[i]
    middles = [
        xp.where(m > 0, c / xp.where(m > 0, m, 1.0), own)
        for m, c, own in zip(total, moment, centre, strict=True)
    ]
    return xp.array(total), xp.stack(middles), spatial


def spatial_inertia(mass: Number, com: Numbers, inertia: Numbers) -> Float[Numbers, "6 6"]:
    """Return the spatial inertia ``(6, 6)`` about a frame's origin, angular part first.

    The rotational inertia ``(3, 3)`` is about the centre of mass, kg m^2.
    """
    x, y, z = com
    cross = xp.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return xp.block(
        [[inertia - mass * cross @ cross, mass * cross], [-mass * cross, mass * np.eye(3)]]
    )


def _effective_inertia(creature: Creature, order: list[int]) -> Float[Numbers, " d"]:
    """Return the effective inertia ``(d,)`` of each axis in the neutral pose, kg m^2.

    The two halves of the creature on either side of the joint turn against each other. The
    effective inertia is the product of their inertias about the axis, divided by the sum. Against
    the fixed world, it is the inertia of the half that moves. Masses, kg, count for a slide.
    """
    centres, rotations = neutral_pose(creature)
    names = [body.name for body in creature.bodies]
    jointed = [
        (i, joint) for i in order if (joint := creature.joint_of(creature.bodies[i])) is not None
    ]
    distal = []
    for i, joint in jointed:
        beyond = {names[i]}
        for j in order:
            other = creature.bodies[j].joint
            if other is not None and other.parent in beyond:
                beyond.add(names[j])
        distal += [[name in beyond for name in names]] * len(joint.dofs)
    moved = np.array([i for i, joint in jointed for _ in joint.dofs], int)
    dofs = [(joint, dof) for _, joint in jointed for dof in joint.dofs]
    axes = xp.array([dof.axis for _, dof in dofs], float).reshape(-1, 3)
    anchors = xp.array([joint.child_anchor for joint, _ in dofs], float)
    if any(joint.places for joint, _ in dofs):
        anchors = anchors + xp.array([dof.place for _, dof in dofs], float)
    directions = xp.einsum("dij,dj->di", rotations[moved], axes)
    places = centres[moved] + xp.einsum("dij,dj->di", rotations[moved], anchors.reshape(-1, 3))
    mass = xp.array([body.mass for body in creature.bodies])
    own = xp.stack([body.inertia for body in creature.bodies])
    spin = rotations @ own @ xp.swapaxes(rotations, 1, 2)
    if any(body.inertial is not None for body in creature.bodies):
        within = [np.zeros(3) if x.inertial is None else x.inertial.centre for x in creature.bodies]
        centres = centres + xp.einsum("bij,bj->bi", rotations, xp.array(within))
    lever = xp.cross(directions[:, None], centres[None] - places[:, None])
    about = xp.einsum("di,bij,dj->db", directions, spin, directions) + mass * (lever * lever).sum(
        -1
    )
    if dofs:
        rows = zip(dofs, about, strict=True)
        about = xp.stack(
            [
                dof.kind.rotation * turning + dof.kind.translation**2 * mass
                for (_, dof), turning in rows
            ]
        )
    beyond = np.array(distal, bool).reshape(len(moved), len(names))
    outer, inner = xp.where(beyond, about, 0.0).sum(1), xp.where(beyond, 0.0, about).sum(1)
    if creature.root_joint is None:
        return outer * inner / (outer + inner)
    against_world = beyond.all(1) | (not creature.root_joint.dofs)
    return xp.where(against_world, outer, outer * inner / (outer + inner))


def _groups(bodies: list, parents: list[int], dof_bodies: list[int]) -> tuple[Group, ...]:
    """Return groups of adjacent bodies of one depth whose limbs have the same build."""
    depth = [0]
    for parent in parents[1:]:
        depth.append(depth[parent] + 1)
    build: dict[int, tuple] = {}
    for i in reversed(range(1, len(bodies))):
        joint = bodies[i].joint
        limbs = sorted((build[j] for j in range(i + 1, len(bodies)) if parents[j] == i), key=repr)
        build[i] = joint.kind, tuple(dof.kind for dof in joint.dofs), *limbs
    groups: list[Group] = []
    for _, run in itertools.groupby(range(1, len(bodies)), lambda i: (depth[i], build[i])):
        members = list(run)
        start, last = members[0], members[-1]
        first_dof = bisect.bisect_left(dof_bodies, start)
        on = tuple(parents[i] for i in members)
        groups.append(_group_of(bodies[start].joint, slice(start, last + 1), first_dof, on))
    return tuple(groups)


def _group_of(joint: Joint, bodies: slice, first_dof: int, parents: tuple[int, ...]) -> Group:
    """Return bodies with joints like a given one as a group."""
    kinds = tuple(dof.kind for dof in joint.dofs)
    dofs = slice(first_dof, first_dof + len(kinds) * len(parents))
    return Group(bodies, dofs, len(kinds), parents, joint.kind, kinds)
