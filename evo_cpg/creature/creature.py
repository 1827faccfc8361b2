"""A creature as a person describes it: named rigid bodies, joints, materials and sensors.

This is plain data in the user's terms; `evo_cpg.creature.tree` turns it into the arrays that
the physics works on. Frames: every body has a frame at its geometric centre; z is up and the
animal faces along +x in the neutral pose.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from evo_cpg.creature.shapes import Shape
from evo_cpg.spatial.numerics import Number, Numbers, Triple, xp


class CreatureError(ValueError):
    """A creature that cannot be built.

    Attributes:
        where: path of the offending value inside the creature, such as ``("bodies", 3, "joint")``.
    """

    def __init__(self, message: str, where: Sequence[str | int] = ()):
        super().__init__(message)
        self.where = tuple(where)


@dataclasses.dataclass(frozen=True)
class Material:
    """What a body is made of (Iwadate 2010, Table 1).

    Attributes:
        density: kg/m^3.
        restitution: coefficient of restitution, 0 to 1.
        static_friction: coefficient that holds a resting contact.
        dynamic_friction: coefficient that brakes a sliding contact.
    """

    density: Number
    restitution: Number = 0.1
    static_friction: Number = 0.5
    dynamic_friction: Number = 0.4


@dataclasses.dataclass(frozen=True)
class Actuator:
    """Motor on each axis of a joint: ``gain (rate* - rate) + stiffness (angle* - angle)``.

    Without stiffness it is the velocity servo of Iwadate 2010, with stiffness and a wanted rate of
    zero the dashpot of Fukui 2003: a damped spring whose rest angle the controller sets.

    Attributes:
        gain: torque per velocity error, N m s/rad.
        torque_limit: largest torque on one axis, N m; infinite where there is no limit. Under a
            larger load the joint gives way.
        stiffness: torque per angle error, N m/rad.
    """

    gain: Number
    torque_limit: Number = float("inf")
    stiffness: Number = 0.0


class DegreeOfFreedom(NamedTuple):
    """One degree of freedom of a joint: a turn about an axis through the joint's place.

    Attributes:
        axis: unit vector in the child's neutral frame.
        lower: limit, rad.
        upper: limit, rad.
        stiffness: passive spring, N m/rad.
        damping: passive damping, N m s/rad.
        armature: rotor inertia, kg m^2.
        servo_gain: of the motor, N m s/rad; 0 without one.
        servo_stiffness: of the motor, N m/rad; 0 without one.
        torque_limit: of the motor, N m; 0 without one.
    """

    axis: Triple
    lower: Number
    upper: Number
    stiffness: Number
    damping: Number
    armature: Number
    servo_gain: Number
    servo_stiffness: Number
    torque_limit: Number


@dataclasses.dataclass(frozen=True)
class Joint:
    """A joint of 1 to 3 rotational axes between a body and its parent.

    The axes turn one after the other, each in the frame left by those before it (x, then y,
    then z in the usual case), so the middle one of three must keep clear of 90 degrees.

    Attributes:
        parent: name of the parent body.
        parent_anchor: the joint's place in the parent's frame, m.
        child_anchor: the joint's place in the child's frame, m.
        axes: unit vectors in the child's neutral frame, in order.
        lower: lower limit of each axis, rad.
        upper: upper limit of each axis, rad.
        orientation: child frame to parent frame in the neutral pose, ``(3, 3)``.
        stiffness: passive spring towards the neutral pose, N m/rad.
        damping: passive damping, N m s/rad.
        armature: rotor inertia added on each axis, kg m^2.
        actuator: the motor on each axis, or None for a passive joint.
    """

    parent: str
    parent_anchor: Triple
    child_anchor: Triple
    axes: tuple[Triple, ...]
    lower: tuple[Number, ...]
    upper: tuple[Number, ...]
    orientation: tuple[Triple, ...] = (
        (1.0, 0.0, 0.0),
        (0.0, 1.0, 0.0),
        (0.0, 0.0, 1.0),
    )
    stiffness: Number = 0.0
    damping: Number = 0.0
    armature: Number = 0.0
    actuator: Actuator | None = None

    @property
    def dofs(self) -> tuple[DegreeOfFreedom, ...]:
        """Its degrees of freedom, in the order in which they turn."""
        motor = self.actuator
        driven = (motor.gain, motor.stiffness, motor.torque_limit) if motor else (0.0, 0.0, 0.0)
        same = self.stiffness, self.damping, self.armature, *driven
        limits = zip(self.axes, self.lower, self.upper, strict=True)
        return tuple(DegreeOfFreedom(axis, low, high, *same) for axis, low, high in limits)


@dataclasses.dataclass(frozen=True)
class Body:
    """A rigid body; the one without a joint is the root of the tree.

    Attributes:
        name: unique in the creature.
        shape: centred on the body's frame.
        material: density and contact properties.
        joint: how it hangs on its parent; None for the root.
        color: of the body in pictures, as ``#rrggbb``; None picks one.
    """

    name: str
    shape: Shape
    material: Material
    joint: Joint | None = None
    color: str | None = None

    @property
    def mass(self) -> Number:
        """Mass, kg."""
        return self.shape.volume * self.material.density


@dataclasses.dataclass(frozen=True)
class LightSensor:
    """A directional eye (Iwadate 2010, eq. 1).

    Attributes:
        body: name of the body that carries it.
        position: in the body's frame, m.
        axis: unit vector it looks along, in the body's frame.
        field_of_view: full opening angle, rad; the response reaches 0 at half of it.
    """

    body: str
    position: Triple
    axis: Triple
    field_of_view: Number


@dataclasses.dataclass(frozen=True)
class DepthSensor:
    """A gauge of the water's hydrostatic pressure, in depth of water.

    Attributes:
        body: name of the body that carries it.
        position: in the body's frame, m.
        full_scale: depth at which it reads 1, and below which it does not change, m.
    """

    body: str
    position: Triple
    full_scale: Number


@dataclasses.dataclass(frozen=True)
class Creature:
    """A tree of rigid bodies with sensors.

    Attributes:
        name: what the user calls it.
        bodies: in any order; exactly one has no joint.
        light_sensors: its eyes.
        pressure_sensors: names of the bodies that feel solid contact.
        depth_sensors: its depth gauges.
    """

    name: str
    bodies: tuple[Body, ...]
    light_sensors: tuple[LightSensor, ...] = ()
    pressure_sensors: tuple[str, ...] = ()
    depth_sensors: tuple[DepthSensor, ...] = ()

    def __repr__(self) -> str:
        joints = [body.joint for body in self.bodies if body.joint is not None]
        axes = sum(len(joint.dofs) for joint in joints)
        return (
            f"Creature({self.name!r}, bodies={len(self.bodies)}, joints={len(joints)}, "
            f"axes={axes}, eyes={len(self.light_sensors)})"
        )

    def body_index(self, name: str) -> int:
        """Position of a body in ``bodies``."""
        return [body.name for body in self.bodies].index(name)

    def bodies_of(self, names: Sequence[str]) -> list[Body]:
        """Return the bodies with some names, such as a tree's, in their order."""
        return [self.bodies[self.body_index(name)] for name in names]

    @property
    def mass(self) -> Number:
        """Mass of the whole creature, kg."""
        return sum(body.mass for body in self.bodies)


