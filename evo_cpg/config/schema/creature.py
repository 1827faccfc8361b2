"""How a creature is written in YAML: lengths in m, angles in degrees, z up, facing +x."""

import re
from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, model_validator
from typing_extensions import override

from evo_cpg.config.schema.copies import SIDES, Copy, Entry, MirrorAxis, copies, copies_named
from evo_cpg.config.schema.section import Finite, NotNegative, Positive, Section, Share, Vector
from evo_cpg.config.schema.sensor import SensorConfig, VelocitySensorConfig
from evo_cpg.creature.creature import (
    Actuator,
    Body,
    Creature,
    DepthSensor,
    Joint,
    LightSensor,
    Material,
    topological_order,
)
from evo_cpg.creature.mesh import ConvexMesh, convex_mesh
from evo_cpg.creature.self_collision import SelfCollision
from evo_cpg.creature.shapes import Box, Capsule, Ellipsoid, Shape, Sphere
from evo_cpg.spatial.numerics import Number, Triple, as_vector, xp
from evo_cpg.spatial.rotation import euler_to_matrix

Size = tuple[Positive, Positive, Positive]
# Of a vertex; larger ones do not fit into arrays.
Index = Annotated[int, Field(ge=0, lt=2**31)]

# Without those of ASCII, of Latin-1, between lines, and of the direction of writing.
_PRINTED = r"[^\x00-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069]"


def _require_printed(name: str) -> str:
    """Check that a name is on one line, and nothing that a terminal obeys."""
    if not name:
        raise ValueError("'': must not be empty")
    if not re.fullmatch(f"{_PRINTED}+", name):
        raise ValueError(f"{name!r}: must be on one line, without control characters")
    return name


BodyName = Annotated[
    str,
    AfterValidator(_require_printed),
    Field(json_schema_extra={"pattern": f"^{_PRINTED}+$"}),
]

# The middle one of three axes must keep this far from where the three lie in one plane; of axes at
# right angles that is at 90 degrees, where the first and the last one coincide.
_SINGULARITY_MARGIN_DEG = 5.0

AxisName = Literal["x", "y", "z", "-x", "-y", "-z"]

