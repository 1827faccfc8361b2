"""A creature in the user's terms: named rigid bodies, joints, materials and sensors.

The classes are plain data. `evo_cpg.creature.tree` turns them into the arrays of the physics. Every
body has a frame at its geometric centre. In the neutral pose z is up and the animal faces along +x.
"""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from evo_cpg.creature.algebra.decisions import Condition, decided
from evo_cpg.creature.algebra.numerics import Number, Numbers, Triple, as_vector, is_traced, xp
from evo_cpg.creature.axis_kinds import SPANNING, AxisKind, Turn
from evo_cpg.creature.shapes import Shape


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
    """Material of bodies (Iwadate 2010, Table 1).

    Attributes:
        density: mass per volume (water: 1000), kg/m^3.
        restitution: fraction of the normal speed that remains after an impact.
        static_friction: coefficient of friction at rest.
        dynamic_friction: coefficient of friction while sliding.
    """

    density: Number
    restitution: Number = 0.1
    static_friction: Number = 0.5
    dynamic_friction: Number = 0.4


@dataclasses.dataclass(frozen=True)
class Actuator:
    """A motor on each axis: ``gain (rate* - rate) + stiffness (angle* - angle)``.

    A motor without stiffness is the velocity servo of Iwadate 2010. A motor with stiffness and a
    commanded rate of zero is the dashpot of Fukui 2003: a damped spring whose rest angle the
    controller sets.

    Attributes:
        gain: torque per velocity error, N m s/rad; 0 for a spring alone.
        torque_limit: largest torque, N m, unlimited if left out.
        stiffness: torque per angle error, N m/rad; 0 for a pure velocity servo.
    """

    gain: Number
    torque_limit: Number = float("inf")
    stiffness: Number = 0.0


@dataclasses.dataclass(frozen=True)
class TorqueMotor:
    """A motor on each axis whose torque the controller commands.

    Attributes:
        gear: torque per unit of a controller's output, N m; negative to reverse it. The controller
            ``brain_cpg`` commands ``gear (ML - MR)``, with ML and MR of muscles. Controllers that
            command torques ignore it.
        torque_limit: largest torque, N m, unlimited if left out.
    """

    gear: Number = 1.0
    torque_limit: Number = float("inf")


@dataclasses.dataclass(frozen=True)
class Muscle:
    """Two antagonistic muscles about each axis, after Ekeberg and Hill.

    Strength is area times stress times arm. The bend sets the stiffness in proportion to the
    strength, so equal numbers fit animals of any size.

    Attributes:
        area: cross-section of the muscle on each side, m^2.
        arm: lever arm of the muscles about the axis, m.
        fibre_length: length of the fibres at the neutral angle, m.
        stress: specific tension, Pa; 140e3 to 300e3 in fish, frogs and salamanders.
        bend_deg: angle that one fully active side holds without load and without Hill's law,
            degrees. It sets the stiffness.
        tone: stiffness of relaxed muscles over the stiffness that one active side adds.
        damping_time: damping over stiffness with one side fully active, s.
        max_speed: largest speed of shortening, fibre lengths per second.
        curvature: k of Hill's curve of force over speed; 0.15 to 0.35 in animals.
        hill: whether force depends on length and speed; false for Ekeberg's muscles.
    """

    area: Number
    arm: Number
    fibre_length: Number
    stress: Number = 2e5
    bend_deg: Number = 45.0
    tone: Number = 1.0
    damping_time: Number = 0.02
    max_speed: Number = 5.0
    curvature: Number = 0.25
    hill: bool = True

    @property
    def numbers(self) -> dict[str, Number]:
        """Numbers about one axis, with the names and units of `evo_cpg.creature.laws.Muscles`."""
        bend = xp.deg2rad(self.bend_deg)
        strength = self.area * self.stress * self.arm
        stiffening = strength / (bend * (1.0 + self.tone))
        strain = self.arm / self.fibre_length
        return {
            "strength": strength,
            "stiffening": stiffening,
            "rest_stiffness": stiffening * self.tone,
            "damping": self.damping_time * strength / bend,
            "strain": strain,
            "slowness": strain / self.max_speed,
            "curvature": self.curvature,
            "power": self.area * self.stress * self.max_speed * self.fibre_length,
        }