def neutral_pose(creature: Creature) -> tuple[Numbers, Numbers]:
    """Where the bodies are with every joint at zero and the root at the origin.

    Returns:
        Centres ``(bodies, 3)`` in m and rotation matrices ``(bodies, 3, 3)``, in the order of
        ``creature.bodies``.
    """
    frames: dict[str, tuple[Numbers, Numbers]] = {}
    for body in (creature.bodies[i] for i in topological_order(creature)):
        if body.joint is None:
            frames[body.name] = np.zeros(3), np.eye(3)
            continue
        parent_centre, parent_rotation = frames[body.joint.parent]
        rotation = parent_rotation @ xp.array(body.joint.orientation)
        anchor = parent_centre + parent_rotation @ xp.array(body.joint.parent_anchor)
        frames[body.name] = anchor - rotation @ xp.array(body.joint.child_anchor), rotation
    centres, rotations = zip(*(frames[body.name] for body in creature.bodies), strict=True)
    return xp.array(centres), xp.array(rotations)


def lowest_height(creature: Creature, pose: tuple[Numbers, Numbers] | None = None) -> Number:
    """Height of the creature's lowest point, m.

    In the neutral pose it is that above the root's centre, and never positive.

    Args:
        creature: the animal.
        pose: its bodies' centres and rotations, as `neutral_pose` has them; None for that pose.
    """
    return lowest_along(creature, xp.array([0.0, 0.0, 1.0]), pose)


