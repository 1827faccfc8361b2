"""Sections of gravity, water and ground."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from pydantic import Field, field_validator, model_validator

from evo_cpg.creature.algebra.numerics import xp
from evo_cpg.creature.creature import Creature
from evo_cpg.creature.shapes import Surface
from evo_cpg.creature.slender import LEAST_BODIES
from evo_cpg.creature.surface import PointLayout, outer_surfaces, random_surfaces
from evo_cpg.creature.tree import Tree
from evo_cpg.io.errors import KeyProblem
from evo_cpg.io.schema.ground import GroundConfig
from evo_cpg.io.schema.section import (
    GRAVITY,
    LIQUID,
    VISCOSITY,
    CustomConfig,
    Direction,
    Finite,
    NotNegative,
    Positive,
    Section,
    Vector,
)
from evo_cpg.physics.water.added_mass import AddedMass, added_inertia
from evo_cpg.physics.water.fluid import Drag, DragLaw, make_patches
from evo_cpg.physics.water.force_law import ForceLaw
from evo_cpg.physics.water.lift import make_plate_lift
from evo_cpg.physics.water.reactive_thrust import reactive_water
from evo_cpg.physics.water.viscous_bodies import make_viscous_drag
from evo_cpg.physics.water.water import Current, Oscillation, Street, Vortex, Water

# Resolution of the dense surface points among which random points are drawn.
_DENSE_RESOLUTION = 24

# Rounding error of decimals, relative to the largest element of a gradient.
_TRACE_TOLERANCE = 1e-6


class VortexConfig(Section):
    """A vortex about a vertical axis.

    Attributes:
        centre: x and y of the axis, m.
        circulation: circulation far from the axis, counterclockwise seen from above, m^2/s.
        core: distance from the axis at which the water is fastest, m.
        velocity: velocity of the axis along x and y, m/s, or ``null`` for an axis at rest.
    """

    centre: tuple[Finite, Finite] = (0.0, 0.0)
    circulation: Finite
    core: Positive
    velocity: tuple[Finite, Finite] | None = None

    def build(self) -> Vortex:
        """Build the vortex."""
        return self.into(Vortex, drift=self.velocity)


class OscillationConfig(Section):
    """A uniform current that swings: velocity x sin(2 pi t / period + phase).

    Attributes:
        velocity: largest velocity, m/s.
        period: period, s.
        phase_deg: phase at the start of the trial, degrees.
    """

    velocity: Vector
    period: Positive
    phase_deg: Annotated[Finite, Direction()] = 0.0

    def build(self) -> Oscillation:
        """Build the current."""
        return Oscillation(self.velocity, self.period, xp.deg2rad(self.phase_deg))


class StreetConfig(Section):
    """A vortex street: two endless rows of vortices about vertical axes, staggered, which move.

    Attributes:
        spacing: distance of neighbours in a row, m.
        width: distance of the two rows, m.
        circulation: circulation of each vortex in the left row, counterclockwise seen from above,
            m^2/s. The right row has the opposite one. If it is positive, water flows along the
            heading between the rows, as behind a fish. It is negative behind a cylinder in a
            current along the heading.
        core: distance from an axis at which the water of a single vortex is fastest, m.
        speed: speed of the vortices along the heading, m/s.
        heading_deg: direction of the rows from the x axis, degrees.
        place: x and y of a point midway between the rows, m.
        phase: distance from ``place`` to a vortex of the left row at the start, in spacings.
    """

    spacing: Positive
    width: NotNegative
    circulation: Finite
    core: Positive
    speed: Finite
    heading_deg: Annotated[Finite, Direction()] = 0.0
    place: tuple[Finite, Finite] = (0.0, 0.0)
    phase: Finite = 0.0

    def build(self) -> Street:
        """Build the street."""
        return self.into(Street, heading=xp.deg2rad(self.heading_deg))


class WaterConfig(Section):
    """Water around the whole creature, or up to a surface.

    Attributes:
        density: mass per volume, kg/m^3.
        viscosity: dynamic viscosity, Pa s, or ``null`` for drag with constant coefficients. With a
            viscosity, drag follows the Reynolds number and the shape of the bodies.
        form_drag: coefficient C_d for the normal velocity at every surface point. With a viscosity
            it is a factor of the measured coefficients.
        skin_drag: coefficient C_f for the tangential velocity at every surface point. It must be
            absent or ``null`` with a viscosity.
        surface: height of the water's surface, m, or ``null`` for water everywhere.
        added_mass: whether bodies accelerate the water around them, as in ideal fluid.
        reactive_thrust: whether slender chains of at least three bodies push off from the water
            that leaves their tails, as in Lighthill's theory; it includes their added mass.
        lift: whether thin bodies, such as fins, have lift. Needs ``viscosity``.
        current: velocity of the water, m/s; with a gradient, at the origin.
        current_gradient: derivatives of the current's components (rows) along x, y and z, 1/s.
        vortices: vortices that are added to the current.
        oscillations: currents that swing, which are added.
        street: vortex street that is added, or ``null`` for none.
        law: drag law: ``normal`` splits the drag into form and skin drag, ``isotropic`` is exactly
            eq. 8 of Iwadate 2010. It must be absent or ``null`` with a viscosity.
        sheltered: whether surfaces that other bodies cover at rest have no drag.
        points: ``quadrature`` distributes the points evenly, ``random`` draws them once, as in the
            paper, from ``points_seed``.
        form_resolution: resolution of points for form drag: its square on each face of a box.
        skin_resolution: resolution of points for skin friction: its square on each face of a box.
        random_points: number of random points on each body.
        points_seed: seed of random points.
    """

    density: Annotated[Positive, LIQUID] = 1000.0
    viscosity: Annotated[Positive | None, VISCOSITY] = None
    form_drag: NotNegative = 1.0
    skin_drag: NotNegative | None = 0.02
    surface: Finite | None = None
    added_mass: bool = False
    reactive_thrust: bool = False
    lift: bool = False
    current: Vector = (0.0, 0.0, 0.0)
    current_gradient: tuple[Vector, Vector, Vector] | None = None
    vortices: tuple[VortexConfig, ...] = ()
    oscillations: tuple[OscillationConfig, ...] = ()
    street: StreetConfig | None = None
    law: DragLaw | None = "normal"
    sheltered: bool = True
    points: Literal["quadrature", "random"] = "quadrature"
    form_resolution: Annotated[int, Field(ge=1, le=32)] = 2
    skin_resolution: Annotated[int, Field(ge=1, le=32)] = 1
    random_points: Annotated[int, Field(ge=1, le=10_000)] = 32
    points_seed: Annotated[int, Field(ge=0)] = 0

    def build(self) -> Water:
        """Build the water, without its forces."""
        street = () if self.street is None else (self.street,)
        others = (stream.build() for stream in (*self.vortices, *self.oscillations, *street))
        current = Current(self.current, self.current_gradient)
        return Water(self.density, self.surface, (current, *others))

    def build_forces(self, creature: Creature, tree: Tree, layout: PointLayout) -> list[ForceLaw]:
        """Build the forces of the water: drag, added mass, reactive thrust and lift.

        Raises:
            KeyProblem: there is no slender chain for reactive thrust.
        """

        def points(resolution: int) -> dict[str, Surface]:
            surfaces = outer_surfaces(creature, resolution, self.sheltered, layout)
            if self.points == "random":
                rng = np.random.default_rng(self.points_seed)
                surfaces = random_surfaces(surfaces, self.random_points, rng)
            return {body.name: each for body, each in zip(creature.bodies, surfaces, strict=True)}

        if self.points == "random":
            form = skin = points(_DENSE_RESOLUTION)
        else:
            form, skin = points(self.form_resolution), points(self.skin_resolution)
        forces, surfacing = list[ForceLaw](), self.surface is not None
        if self.viscosity is not None:
            about = self.viscosity, self.form_drag, surfacing, layout
            forces.append(make_viscous_drag(creature, tree, form, skin, *about))
        else:
            assert self.law is not None and self.skin_drag is not None
            patches = make_patches(tree, form, skin, self.law, surfacing, layout)
            forces.append(Drag(self.form_drag, self.skin_drag, patches, self.law))
        inertia = np.zeros((6, 6, tree.body_count))
        if self.added_mass:
            inertia = added_inertia(creature, tree, self.density)
        if self.reactive_thrust:
            # Slender chains have the added mass of their sections.
            every_edge = layout == "complete"
            found = reactive_water(creature, tree, self.density, inertia, every_edge)
            if found is None:
                raise KeyProblem(
                    ("reactive_thrust",),
                    f"means nothing: no chain has {LEAST_BODIES} bodies joined end to end",
                )
            forces += [AddedMass(found[0]), found[1]]
        elif self.added_mass:
            forces.append(AddedMass(inertia))
        # The moment of ideal fluid is that of lift ahead of the centre.
        if self.lift and (plates := make_plate_lift(creature, tree, not self.added_mass, layout)):
            forces.append(plates)
        return forces

    @model_validator(mode="before")
    @classmethod
    def _has_defaults_of_its_drag_law(cls, data: Any) -> Any:
        """Replace ``null`` by the default. Skin drag and law have none with a viscosity."""
        if not isinstance(data, Mapping):
            return data
        unset = [key for key in ("skin_drag", "law") if data.get(key) is None]
        given = {key: value for key, value in data.items() if key not in unset}
        return given if data.get("viscosity") is None else given | dict.fromkeys(unset)

    @model_validator(mode="after")
    def _has_one_drag_law(self) -> "WaterConfig":
        if self.viscosity is None:
            if self.lift:
                raise ValueError("lift completes the drag of water with a viscosity; set viscosity")
            return self
        if self.law is not None:
            raise ValueError(
                f"viscosity has a drag law of its own; leave out law ({self.law!r}) or "
                "set it to null"
            )
        if self.skin_drag is not None:
            raise ValueError(
                f"viscosity determines skin friction; leave out skin_drag ({self.skin_drag:g}) or "
                "set it to null"
            )
        return self

    @field_validator("current_gradient")
    @classmethod
    def _keeps_its_volume(cls, gradient: tuple[Vector, Vector, Vector] | None):
        if gradient is not None:
            total = sum(gradient[i][i] for i in range(3))
            if abs(total) > _TRACE_TOLERANCE * max(abs(x) for row in gradient for x in row):
                raise ValueError(
                    f"water keeps its volume, so the diagonal must add up to 0, got {total:g}. A "
                    "shear has a zero diagonal: [[0, 0, 0.5], [0, 0, 0], [0, 0, 0]]"
                )
        return gradient


# A law with a section of its own joins the union here, as in `evo_cpg.io.schema.sensor`. The
# `build` of its section gets the creature and the tree.
ForceConfig: TypeAlias = CustomConfig


class WorldConfig(Section):
    """Gravity, water, ground, and further forces.

    Attributes:
        gravity: downward acceleration, m/s^2.
        water: water around the creature, or ``null`` for none.
        ground: ground below the creature (default: none).
        forces: force laws of your own, in addition to the forces of the water.
    """

    gravity: Annotated[NotNegative, GRAVITY] = 9.81
    water: WaterConfig | None = WaterConfig()
    ground: GroundConfig | None = None
    forces: tuple[ForceConfig, ...] = ()
