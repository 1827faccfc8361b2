"""Sections of gravity, water and ground."""

from typing import Annotated, Literal

from pydantic import Field, field_validator

from evo_cpg.config.schema.choice import CustomConfig
from evo_cpg.config.schema.ground import GroundConfig
from evo_cpg.config.schema.section import Finite, NotNegative, Positive, Section, Vector
from evo_cpg.config.schema.typical import GRAVITY, LIQUID
from evo_cpg.physics.fluid import DragLaw
from evo_cpg.physics.water import Current, Vortex, Water

# Rounding error of decimals, relative to the largest element of a gradient.
_TRACE_TOLERANCE = 1e-6


class VortexConfig(Section):
    """A vortex about a vertical axis.

    Attributes:
        centre: x and y of the axis, m.
        circulation: circulation far from the axis, counterclockwise seen from above, m^2/s.
        core: distance from the axis at which the water is fastest, m.
    """

    centre: tuple[Finite, Finite] = (0.0, 0.0)
    circulation: Finite
    core: Positive


class WaterConfig(Section):
    """Water around the whole creature, or up to a surface.

    Attributes:
        density: mass per volume, kg/m^3.
        form_drag: coefficient C_d for the normal velocity at every surface point.
        skin_drag: coefficient C_f for the tangential velocity at every surface point.
        surface: height of the water's surface, m, or ``null`` for water everywhere.
        added_mass: whether bodies accelerate the water around them, as in ideal fluid.
        current: velocity of the water, m/s; with a gradient, at the origin.
        current_gradient: derivatives of the current's components (rows) along x, y and z, 1/s.
        vortices: vortices that are added to the current.
        law: drag law: ``normal`` splits the drag into form and skin drag, ``isotropic`` is exactly
            eq. 8 of Iwadate 2010.
        sheltered: whether faces that other bodies cover at rest have no drag.
        points: ``quadrature`` distributes the points evenly, ``random`` draws them once, as in the
            paper, from ``points_seed``.
        form_resolution: resolution of points for form drag: its square on each face of a box.
        skin_resolution: resolution of points for skin friction: its square on each face of a box.
        random_points: number of random points on each body.
        points_seed: seed of random points.
    """

    density: Annotated[Positive, LIQUID] = 1000.0
    form_drag: NotNegative = 1.0
    skin_drag: NotNegative = 0.02
    surface: Finite | None = None
    added_mass: bool = False
    current: Vector = (0.0, 0.0, 0.0)
    current_gradient: tuple[Vector, Vector, Vector] | None = None
    vortices: tuple[VortexConfig, ...] = ()
    law: DragLaw = "normal"
    sheltered: bool = True
    points: Literal["quadrature", "random"] = "quadrature"
    form_resolution: Annotated[int, Field(ge=1, le=32)] = 2
    skin_resolution: Annotated[int, Field(ge=1, le=32)] = 1
    random_points: Annotated[int, Field(ge=1, le=10_000)] = 32
    points_seed: Annotated[int, Field(ge=0)] = 0

    def build(self) -> Water:
        """Build the water, without its forces."""
        vortices = (vortex.into(Vortex) for vortex in self.vortices)
        current = Current(self.current, self.current_gradient)
        return Water(self.density, self.surface, (current, *vortices))

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
    forces: tuple[CustomConfig, ...] = ()