def lowest_along(
    creature: Creature, up: Numbers, pose: tuple[Numbers, Numbers] | None = None
) -> Number:
    """The same along any direction.

    Args:
        creature: the animal.
        up: unit vector ``(3,)`` in the root's axes.
        pose: as above.
    """
    centres, rotations = neutral_pose(creature) if pose is None else pose
    heights = [
        up @ centre + (up @ rotation) @ body.shape.support(-rotation.T @ up)
        for body, centre, rotation in zip(creature.bodies, centres, rotations, strict=True)
    ]
    return xp.min(xp.array(heights))


def length_of(creature: Creature) -> Number:
    """The largest extent of an animal in its neutral pose, m."""
    axes = xp.eye(3)
    extents = [-lowest_along(creature, -axis) - lowest_along(creature, axis) for axis in axes]
    return xp.max(xp.array(extents))


def topological_order(creature: Creature) -> list[int]:
    """Indices of the bodies such that parents come before children, level by level.

    Bodies of one level are ordered by their number of joint axes, then as described, so that
    bodies which the physics can treat together lie side by side.

    Raises:
        CreatureError: no body, no root or several, a name used twice, a joint to a body that
            does not exist, or bodies joined in a ring.
    """
    bodies = creature.bodies
    if not bodies:
        raise CreatureError("a creature needs at least one body", ("bodies",))
    names = [body.name for body in bodies]
    for i, name in enumerate(names):
        if name in names[:i]:
            raise CreatureError(f"two bodies are called {name!r}", ("bodies", i, "name"))
    roots = [i for i, body in enumerate(bodies) if body.joint is None]
    if len(roots) > 1:
        raise CreatureError(
            f"bodies {names[roots[0]]!r} and {names[roots[1]]!r} both have no joint; "
            "exactly one body (the root) may stand without one",
            ("bodies", roots[1], "joint"),
        )
    for i, body in enumerate(bodies):
        if body.joint is not None and body.joint.parent not in names:
            raise CreatureError(
                f"body {body.name!r} is joined to {body.joint.parent!r}, which does not exist; "
                f"bodies are {', '.join(names)}",
                ("bodies", i, "joint", "parent"),
            )
    depth = {names[i]: 0 for i in roots}
    while len(depth) < len(bodies):
        reached = {
            body.name: depth[body.joint.parent] + 1
            for body in bodies
            if body.name not in depth and body.joint and body.joint.parent in depth
        }
        if not reached:
            stuck = [name for name in names if name not in depth]
            raise CreatureError(
                f"the joints of {', '.join(stuck)} form a ring: no chain of parents leads "
                "from them to a root body",
                ("bodies", names.index(stuck[0]), "joint", "parent"),
            )
        depth |= reached
    axes = [len(body.joint.dofs) if body.joint else 0 for body in bodies]
    return sorted(range(len(bodies)), key=lambda i: (depth[names[i]], axes[i], i))
