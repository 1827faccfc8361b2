"""Sections of a creature in YAML: lengths in m, angles in degrees, z up, facing +x."""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from evo_cpg.creature.algebra.numerics import Number, Numbers, Triple, as_vector, xp
from evo_cpg.creature.algebra.rotation import euler_to_matrix
from evo_cpg.creature.creature import (
    NO_MASS,
    WORLD,
    Body,
    Creature,
    DepthSensor,
    Inertial,
    Joint,
    LightSensor,
    Material,
    require_masses,
)
from evo_cpg.creature.self_collision import SelfCollision
from evo_cpg.creature.shapes import NoShape, Shape
from evo_cpg.io.errors import Key, KeyProblem, nearest
from evo_cpg.io.schema.copies import (
    SIDES,
    Copy,
    Entry,
    MirrorAxis,
    copies,
    copies_named,
    moved,
    opposed,
    reflected,
    unit,
)
from evo_cpg.io.schema.joint import JointConfig
from evo_cpg.io.schema.section import (
    Direction,
    Finite,
    Fraction,
    NotNegative,
    Positive,
    PrintedName,
    Section,
    Vector,
    pattern,
    section_of,
)
from evo_cpg.io.schema.sensor import (
    DepthSensorConfig,
    LightSensorConfig,
    SensesConfig,
    SensorConfig,
)
from evo_cpg.io.schema.shape import LoftConfig, ShapeConfig
from evo_cpg.io.schema.tendon import TendonConfig

Color = Annotated[
    str, *pattern(r"^#[0-9a-fA-F]{6}$", "must be '#' and six hexadecimal digits, such as '#ff8800'")
]


MaterialConfig = section_of(
    Material,
    "MaterialConfig",
    __name__,
    density=Positive,
    restitution=Fraction,
    static_friction=NotNegative,
    dynamic_friction=NotNegative,
)


class PartConfig(Section):
    """A further shape of a body, rigidly joined to it.

    Attributes:
        shape: shape.
        at: position of the shape's centre in the body's frame, m (for a mesh, of its frame).
        rotation_deg: roll, pitch and yaw of the shape in the body's frame, degrees.
        material: name of a material, by default the body's.
        color: color in pictures, ``"#rrggbb"``, by default the body's.
    """

    shape: ShapeConfig
    at: Vector
    rotation_deg: Annotated[Vector, Direction()] = (0.0, 0.0, 0.0)
    material: str | None = None
    color: Color | None = None


# Products of inertia in the order xy, xz, yz follow the moments.
_Inertia = tuple[Finite, Finite, Finite, Finite, Finite, Finite]

# Rounding of numbers in files, up to which the largest moment of inertia may exceed the sum of the
# others, as a fraction of it.
_ROUNDING = 1e-6


