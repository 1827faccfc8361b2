"""How a creature is written in YAML: lengths in m, angles in degrees, z up, facing +x."""

import re
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from evo_cpg.config.schema.copies import SIDES, Copy, Entry, MirrorAxis, copies, copies_named
from evo_cpg.config.schema.frames import moved, reflected, unit
from evo_cpg.config.schema.joint import JointConfig
from evo_cpg.config.schema.plausible import SOLID, VIEW
from evo_cpg.config.schema.section import NotNegative, Positive, Section, Share, Vector, pattern
from evo_cpg.config.schema.sensor import SensorConfig
from evo_cpg.config.schema.shape import ShapeConfig
from evo_cpg.creature.creature import (
    Body,
    Creature,
    DepthSensor,
    LightSensor,
    Material,
    topological_order,
)
from evo_cpg.creature.self_collision import SelfCollision
from evo_cpg.spatial.numerics import Triple, xp

# Without those of ASCII, of Latin-1, between lines, and of the direction of writing.
_PRINTED = r"[^\x00-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069]"


def _require_printed(name: str) -> str:
    """Check that a name is on one line, and nothing that a terminal obeys."""
    if not name:
        raise ValueError("'': must not be empty")
    if not re.fullmatch(f"{_PRINTED}+", name):
        raise ValueError(f"{name!r}: must be on one line, without control characters")
    return name


PrintedName = Annotated[
    str,
    AfterValidator(_require_printed),
    Field(json_schema_extra={"pattern": f"^{_PRINTED}+$"}),
]


Color = Annotated[
    str, *pattern(r"^#[0-9a-fA-F]{6}$", "must be '#' and six hexadecimal digits, such as '#ff8800'")
]


class MaterialConfig(Section):
    """What bodies are made of (Iwadate 2010, Table 1).

    Attributes:
        density: mass per volume, kg/m^3; that of water is 1000.
        restitution: share of the speed that is left after an impact.
        static_friction: coefficient of friction at rest.
        dynamic_friction: coefficient of friction while it slides.
    """

    density: Annotated[Positive, SOLID]
    restitution: Share = 0.1
    static_friction: NotNegative = 0.5
    dynamic_friction: NotNegative = 0.4


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

    name: PrintedName
    shape: ShapeConfig
    material: str
    joint: JointConfig | None = None
    repeat: Annotated[int, Field(ge=1, le=1000)] = 1
    radial: Annotated[int, Field(ge=1, le=1000)] = 1
    mirror: MirrorAxis | None = None
    color: Color | None = None

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
    field_of_view_deg: Annotated[float, Field(gt=0, le=360), VIEW] = 180.0

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

    name: PrintedName
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
                    moved(_image(eye.position, copy), centres[copy.name]),
                    unit(_image(eye.axis, copy)),
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
                    moved(_image(gauge.position, copy), centres[copy.name]),
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
            for key in sensor.body_keys:
                refer(("sensors", i, key), getattr(sensor, key))
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

    def named_twice(self) -> tuple[tuple[str | int, ...], str] | None:
        """Return the key of a name that another body has as well, and the problem; or None."""
        owners: dict[str, int] = {}
        for copy in self.copies():
            first = owners.setdefault(copy.name, copy.entry)
            if first != copy.entry:
                problem = (
                    f"two bodies are called {copy.name!r}, the other one in "
                    f"creature.bodies.{first}; every body needs a name of its own"
                )
                return ("bodies", copy.entry, "name"), problem
        return None

    def _shape(self, copy: Copy) -> ShapeConfig:
        shape = self.bodies[copy.entry].shape
        return shape.mirrored(copy.mirror) if copy.mirror else shape


def _image(vector: Triple, copy: Copy) -> Triple:
    """A place or a direction in the frame of a body, as written or in its mirror image."""
    return reflected(vector, copy.mirror) if copy.mirror else vector