_AXES = {
    "x": (1.0, 0.0, 0.0),
    "y": (0.0, 1.0, 0.0),
    "z": (0.0, 0.0, 1.0),
    "-x": (-1.0, 0.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "-z": (0.0, 0.0, -1.0),
}


class SolidConfig(Section):
    """A kind of shape."""

    @property
    def centre(self) -> np.ndarray:
        """Centre of mass ``(3,)`` in the body's frame, m; a mesh's alone is not at 0."""
        return np.zeros(3)


class BoxConfig(SolidConfig):
    """Cuboid.

    Attributes:
        type: ``box``.
        size: edges along x, y and z, m.
    """

    type: Literal["box"]
    size: Size

    def build(self) -> Shape:
        """The shape."""
        return Box(self.size)


class SphereConfig(SolidConfig):
    """Sphere.

    Attributes:
        type: ``sphere``.
        radius: from centre to surface, m.
    """

    type: Literal["sphere"]
    radius: Positive

    def build(self) -> Shape:
        """The shape."""
        return Sphere(self.radius)


class EllipsoidConfig(SolidConfig):
    """Ellipsoid.

    Attributes:
        type: ``ellipsoid``.
        radii: semi-axes along x, y and z, m.
    """

    type: Literal["ellipsoid"]
    radii: Size

    def build(self) -> Shape:
        """The shape."""
        return Ellipsoid(self.radii)


class CapsuleConfig(SolidConfig):
    """Cylinder along x with half-spherical ends.

    Attributes:
        type: ``capsule``.
        radius: of the cylinder and its ends, m.
        length: of the cylinder, without its ends, m.
    """

    type: Literal["capsule"]
    radius: Positive
    length: Positive

    def build(self) -> Shape:
        """The shape."""
        return Capsule(self.radius, self.length)


class MeshConfig(SolidConfig):
    """Convex polyhedron, in a frame of its own choice.

    Attributes:
        type: ``mesh``.
        vertices: places of the corners, m; with ``file`` they are read from there.
        faces: triangles of three vertices, counted from 0, counterclockwise seen from outside.
    """

    type: Literal["mesh"]
    vertices: tuple[Vector, ...]
    faces: tuple[tuple[Index, Index, Index], ...]

    @model_validator(mode="after")
    def _check(self) -> "MeshConfig":
        self._made()
        return self

    @property
    @override
    def centre(self) -> np.ndarray:
        return self._made()[1]

    def mirrored(self, axis: MirrorAxis) -> "MeshConfig":
        """Its image in the plane of its frame with this normal; other shapes are their own."""
        vertices = tuple(_reflected(vertex, axis) for vertex in self.vertices)
        faces = tuple((a, c, b) for a, b, c in self.faces)
        return self.model_copy(update={"vertices": vertices, "faces": faces})

    def build(self) -> Shape:
        """The shape, centred on its own frame."""
        return self._made()[0]

    def _made(self) -> tuple[ConvexMesh, np.ndarray]:
        faces = np.array(self.faces, int).reshape(-1, 3)
        return convex_mesh(np.array(self.vertices).reshape(-1, 3), faces)


ShapeConfig = Annotated[
    BoxConfig | SphereConfig | EllipsoidConfig | CapsuleConfig | MeshConfig,
    Field(discriminator="type"),
]


class MaterialConfig(Section):
    """What bodies are made of (Iwadate 2010, Table 1).

    Attributes:
        density: mass per volume, kg/m^3; that of water is 1000.
        restitution: share of the speed that is left after an impact.
        static_friction: coefficient of friction at rest.
        dynamic_friction: coefficient of friction while it slides.
    """

    density: Positive
    restitution: Share = 0.1
    static_friction: NotNegative = 0.5
    dynamic_friction: NotNegative = 0.4


class ActuatorConfig(Section):
    """Motor on each axis.

    Attributes:
        gain: torque per velocity error, N m s/rad.
        torque_limit: largest torque, N m; none if left out.
        stiffness: torque per angle error, N m/rad; 0 for a pure velocity servo.
    """

    gain: Positive
    torque_limit: Positive | None = None
    stiffness: NotNegative = 0.0


def _require_regular(directions: np.ndarray, lower: float, upper: float) -> None:
    """Check that three axes stay independent while the middle one turns.

    The volume that they span is a cosine of its angle.

    Args:
        directions: of the axes ``(3, 3)``.
        lower: limit of the middle one, degrees.
        upper: likewise.

    Raises:
        ValueError: they come into one plane, or nearly so.
    """
    first, middle, last = directions / np.linalg.norm(directions, axis=1)[:, None]
    across = np.cross(middle, last)
    cosine, sine = first @ across, first @ np.cross(middle, across)
    margin = _SINGULARITY_MARGIN_DEG
    if np.hypot(cosine, sine) < np.sin(np.radians(margin)):
        raise ValueError(
            f"axes: the middle one of three must be {margin:g} degrees at least from the others"
        )
    # The first angle above the lower limit at which they lie in one plane.
    plane = np.degrees(np.arctan2(sine, cosine)) + 90.0
    plane += 180.0 * np.ceil((lower - margin - plane) / 180.0 + 1e-9)
    if plane < upper + margin - 1e-6:
        near = plane - 180.0 if lower + upper < 2 * plane else plane
        raise ValueError(
            f"limits_deg: where the middle one of three axes turns by {plane:.4g} degrees, they "
            f"lie in one plane; allowed for it: {near + margin:.4g} to "
            f"{near + 180.0 - margin:.4g}, got {lower:g} to {upper:g}"
        )


class JointConfig(Section):
    """How a body hangs on its parent.

    Attributes:
        parent: name of the parent body.
        at: place of the joint in the parent's frame, m.
        child_at: place of the joint in this body's frame, m.
        axes: 1 to 3 axes that turn one after the other: x, y, z, -x, -y, -z or a vector.
        limits_deg: lower and upper limit, for all axes or one pair for each, degrees; the middle
            one of three axes at right angles turns by at most 85.
        rotation_deg: roll, pitch and yaw of this body against its parent at rest, degrees; about
            the parent's x, then y, then z.
        stiffness: passive spring, N m/rad.
        damping: passive damping, N m s/rad.
        armature: rotor inertia, kg m^2.
        actuator: the motors; a joint without is passive.
    """

    parent: str
    at: Vector
    child_at: Vector
    axes: Annotated[list[AxisName | Vector], Field(min_length=1, max_length=3)]
    limits_deg: tuple[Finite, Finite] | list[tuple[Finite, Finite]] = (-60.0, 60.0)
    rotation_deg: Vector = (0.0, 0.0, 0.0)
    stiffness: NotNegative = 0.0
    damping: NotNegative = 0.0
    armature: NotNegative = 0.0
    actuator: ActuatorConfig | None = None

    @model_validator(mode="after")
    def _check(self) -> "JointConfig":
        limits = self.limits
        if len(limits) != len(self.axes):
            raise ValueError(
                f"limits_deg gives {len(limits)} pairs for {len(self.axes)} axes; "
                "give one pair for all, or one for each"
            )
        for lower, upper in limits:
            if not lower < upper:
                raise ValueError(f"limits_deg: {lower:g} is not below {upper:g}")
        directions = np.array(self.directions)
        if np.linalg.matrix_rank(directions, tol=1e-6) < len(directions):
            raise ValueError("axes: they must be independent of each other and not zero")
        if len(self.axes) == 3:
            _require_regular(directions, *limits[1])
        return self

    @property
    def limits(self) -> list[tuple[float, float]]:
        """One pair of limits for each axis, degrees."""
        if isinstance(self.limits_deg, tuple):
            return [self.limits_deg] * len(self.axes)
        return self.limits_deg

    @property
    def directions(self) -> list[tuple[float, ...]]:
        """The axes as vectors, not normalised."""
        return [_AXES[axis] if isinstance(axis, str) else axis for axis in self.axes]

    def turned(self, angle_deg: float) -> "JointConfig":
        """The joint and all that hangs on it, turned about the parent's vertical axis."""
        if not angle_deg:
            return self
        roll, pitch, yaw = self.rotation_deg
        at = euler_to_matrix(0.0, 0.0, np.deg2rad(angle_deg)) @ xp.array(self.at)
        update = {"at": as_vector(at), "rotation_deg": (roll, pitch, yaw + angle_deg)}
        return self.model_copy(update=update)

    def mirrored(self, axis: MirrorAxis) -> "JointConfig":
        """The joint's image, parent and child being mirrored in planes of their frames.

        The same angle is then the mirrored pose, so limits stay as they are.
        """
        return self.model_copy(
            update={
                "at": _reflected(self.at, axis),
                "child_at": _reflected(self.child_at, axis),
                "axes": [_opposed(direction, axis) for direction in self.directions],
                "rotation_deg": _opposed(self.rotation_deg, axis),
            }
        )

    def build(self, parent: str, parent_centre: np.ndarray, centre: np.ndarray) -> Joint:
        """The joint, on the given parent, in frames moved to the bodies' centres of mass.

        Args:
            parent: its name.
            parent_centre: its centre of mass in the frame that ``at`` is given in, m.
            centre: that of the body itself, in the frame of ``child_at``, m.
        """
        rotation = euler_to_matrix(*xp.deg2rad(xp.array(self.rotation_deg)))
        limits = xp.deg2rad(xp.array(self.limits))
        actuator = self.actuator
        return Joint(
            parent=parent,
            parent_anchor=_moved(self.at, parent_centre),
            child_anchor=_moved(self.child_at, centre),
            axes=tuple(_unit(axis) for axis in self.directions),
            lower=tuple(limits[:, 0]),
            upper=tuple(limits[:, 1]),
            orientation=tuple(map(as_vector, rotation)),
            stiffness=self.stiffness,
            damping=self.damping,
            armature=self.armature,
            actuator=actuator
            and Actuator(
                actuator.gain,
                float("inf") if actuator.torque_limit is None else actuator.torque_limit,
                actuator.stiffness,
            ),
        )


class BodyConfig(Section):
    """A rigid body, or several that are alike but for their place.

    Attributes:
        name: unique; of bodies that stand for several it contains ``{i}``, ``{j}`` or ``{side}``
            (see "Limbs that are written once" in the guide).
        shape: centred on the body's frame; a mesh lies in it as in its file.
        material: name of one of the creature's materials.
        joint: how it hangs on its parent; the root has none.
        repeat: number of equal bodies in a row; the first hangs on the joint's ``parent``, every
            other one on the one before it. ``{i}`` counts them from 1.
        radial: number of such rows, turned about the parent's vertical axis by equal angles;
            ``{j}`` counts them from 1, counterclockwise from above.
        mirror: normal of the parent's plane in which all that is mirrored once more: ``y`` for
            limbs of which ``{side}`` is left, as written, and right.
        color: in pictures, ``"#rrggbb"``.
    """

    name: BodyName
    shape: ShapeConfig
    material: str
    joint: JointConfig | None = None
    repeat: Annotated[int, Field(ge=1, le=1000)] = 1
    radial: Annotated[int, Field(ge=1, le=1000)] = 1
    mirror: MirrorAxis | None = None
    color: Annotated[str, Field(pattern=r"^#[0-9a-fA-F]{6}$")] | None = None

    @model_validator(mode="after")
    def _check(self) -> "BodyConfig":
        problem = self.entry.problem()
        if problem:
            raise ValueError(problem)
        if self.mirror and self.joint:
            offset = self.joint.at["xyz".index(self.mirror)]
            if offset < 0:
                raise ValueError(
                    f"mirror: write the {SIDES[self.mirror][0]} one, whose joint.at has a positive "
                    f"{self.mirror}, got {offset:g}"
                )
        return self

    @property
    def entry(self) -> Entry:
        """What says which bodies it stands for."""
        parent = self.joint.parent if self.joint else None
        return Entry(self.name, parent, self.repeat, self.radial, self.mirror)


class LightSensorConfig(Section):
    """A directional eye (Iwadate 2010, eq. 1).

    Attributes:
        body: that carries it; a name with placeholders has one on each body that it stands for.
        position: in the frame of the body, m.
        axis: where it looks, in the frame of the body.
        field_of_view_deg: full opening angle, degrees.
    """

    body: str
    position: Vector = (0.0, 0.0, 0.0)
    axis: Vector = (1.0, 0.0, 0.0)
    field_of_view_deg: Annotated[float, Field(gt=0, le=360)] = 180.0

    @model_validator(mode="after")
    def _check(self) -> "LightSensorConfig":
        if not any(self.axis):
            raise ValueError("axis: must not be the zero vector")
        return self


class DepthSensorConfig(Section):
    """A depth gauge: reads 0 at the water's surface and above it, and 1 deep down.

    Attributes:
        body: that carries it; a name with placeholders has one on each body that it stands for.
        position: in the frame of the body, m.
        full_scale: depth from which down it reads 1, m.
    """

    body: str
    position: Vector = (0.0, 0.0, 0.0)
    full_scale: Positive = 1.0


class SelfCollisionConfig(Section):
    """What differs from the rule by which bodies of one creature are kept apart.

    By the rule all are but neighbours at a joint and those that overlap in the neutral pose. A name
    may have placeholders; ``all`` stands for every body.

    Attributes:
        exclude: pairs of names of bodies that may pass through each other.
        include: pairs of names of bodies that may not, although the rule would let them.
    """

    exclude: list[tuple[str, str]] = Field(default_factory=list)
    include: list[tuple[str, str]] = Field(default_factory=list)


class CreatureConfig(Section):
    """A creature; it may stand in a file of its own that several configs name.

    Attributes:
        name: what you call it.
        materials: what its bodies are made of, by a name of your own.
        bodies: in any order; exactly one, the root, has no joint.
        light_sensors: its eyes.
        pressure_sensors: ``all`` bodies, or a list of names.
        depth_sensors: its depth gauges.
        sensors: further ones, told apart by their ``type``.
        self_collision: whether its bodies are kept from passing through each other, or in what that
            differs from the rule; if left out, they are where there is ground.
    """

    name: str
    materials: dict[str, MaterialConfig]
    bodies: Annotated[list[BodyConfig], Field(min_length=1)]
    light_sensors: list[LightSensorConfig] = Field(default_factory=list)
    pressure_sensors: Literal["all"] | list[str] = "all"
    depth_sensors: list[DepthSensorConfig] = Field(default_factory=list)
    sensors: list[SensorConfig] = Field(default_factory=list)
    self_collision: bool | SelfCollisionConfig | None = None

    @model_validator(mode="after")
    def _require_few(self) -> "CreatureConfig":
        self.copies()
        return self

    def build(self) -> Creature:
        """The creature.

        Raises:
            CreatureError: its parts do not fit together.
        """
        everything = self.copies()
        centres = {copy.name: self._shape(copy).centre for copy in everything}
        bodies = []
        for copy in everything:
            entry = self.bodies[copy.entry]
            joint = None
            if entry.joint and copy.parent is not None:
                given = entry.joint.turned(copy.turn_deg)
                if copy.mirror:
                    given = given.mirrored(copy.mirror)
                parent_centre = centres.get(copy.parent, np.zeros(3))
                joint = given.build(copy.parent, parent_centre, centres[copy.name])
            material = Material(**dict(self.materials[entry.material]))
            shape = self._shape(copy).build()
            bodies.append(Body(copy.name, shape, material, joint, entry.color))
        named = self.pressure_sensors
        pressure = [copy.name for copy in everything] if named == "all" else named
        creature = Creature(
            name=self.name,
            bodies=tuple(bodies),
            light_sensors=tuple(
                LightSensor(
                    copy.name,
                    _moved(_image(eye.position, copy), centres[copy.name]),
                    _unit(_image(eye.axis, copy)),
                    xp.deg2rad(eye.field_of_view_deg),
                )
                for eye in self.light_sensors
                for copy in copies_named(eye.body, everything)
            ),
            pressure_sensors=tuple(
                copy.name for name in pressure for copy in copies_named(name, everything)
            ),
            depth_sensors=tuple(
                DepthSensor(
                    copy.name,
                    _moved(_image(gauge.position, copy), centres[copy.name]),
                    gauge.full_scale,
                )
                for gauge in self.depth_sensors
                for copy in copies_named(gauge.body, everything)
            ),
        )
        topological_order(creature)
        return creature

    def build_self_collision(self, on_ground: bool) -> SelfCollision | None:
        """Which bodies are kept apart; None for none."""
        given = self.self_collision
        if given is None or isinstance(given, bool):
            return SelfCollision() if (on_ground if given is None else given) else None
        everything = self.copies()

        def named(pairs: list[tuple[str, str]]) -> tuple[tuple[str, str], ...]:
            bodies = {
                name: everything if name == "all" else copies_named(name, everything)
                for pair in pairs
                for name in pair
            }
            return tuple(
                (a.name, b.name)
                for first, second in pairs
                for a in bodies[first]
                for b in bodies[second]
                if a.name != b.name
            )

        return SelfCollision(named(given.exclude), named(given.include))

    def copies(self) -> list[Copy]:
        """All bodies that the entries stand for."""
        return copies([entry.entry for entry in self.bodies])

    def entry_of(self, body: int) -> int:
        """Which entry of ``bodies`` stands for the body of this number."""
        return self.copies()[body].entry

    def references(self) -> list[tuple[tuple[str | int, ...], str, list[str]]]:
        """Every name that must exist: its key, the name, and the valid names."""
        everything = self.copies()
        bodies = [copy.name for copy in everything]
        found: list[tuple[tuple[str | int, ...], str, list[str]]] = []

        def refer(key: tuple[str | int, ...], name: str) -> None:
            # With placeholders it stands for bodies, and is not the name of one.
            if not copies_named(name, everything):
                found.append((key, name, bodies))

        for i, entry in enumerate(self.bodies):
            found.append((("bodies", i, "material"), entry.material, list(self.materials)))
            if entry.joint:
                refer(("bodies", i, "joint", "parent"), entry.joint.parent)
        for i, eye in enumerate(self.light_sensors):
            refer(("light_sensors", i, "body"), eye.body)
        for i, gauge in enumerate(self.depth_sensors):
            refer(("depth_sensors", i, "body"), gauge.body)
        for i, sensor in enumerate(self.sensors):
            if isinstance(sensor, VelocitySensorConfig):
                refer(("sensors", i, "body"), sensor.body)
        if self.pressure_sensors != "all":
            for i, name in enumerate(self.pressure_sensors):
                refer(("pressure_sensors", i), name)
        if isinstance(self.self_collision, SelfCollisionConfig):
            for which in ("exclude", "include"):
                for i, pair in enumerate(getattr(self.self_collision, which)):
                    for k, name in enumerate(pair):
                        if name != "all":
                            refer(("self_collision", which, i, k), name)
        return found

    def _shape(self, copy: Copy) -> ShapeConfig:
        shape = self.bodies[copy.entry].shape
        if copy.mirror and isinstance(shape, MeshConfig):
            return shape.mirrored(copy.mirror)
        return shape


def _unit(vector: Any) -> Triple:
    direction = xp.array(vector, float)
    return as_vector(direction / xp.linalg.norm(direction))


def _moved(place: Triple, origin: np.ndarray) -> Triple:
    """A place in a frame that is moved to ``origin``; as it is where the frame stays."""
    return as_vector(xp.array(place) - origin) if origin.any() else place


def _reflected(place: Triple, axis: MirrorAxis) -> Triple:
    """The image of a place in the plane with this normal."""
    x, y, z = (-value if name == axis else value for name, value in zip("xyz", place, strict=True))
    return x, y, z


def _opposed(turn: Sequence[Number], axis: MirrorAxis) -> Triple:
    """The image of a rotation: of its axis, or of its roll, pitch and yaw.

    What turns counterclockwise about a normal of the mirror still does in its image; about
    directions in the mirror it turns the other way.
    """
    x, y, z = (value if name == axis else -value for name, value in zip("xyz", turn, strict=True))
    return x, y, z


def _image(vector: Triple, copy: Copy) -> Triple:
    """A place or a direction in the frame of a body, as written or in its mirror image."""
    return _reflected(vector, copy.mirror) if copy.mirror else vector