class BodyConfig(Section):
    """A rigid body, or several that differ only in their position.

    Attributes:
        name: unique name, which with copies contains ``{i}``, ``{j}`` or ``{side}``
            (see "Limbs that are written once" in the guide).
        shape: shape, centred on the body's frame (a mesh keeps the frame of its file), or null for
            a body that nothing touches, wets or draws.
        material: name of one of the creature's materials.
        joint: joint to the parent. The root has none, or one with the parent ``world``, which is
            fixed: without axes the root does not move.
        repeat: number of equal bodies in a row, counted from 1 by ``{i}``: the first hangs on
            the joint's ``parent``, every other body on its predecessor.
        radial: number of such rows, at equal angles about the parent's vertical axis, which
            ``{j}`` counts from 1, counterclockwise from above.
        mirror: normal of the parent's plane in which the bodies are mirrored: ``y`` for limbs
            whose ``{side}`` is left, as written, and right.
        color: color in pictures, ``"#rrggbb"``.
        parts: further shapes, rigidly joined to this one. Each has its own mass and its own water.
        mass: mass of the body with all its parts, kg, in place of the materials' densities.
        centre_of_mass: centre of this mass in the body's frame, m; by default the shape's centre.
        inertia: moments of inertia xx, yy, zz and products xy, xz, yz of this mass about its
            centre, axes of the body, kg m^2; by default those of the shapes at one density.
    """

    name: PrintedName
    shape: ShapeConfig | None
    material: str
    joint: JointConfig | None = None
    repeat: Annotated[int, Field(ge=1, le=1000)] = 1
    radial: Annotated[int, Field(ge=1, le=1000)] = 1
    mirror: MirrorAxis | None = None
    color: Color | None = None
    parts: Annotated[list[PartConfig], Field(max_length=1000)] = Field(default_factory=list)
    mass: NotNegative | None = None
    centre_of_mass: Vector | None = None
    inertia: _Inertia | None = None

    @model_validator(mode="after")
    def _check(self) -> "BodyConfig":
        none = "is missing, and a body without a shape (shape: null) has no other"
        if problem := self.entry.problem():
            raise ValueError(problem)
        for name, needed in (("inertia", "mass"), ("centre_of_mass", "inertia")):
            if getattr(self, name) is not None and getattr(self, needed) is None:
                raise ValueError(f"{name}: needs {needed}, which is missing")
        if self.mass is None:
            if self.shape is None:
                raise ValueError(f"mass: {none}")
        elif self.mass == 0:
            if self.shape is not None or self.inertia is not None:
                raise ValueError(
                    "mass: must be positive, except for a body without a shape and inertia"
                )
        elif self.inertia is None:
            if self.shape is None and not self.parts:
                raise ValueError(f"inertia: {none}")
        else:
            moments = np.linalg.eigvalsh(np.asarray(symmetric(self.inertia)))
            words = ", ".join(f"{moment:.4g}" for moment in moments)
            if moments[0] <= 0:
                raise ValueError(
                    f"inertia: its principal moments must be positive, got {words} kg m^2"
                )
            if moments[2] > (1 + _ROUNDING) * (moments[0] + moments[1]):
                raise ValueError(
                    "inertia: no body has such moments: the largest principal moment must not "
                    f"exceed the sum of the others, got {words} kg m^2"
                )
        if self.mirror and self.joint:
            offset = self.joint.at["xyz".index(self.mirror)]
            if offset < 0:
                raise ValueError(
                    f"mirror: write the {SIDES[self.mirror][0]} body, whose joint.at has a "
                    f"positive {self.mirror}, got {offset:g}"
                )
        return self

    @property
    def shapes(self) -> list[ShapeConfig]:
        """All shapes of the body."""
        own = [] if self.shape is None else [self.shape]
        return own + [part.shape for part in self.parts]

    @property
    def hangs(self) -> bool:
        """Whether the body is a root that hangs on the fixed world."""
        return self.joint is not None and self.joint.parent == WORLD

    @property
    def entry(self) -> Entry:
        """The part of this entry that determines its copies."""
        parent = self.joint.parent if self.joint and not self.hangs else None
        return Entry(self.name, parent, self.repeat, self.radial, self.mirror)


class SelfCollisionConfig(Section):
    """Exceptions to the rule that keeps the bodies of one creature apart.

    The rule keeps all pairs apart except neighbours at a joint and bodies that overlap in the
    neutral pose. A name may have placeholders. ``all`` stands for every body.

    Attributes:
        exclude: pairs of names of bodies that may pass through each other.
        include: pairs of names of bodies that are kept apart although the rule exempts them.
        looped: ``true`` to compute the contacts of few pairs as those of many, in a loop, which is
            slower. Exported body plans do so, because plans evolve that way.
    """

    exclude: list[tuple[str, str]] = Field(default_factory=list)
    include: list[tuple[str, str]] = Field(default_factory=list)
    looped: bool = False


