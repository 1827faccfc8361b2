"""Sections of a creature in YAML: lengths in m, angles in degrees, z up, facing +x."""

import itertools
from collections.abc import Callable, Iterator
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_serializer, model_validator

from evo_cpg.config.errors import Key, KeyProblem, nearest
from evo_cpg.config.schema.copies import SIDES, Copy, Entry, MirrorAxis, copies, copies_named
from evo_cpg.config.schema.frames import moved, reflected, unit
from evo_cpg.config.schema.joint import JointConfig
from evo_cpg.config.schema.names import PrintedName
from evo_cpg.config.schema.section import Fraction, NotNegative, Positive, Section, pattern
from evo_cpg.config.schema.sensor import DepthSensorConfig, LightSensorConfig, SensorConfig
from evo_cpg.config.schema.shape import ShapeConfig
from evo_cpg.config.schema.tendon import TendonConfig
from evo_cpg.config.schema.typical import SOLID
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

Color = Annotated[
    str, *pattern(r"^#[0-9a-fA-F]{6}$", "must be '#' and six hexadecimal digits, such as '#ff8800'")
]


class MaterialConfig(Section):
    """Material of bodies (Iwadate 2010, Table 1).

    Attributes:
        density: mass per volume (water: 1000), kg/m^3.
        restitution: fraction of the normal speed that remains after an impact.
        static_friction: coefficient of friction at rest.
        dynamic_friction: coefficient of friction while sliding.
    """

    density: Annotated[Positive, SOLID]
    restitution: Fraction = 0.1
    static_friction: NotNegative = 0.5
    dynamic_friction: NotNegative = 0.4