# Name of the fixed world, the parent of a root that hangs on it.
WORLD = "world"

# A motor or muscles about an axis.
Motor = Actuator | TorqueMotor | Muscle

# Angle that stands for no limit of a joint, rad. It is finite, because derivatives by the numbers
# of a body multiply it.
NO_LIMIT = 1e6


class DegreeOfFreedom(NamedTuple):
    """One degree of freedom of a joint. Units of a slide are m, N and kg for rad, N m and kg m^2.

    Attributes:
        axis: unit vector in the child's neutral frame.
        lower: lower limit, rad, or ``-NO_LIMIT``.
        upper: upper limit, rad, or ``NO_LIMIT``.
        stiffness: stiffness of the passive spring, N m/rad.
        rest: angle at which that spring is relaxed, rad.
        damping: passive damping, N m s/rad.
        armature: rotor inertia, kg m^2.
        friction_loss: torque of dry friction, N m.
        actuator: servo, torque motor or muscles, or None for a passive axis.
        kind: motion along the coordinate, with the units of the coordinate and its force.
        place: position of the axis relative to the joint, in the child's frame, m.
    """

    axis: Triple
    lower: Number
    upper: Number
    stiffness: Number
    rest: Number
    damping: Number
    armature: Number
    friction_loss: Number
    actuator: Motor | None
    kind: AxisKind = Turn()
    place: Triple = (0.0, 0.0, 0.0)


# Kinds of joints, each a class in `evo_cpg.physics.tree.joint_kinds`.
JointKind = Literal["weld", "turns", "some turns", "ball", "chain"]

# Smallest distance (rad) of the middle one of three angles from the angle at which the axes lie in
# one plane, and rounding errors of angles.
_PLANE_MARGIN, _ROUNDING = np.radians(5.0), 1e-9