class CreatureConfig(Section):
    """A creature, which can have a file of its own for several configurations.

    Attributes:
        name: name of the creature.
        materials: materials of its bodies, by a name of your own.
        bodies: bodies in any order, of which exactly one, the root, has no joint or the parent
            ``world``.
        light_sensors: eyes.
        pressure_sensors: ``all`` bodies, or a list of names.
        depth_sensors: depth gauges.
        sensors: further sensors, whose ``type`` selects the kind.
        senses: noise, delay and rate of its senses.
        tendons: fixed tendons.
        self_collision: ``true`` to keep its bodies from passing through each other, ``false``, or
            exceptions to the rule; if left out, bodies are kept apart if there is ground.
    """

    name: PrintedName
    materials: dict[str, MaterialConfig]  # pyright: ignore[reportInvalidTypeForm]
    bodies: Annotated[list[BodyConfig], Field(min_length=1)]
    light_sensors: list[LightSensorConfig] = Field(default_factory=list)
    pressure_sensors: Literal["all"] | list[str] = "all"
    depth_sensors: list[DepthSensorConfig] = Field(default_factory=list)
    sensors: list[SensorConfig] = Field(default_factory=list)
    senses: SensesConfig = SensesConfig()
    tendons: list[TendonConfig] = Field(default_factory=list)
    self_collision: bool | SelfCollisionConfig | None = None

    @model_validator(mode="after")
    def _require_few(self) -> "CreatureConfig":
        self.copies()
        if not any(body.shapes for body in self.bodies):
            raise ValueError("bodies: no body has a shape. Give one of them a shape")
        return self

    def build(self) -> Creature:
        """Build the creature.

        Raises:
            CreatureError: its parts do not fit together.
        """
        everything = self.copies()
        centres = {copy.name: np.zeros(3) for copy in everything}
        for copy in everything:
            if shape := self.bodies[copy.entry].shape:
                shape = shape.mirrored(copy.mirror) if copy.mirror else shape
                centres[copy.name] = shape.build()[0][1]
        bodies, root_joint = [], None
        for copy in everything:
            entry = self.bodies[copy.entry]
            joint = None
            if entry.joint and entry.hangs:
                root_joint = entry.joint.build(WORLD, np.zeros(3), centres[copy.name])
            elif entry.joint and copy.parent is not None:
                given = entry.joint.turned(copy.turn_deg)
                if copy.mirror:
                    given = given.mirrored(copy.mirror)
                parent_centre = centres.get(copy.parent, np.zeros(3))
                joint = given.build(copy.parent, parent_centre, centres[copy.name])
            bodies += self._bodies_of(copy, joint, centres[copy.name])
        named = self.pressure_sensors
        pressure = [copy.name for copy in everything] if named == "all" else named
        creature = Creature(
            name=self.name,
            bodies=tuple(bodies),
            light_sensors=tuple(
                LightSensor(
                    copy.name,
                    moved(reflected(eye.position, copy.mirror), centres[copy.name]),
                    unit(reflected(eye.axis, copy.mirror)),
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
                    moved(reflected(gauge.position, copy.mirror), centres[copy.name]),
                    gauge.full_scale,
                )
                for gauge in self.depth_sensors
                for copy in copies_named(gauge.body, everything)
            ),
            root_joint=root_joint,
            tendons=tuple(each for given in self.tendons for each in given.build(everything)),
        )
        require_masses(creature)
        return creature

    def build_self_collision(self, on_ground: bool) -> SelfCollision | None:
        """Build the rule that keeps bodies apart, or None if no bodies are kept apart."""
        given = self.self_collision
        if given is None or isinstance(given, bool):
            return SelfCollision() if (on_ground if given is None else given) else None
        everything = self.copies()

        def named(pairs: list[tuple[str, str]]) -> tuple[tuple[str, str], ...]:
            bodies = {
                name: [
                    own
                    for copy in (everything if name == "all" else copies_named(name, everything))
                    for own in self.names_of(copy)
                ]
                for pair in pairs
                for name in pair
            }
            return tuple(
                (a, b)
                for first, second in pairs
                for a in bodies[first]
                for b in bodies[second]
                if a != b
            )

        return SelfCollision(named(given.exclude), named(given.include), looped=given.looped)

    def names_of(self, copy: Copy) -> list[str]:
        """Return the names of a body and of its parts."""
        entry = self.bodies[copy.entry]
        lofts = (shape for shape in entry.shapes if isinstance(shape, LoftConfig))
        further = sum(len(shape.build()) - 1 for shape in lofts)
        parts = range(2, len(entry.parts) + further + 2)
        return [copy.name, *(f"{copy.name}/{i}" for i in parts)]

    def copies(self) -> list[Copy]:
        """Return all bodies that the entries stand for."""
        return copies([entry.entry for entry in self.bodies])

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
        # Names of bodies and materials that the creature refers to, with their keys.
        references: list[tuple[Key, str]] = []
        for i, entry in enumerate(self.bodies):
            references.append((("bodies", i, "material"), entry.material))
            for k, part in enumerate(entry.parts):
                if part.material is not None:
                    references.append((("bodies", i, "parts", k, "material"), part.material))
            if entry.joint and not entry.hangs:
                references.append((("bodies", i, "joint", "parent"), entry.joint.parent))
        for kind in ("light_sensors", "depth_sensors", "sensors"):
            for i, sensor in enumerate(getattr(self, kind)):
                references += [((kind, i, key), getattr(sensor, key)) for key in sensor.body_keys]
        if self.pressure_sensors != "all":
            references += [
                (("pressure_sensors", i), x) for i, x in enumerate(self.pressure_sensors)
            ]
        if isinstance(self.self_collision, SelfCollisionConfig):
            for which in ("exclude", "include"):
                pairs = getattr(self.self_collision, which)
                for i, k in itertools.product(range(len(pairs)), range(2)):
                    if pairs[i][k] != "all":
                        references.append((("self_collision", which, i, k), pairs[i][k]))
        for key, name in references:
            valid = list(self.materials) if key[-1] == "material" else list(owners)
            # A name with placeholders stands for bodies, and is in no list of names.
            if name in valid or (key[-1] != "material" and copies_named(name, everything)):
                continue
            if key[-1] == "parent":
                valid = [*valid, WORLD]
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

    def _bodies_of(self, copy: Copy, joint: Joint | None, centre: np.ndarray) -> list[Body]:
        """Return a body, then its further parts, each welded to it.

        ``centre`` is the centre of its shape in the frame of the configuration, m.
        """
        entry = self.bodies[copy.entry]
        shapes = [x.mirrored(copy.mirror) if copy.mirror else x for x in entry.shapes]
        solids = [shape.build() for shape in shapes]
        density, inertial = None, None
        if entry.mass is not None and entry.inertia is None and solids:
            pieces = [*(solid[0] for solid in solids), *(x for solid in solids for x in solid[1:])]
            density = entry.mass / sum(shape.volume for shape, _ in pieces)
        elif entry.mass is not None:
            inertial = _inertial(entry, copy, centre)

        def material(name: str) -> Material:
            made = self.materials[name].build()
            return made if density is None else dataclasses.replace(made, density=density)

        own = solids.pop(0) if entry.shape else ((NoShape(), centre),)
        first = NO_MASS if entry.shape is None and inertial is None else inertial
        found = [Body(copy.name, own[0][0], material(entry.material), joint, entry.color, first)]
        zero = (0.0, 0.0, 0.0)
        welded: list[tuple[tuple[Shape, np.ndarray], Triple, Triple, PartConfig | BodyConfig]] = [
            (piece, zero, zero, entry) for piece in own[1:]
        ]
        for part, solid in zip(entry.parts, solids, strict=True):
            at, turn_deg = part.at, part.rotation_deg
            if copy.mirror:
                at, turn_deg = reflected(at, copy.mirror), opposed(turn_deg, copy.mirror)
            welded += [(piece, at, turn_deg, part) for piece in solid]
        for (shape, shape_centre), at, turn_deg, given in welded:
            rotation = euler_to_matrix(*xp.deg2rad(xp.array(turn_deg)))
            weld = Joint(
                parent=copy.name,
                parent_anchor=moved(at, centre),
                child_anchor=moved(zero, shape_centre),
                axes=(),
                lower=(),
                upper=(),
                orientation=tuple(map(as_vector, rotation)),
            )
            found.append(
                Body(
                    f"{copy.name}/{len(found) + 1}",
                    shape,
                    material(given.material or entry.material),
                    weld,
                    given.color or entry.color,
                    None if inertial is None else NO_MASS,
                    copy.name,
                )
            )
        return found


def _inertial(entry: BodyConfig, copy: Copy, centre: np.ndarray) -> Inertial:
    """Return the mass and inertia in numbers of a copy, in the frame of its shape.

    ``centre`` is the centre of its shape in the frame of the configuration, m.
    """
    if entry.inertia is None:
        return Inertial(entry.mass, np.zeros(3), np.zeros((3, 3)))
    place = as_vector(centre)
    if entry.centre_of_mass:
        place = reflected(entry.centre_of_mass, copy.mirror)
    tensor = symmetric(entry.inertia)
    if copy.mirror:
        image = xp.diag(xp.array(reflected((1.0, 1.0, 1.0), copy.mirror)))
        tensor = image @ tensor @ image
    return Inertial(entry.mass, xp.array(moved(place, centre)), tensor)


def symmetric(inertia: Sequence[Number]) -> Numbers:
    """Return a symmetric matrix of its elements xx, yy, zz, xy, xz, yz."""
    a, b, c, d, e, f = inertia
    return xp.array([[a, d, e], [d, b, f], [e, f, c]])