class BodyConfig(Section):
    """A rigid body, or several that differ only in their position.

    Attributes:
        name: unique name, which with copies contains ``{i}``, ``{j}`` or ``{side}``
            (see "Limbs that are written once" in the guide).
        shape: shape, centred on the body's frame (a mesh keeps the frame of its file).
        material: name of one of the creature's materials.
        joint: joint to the parent (the root has none).
        repeat: number of equal bodies in a row, counted from 1 by ``{i}``: the first hangs on
            the joint's ``parent``, every other body on its predecessor.
        radial: number of such rows, at equal angles about the parent's vertical axis, which
            ``{j}`` counts from 1, counterclockwise from above.
        mirror: normal of the parent's plane in which the bodies are mirrored: ``y`` for limbs
            whose ``{side}`` is left, as written, and right.
        color: color in pictures, ``"#rrggbb"``.
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
                    f"mirror: write the {SIDES[self.mirror][0]} body, whose joint.at has a "
                    f"positive {self.mirror}, got {offset:g}"
                )
        return self

    @property
    def entry(self) -> Entry:
        """The part of this entry that determines its copies."""
        parent = self.joint.parent if self.joint else None
        return Entry(self.name, parent, self.repeat, self.radial, self.mirror)


class SelfCollisionConfig(Section):
    """Exceptions to the rule that keeps the bodies of one creature apart.

    The rule keeps all pairs apart except neighbours at a joint and bodies that overlap in the
    neutral pose. A name may have placeholders. ``all`` stands for every body.

    Attributes:
        exclude: pairs of names of bodies that may pass through each other.
        include: pairs of names of bodies that are kept apart although the rule exempts them.
    """

    exclude: list[tuple[str, str]] = Field(default_factory=list)
    include: list[tuple[str, str]] = Field(default_factory=list)


class CreatureConfig(Section):
    """A creature, which can have a file of its own for several configurations.

    Attributes:
        name: name of the creature.
        materials: materials of its bodies, by a name of your own.
        bodies: bodies in any order, of which exactly one, the root, has no joint.
        light_sensors: eyes.
        pressure_sensors: ``all`` bodies, or a list of names.
        depth_sensors: depth gauges.
        sensors: further sensors, whose ``type`` selects the kind.
        tendons: fixed tendons.
        self_collision: ``true`` to keep its bodies from passing through each other, ``false``, or
            exceptions to the rule; if left out, bodies are kept apart if there is ground.
    """

    name: PrintedName
    materials: dict[str, MaterialConfig]
    bodies: Annotated[list[BodyConfig], Field(min_length=1)]
    light_sensors: list[LightSensorConfig] = Field(default_factory=list)
    pressure_sensors: Literal["all"] | list[str] = "all"
    depth_sensors: list[DepthSensorConfig] = Field(default_factory=list)
    sensors: list[SensorConfig] = Field(default_factory=list)
    tendons: list[TendonConfig] = Field(default_factory=list)
    self_collision: bool | SelfCollisionConfig | None = None

    @model_serializer(mode="wrap")
    def _leave_out(self, write: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        # Run folders of version 1.0 have no such key.
        return {name: x for name, x in write(self).items() if name != "tendons" or x}

    @model_validator(mode="after")
    def _require_few(self) -> "CreatureConfig":
        self.copies()
        return self

    def build(self) -> Creature:
        """Build the creature.

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
            tendons=tuple(each for given in self.tendons for each in given.build(everything)),
        )
        topological_order(creature)
        return creature

    def build_self_collision(self, on_ground: bool) -> SelfCollision | None:
        """Build the rule that keeps bodies apart, or None if no bodies are kept apart."""
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
        """Return all bodies that the entries stand for."""
        return copies([entry.entry for entry in self.bodies])

    def entry_of(self, body: int) -> int:
        """Return the index in ``bodies`` of the entry of a body, given the body's index."""
        return self.copies()[body].entry

    def entry_of_tendon(self, tendon: int) -> int:
        """Return the index in ``tendons`` of the entry of a tendon, given the tendon's index."""
        everything = self.copies()
        counts = [len(given.build(everything)) for given in self.tendons]
        return int(np.repeat(np.arange(len(counts)), counts)[tendon])

    def require_names(self) -> None:
        """Check that the names of bodies are unique, and that every name used exists.

        Raises:
            KeyProblem: two bodies have one name, or a name does not exist.
        """
        everything = self.copies()
        owners: dict[str, int] = {}
        for copy in everything:
            first = owners.setdefault(copy.name, copy.entry)
            if first != copy.entry:
                raise KeyProblem(
                    ("bodies", copy.entry, "name"),
                    f"two bodies are called {copy.name!r}, the other one in "
                    f"creature.bodies.{first}. Every body needs a unique name",
                )
        for key, name in self._references():
            valid = list(self.materials) if key[-1] == "material" else list(owners)
            # A name with placeholders stands for bodies, and is in no list of names.
            if name in valid or (key[-1] != "material" and copies_named(name, everything)):
                continue
            problem = f"{name!r} does not exist: {nearest(name, valid)}"
            if "*" in name:
                problem = f"{problem}. A name here may contain placeholders such as {{i}}, but no *"
            raise KeyProblem(key, problem)
        for i, tendon in enumerate(self.tendons):
            if not tendon.build(everything):
                raise KeyProblem(
                    ("tendons", i, "name"),
                    f"no joint of {tendon.name!r} gives values for its placeholders. A joint's "
                    "name needs all placeholders of the tendon's name",
                )

    def _references(self) -> Iterator[tuple[Key, str]]:
        """Yield the names of bodies and materials that the creature refers to, with their keys."""
        for i, entry in enumerate(self.bodies):
            yield ("bodies", i, "material"), entry.material
            if entry.joint:
                yield ("bodies", i, "joint", "parent"), entry.joint.parent
        for kind in ("light_sensors", "depth_sensors", "sensors"):
            for i, sensor in enumerate(getattr(self, kind)):
                for key in sensor.body_keys:
                    yield (kind, i, key), getattr(sensor, key)
        if self.pressure_sensors != "all":
            for i, name in enumerate(self.pressure_sensors):
                yield ("pressure_sensors", i), name
        if isinstance(self.self_collision, SelfCollisionConfig):
            for which, pairs in self.self_collision:
                for i, k in itertools.product(range(len(pairs)), range(2)):
                    if pairs[i][k] != "all":
                        yield ("self_collision", which, i, k), pairs[i][k]

    def _shape(self, copy: Copy) -> ShapeConfig:
        shape = self.bodies[copy.entry].shape
        return shape.mirrored(copy.mirror) if copy.mirror else shape


def _image(vector: Triple, copy: Copy) -> Triple:
    """Return a vector in body axes for a copy of the body: reflected if the copy is mirrored."""
    return reflected(vector, copy.mirror) if copy.mirror else vector