@dataclasses.dataclass(frozen=True)
class Joint:
    """A joint of up to 6 axes between a body and its parent, a ball joint, or a weld without any.

    The axes move the body in order. Each axis is fixed in the frame that the axes before it have
    moved. A ball has three axes at right angles, which stand for the components of one rotation.
    Its ``upper`` limits are equal, and limit the angle of that rotation.

    Attributes:
        parent: name of the parent body.
        parent_anchor: position of the joint in the parent's frame, m.
        child_anchor: position of the joint in the child's frame, m.
        axes: unit vectors in the child's neutral frame, in order.
        lower: lower limit of each axis.
        upper: upper limit of each axis.
        orientation: rotation from child frame to parent frame in the neutral pose, ``(3, 3)``.
        kinds: kind of each axis, or None if all of them turn.
        places: position of each axis in the child's frame, m, or None for ``child_anchor``. None
            for the whole puts all axes there.

    The other attributes are those of `DegreeOfFreedom`: one value for all axes, or a tuple with one
    for each.
    """

    parent: str
    parent_anchor: Triple
    child_anchor: Triple
    axes: tuple[Triple, ...]
    lower: tuple[Number, ...]
    upper: tuple[Number, ...]
    orientation: tuple[Triple, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    stiffness: Number | tuple[Number, ...] = 0.0
    damping: Number | tuple[Number, ...] = 0.0
    armature: Number | tuple[Number, ...] = 0.0
    actuator: Motor | tuple[Motor | None, ...] | None = None
    rest: Number | tuple[Number, ...] = 0.0
    friction_loss: Number | tuple[Number, ...] = 0.0
    kinds: tuple[AxisKind, ...] | None = None
    places: tuple[Triple | None, ...] | None = None

    @property
    def dofs(self) -> tuple[DegreeOfFreedom, ...]:
        """Degrees of freedom, in the order in which they move the body."""
        given = self.stiffness, self.rest, self.damping, self.armature, self.friction_loss
        columns = [self.lower, self.upper]
        for x in (*given, self.actuator):
            columns.append(x if isinstance(x, tuple) else (x,) * len(self.axes))
        kinds = self.kinds or (Turn(),) * len(self.axes)
        places = self.places or (None,) * len(self.axes)
        shifts = [
            as_vector(xp.array(place) - xp.array(self.child_anchor)) if place else (0.0, 0.0, 0.0)
            for place in places
        ]
        rows = zip(self.axes, *columns, kinds, shifts, strict=True)
        return tuple(itertools.starmap(DegreeOfFreedom, rows))

    @property
    def kind(self) -> JointKind:
        """Kind of the joint: "turns" are rotations at one place that stay independent."""
        if not self.axes:
            return "weld"
        kinds = self.kinds or ()
        if kinds and all(kind.at_once for kind in kinds):
            return "ball"
        carries = any(kind.translation for kind in kinds) or any(self.places or ())
        if carries or len(self.axes) > SPANNING:
            return "chain"
        if len(self.axes) < SPANNING:
            return "turns"
        ends = self.lower[1], self.upper[1]
        spans = decided(lambda: stay_independent(self.axes, *ends))
        return "turns" if spans else "chain"


def stay_independent(axes: Sequence[Triple], lower: Number, upper: Number) -> Condition:
    """Return whether three axes stay clear of a common plane while the middle axis turns.

    The volume that the axes span is a cosine of the angle of the middle axis.

    The limits are those of the middle axis, rad.
    """
    first, middle, last = xp.array(axes, float)
    across = xp.cross(middle, last)
    cosine, sine = first @ across, first @ xp.cross(middle, across)
    wide = cosine * cosine + sine * sine >= np.sin(_PLANE_MARGIN) ** 2
    # First angle of the middle axis, from the margin below its lower limit on, at which the three
    # axes lie in one plane.
    plane = xp.arctan2(sine, cosine) + np.pi / 2
    plane = plane + np.pi * xp.ceil((lower - _PLANE_MARGIN - plane) / np.pi + _ROUNDING)
    return wide & (plane >= upper + _PLANE_MARGIN - _ROUNDING)


class Inertial(NamedTuple):
    """Mass and inertia of a body in numbers.

    Attributes:
        mass: mass, kg.
        centre: centre of mass in the body's frame, m.
        inertia: rotational inertia ``(3, 3)`` about the centre of mass, axes of the body, kg m^2.
    """

    mass: Number
    centre: Numbers
    inertia: Numbers


# Inertial of a part whose mass is in the numbers of its body.
NO_MASS = Inertial(0.0, np.zeros(3), np.zeros((3, 3)))


@dataclasses.dataclass(frozen=True)
class Body:
    """A rigid body, or a part of one. The one without a joint to another body is the root.

    Attributes:
        name: name of the body, unique in the creature.
        shape: shape, centred on the body's frame.
        material: density and contact properties.
        joint: joint to the parent, or None for the root (`Creature.root_joint`).
        color: color of the body in pictures, as ``#rrggbb``, or None for a default color.
        inertial: mass and inertia in numbers, or None for those of a shape of uniform density.
        whole: name of the body of which this body is a further part, welded to it, or None.
    """

    name: str
    shape: Shape
    material: Material
    joint: Joint | None = None
    color: str | None = None
    inertial: Inertial | None = None
    whole: str | None = None

    @property
    def mass(self) -> Number:
        """Mass, kg."""
        if self.inertial is not None:
            return self.inertial.mass
        return self.shape.volume * self.material.density

    @property
    def inertia(self) -> Numbers:
        """Rotational inertia ``(3, 3)`` about the centre of mass, axes of the body, kg m^2."""
        if self.inertial is not None:
            return self.inertial.inertia
        return self.shape.inertia(self.mass)


@dataclasses.dataclass(frozen=True)
class LightSensor:
    """A directional eye (Iwadate 2010, eq. 1).

    Attributes:
        body: name of the body with the sensor.
        position: position in the body's frame, m.
        axis: unit vector of the viewing direction, in the body's frame.
        field_of_view: full opening angle, rad. The response reaches 0 at half of this angle.
    """

    body: str
    position: Triple
    axis: Triple
    field_of_view: Number


@dataclasses.dataclass(frozen=True)
class DepthSensor:
    """A gauge of the water's hydrostatic pressure, as depth of water.

    Attributes:
        body: name of the body with the sensor.
        position: position in the body's frame, m.
        full_scale: depth at which the sensor reads 1, as at all greater depths, m.
    """

    body: str
    position: Triple
    full_scale: Number


@dataclasses.dataclass(frozen=True)
class Tendon:
    """A fixed tendon: force laws on its length, a weighted sum of joint angles.

    The length is 0 in the neutral pose. With pure numbers as coefficients it is in rad, and the
    force is a torque, N m. With lever arms (m) as coefficients it is in m, and the force is in N.
    The torque on a joint is the force times the joint's coefficient.

    Attributes:
        name: name of the tendon, unique among the tendons.
        joints: name of each degree of freedom that it spans, with the coefficient of its angle.
        stiffness: stiffness of the spring, force per length.
        rest: shortest and longest length at which the spring is slack.
        damping: damping, force per rate of length.
        armature: inertia that the rate of length moves, kg m^2 or kg.
        friction_loss: force of dry friction.
        lower: lower limit of the length, or ``-NO_LIMIT``.
        upper: upper limit of the length, or ``NO_LIMIT``.
        actuator: servo or torque motor that pulls, or None.
    """

    name: str
    joints: tuple[tuple[str, Number], ...]
    stiffness: Number = 0.0
    rest: tuple[Number, Number] = (0.0, 0.0)
    damping: Number = 0.0
    armature: Number = 0.0
    friction_loss: Number = 0.0
    lower: Number = -NO_LIMIT
    upper: Number = NO_LIMIT
    actuator: Actuator | TorqueMotor | None = None


@dataclasses.dataclass(frozen=True)
class Creature:
    """A tree of rigid bodies with sensors.

    Attributes:
        name: name of the creature.
        bodies: bodies in any order, exactly one without a joint.
        light_sensors: eyes.
        pressure_sensors: names of the bodies that sense solid contact.
        depth_sensors: depth gauges.
        root_joint: joint between the fixed world and the root, or None for a free root. Without
            axes it holds the root still.
        tendons: fixed tendons.
    """

    name: str
    bodies: tuple[Body, ...]
    light_sensors: tuple[LightSensor, ...] = ()
    pressure_sensors: tuple[str, ...] = ()
    depth_sensors: tuple[DepthSensor, ...] = ()
    root_joint: Joint | None = None
    tendons: tuple[Tendon, ...] = ()

    def __repr__(self) -> str:
        joints = [joint for body in self.bodies if (joint := self.joint_of(body)) is not None]
        axes = sum(len(joint.dofs) for joint in joints)
        return (
            f"Creature({self.name!r}, bodies={len(self.bodies)}, joints={len(joints)}, "
            f"axes={axes}, eyes={len(self.light_sensors)})"
        )

    def body_index(self, name: str) -> int:
        """Return the index of a body in ``bodies``."""
        return [body.name for body in self.bodies].index(name)

    @property
    def root_index(self) -> int:
        """Index in ``bodies`` of the body without a joint."""
        return next(i for i, body in enumerate(self.bodies) if body.joint is None)

    def joint_of(self, body: Body) -> Joint | None:
        """Return the joint of a body. The joint of the root is `root_joint`."""
        return self.root_joint if body.joint is None else body.joint

    def bodies_of(self, names: Sequence[str]) -> list[Body]:
        """Return the bodies with some names, in the order of the names."""
        return [self.bodies[self.body_index(name)] for name in names]

    @property
    def mass(self) -> Number:
        """Mass of the whole creature, kg."""
        return sum(body.mass for body in self.bodies)


def rigid_owners(bodies: Sequence[Body]) -> list[int]:
    """Return the index of the first body of the rigid group of each body, often its own.

    Each body comes after its parent.
    """
    owners: dict[str, int] = {}
    for i, body in enumerate(bodies):
        welded = body.joint is not None and not body.joint.axes
        owners[body.name] = owners[body.joint.parent] if welded and body.joint else i
    return list(owners.values())


def require_masses(creature: Creature) -> None:
    """Check that every body that moves has a mass, or is welded to one that has.

    Raises:
        CreatureError: a body that moves has no mass.
    """
    bodies = [creature.bodies[i] for i in topological_order(creature)]
    masses: dict[str, Number] = {}
    for body, owner in zip(bodies, rigid_owners(bodies), strict=True):
        name = bodies[owner].name
        masses[name] = masses.get(name, 0.0) + body.mass
    for i, body in enumerate(creature.bodies):
        joint = creature.joint_of(body)
        moves = joint is None or bool(joint.dofs)
        if moves and not is_traced(masses[body.name]) and not masses[body.name] > 0:
            raise CreatureError(
                f"body {body.name!r} moves, but neither it nor a body welded to it has a mass",
                ("bodies", i, "mass"),
            )


def neutral_pose(creature: Creature) -> tuple[Numbers, Numbers]:
    """Return the pose of all bodies with every joint at zero and the root at the origin.

    A root that hangs on the world is where its joint holds it.

    Returns:
        Centres ``(bodies, 3)`` in m and rotation matrices ``(bodies, 3, 3)``, in the order of
        ``creature.bodies``.
    """
    frames: dict[str, tuple[Numbers, Numbers]] = {WORLD: (np.zeros(3), np.eye(3))}
    for body in (creature.bodies[i] for i in topological_order(creature)):
        joint = creature.joint_of(body)
        if joint is None:
            frames[body.name] = np.zeros(3), np.eye(3)
            continue
        parent_centre, parent_rotation = frames[joint.parent]
        rotation = parent_rotation @ xp.array(joint.orientation)
        anchor = parent_centre + parent_rotation @ xp.array(joint.parent_anchor)
        frames[body.name] = anchor - rotation @ xp.array(joint.child_anchor), rotation
    centres, rotations = zip(*(frames[body.name] for body in creature.bodies), strict=True)
    return xp.array(centres), xp.array(rotations)


def joint_places(
    creature: Creature, pose: tuple[Numbers, Numbers]
) -> dict[tuple[int, int], Numbers]:
    """Return the position of the joint between every parent and child, m, by their indices.

    A body and its further parts have no joint between them.
    """
    centres, rotations = pose
    return {
        (creature.body_index(body.joint.parent), i): centres[i]
        + rotations[i] @ xp.array(body.joint.child_anchor)
        for i, body in enumerate(creature.bodies)
        if body.joint is not None and body.whole is None
    }


def lowest_height(
    creature: Creature,
    pose: tuple[Numbers, Numbers] | None = None,
    up: Triple | Numbers = (0.0, 0.0, 1.0),
) -> Number:
    """Return the height of the creature's lowest point along a direction, m.

    The pose is that of `neutral_pose`, by default the neutral one. The height in the neutral pose
    is relative to the root's centre, and never positive.
    """
    centres, rotations = neutral_pose(creature) if pose is None else pose
    up = xp.array(up)
    heights = [
        up @ centre + (up @ rotation) @ body.shape.support(-rotation.T @ up)
        for body, centre, rotation in zip(creature.bodies, centres, rotations, strict=True)
        if body.shape.exists
    ]
    return xp.min(xp.array(heights))


def length_of(creature: Creature) -> Number:
    """Return the largest extent of a creature in its neutral pose, m."""
    axes = xp.eye(3)
    extents = [
        -lowest_height(creature, up=-axis) - lowest_height(creature, up=axis) for axis in axes
    ]
    return xp.max(xp.array(extents))


def topological_order(creature: Creature) -> list[int]:
    """Return the indices of the bodies by their depth in the tree, parents before children.

    Bodies of one depth are ordered by their number of joint axes, then by their index. Most bodies
    that the physics can treat together are therefore adjacent.

    Raises:
        CreatureError: the creature has no body, no root or several, a name used twice, a joint to a
            body that does not exist, or bodies joined in a ring.
    """
    bodies = creature.bodies
    if not bodies:
        raise CreatureError("a creature needs at least one body", ("bodies",))
    names = [body.name for body in bodies]
    for i, name in enumerate(names):
        if name == WORLD:
            raise CreatureError(
                f"{WORLD!r} is the name of the fixed world. Rename the body", ("bodies", i, "name")
            )
        if name in names[:i]:
            raise CreatureError(f"two bodies are called {name!r}", ("bodies", i, "name"))
    roots = [i for i, body in enumerate(bodies) if body.joint is None]
    if len(roots) > 1:
        raise CreatureError(
            f"bodies {names[roots[0]]!r} and {names[roots[1]]!r} are both roots. Allowed: one body "
            f"without a joint, or with a joint whose parent is {WORLD!r}",
            ("bodies", roots[1], "joint"),
        )
    for i, body in enumerate(bodies):
        if body.joint is not None and body.joint.parent not in names:
            raise CreatureError(
                f"body {body.name!r} is joined to {body.joint.parent!r}, which does not exist. "
                f"Allowed: {', '.join(names)}",
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
