"""Gravity, water and ground."""

from typing import Annotated, Literal

from pydantic import Field

from evo_cpg.config.schema.section import NotNegative, Positive, Section, Share, Vector
from evo_cpg.physics.contact import Combination
from evo_cpg.physics.fluid import DragLaw


class WaterConfig(Section):
    """Water around the whole creature.

    Attributes:
        density: kg/m^3.
        form_drag: C_d of the normal velocity at every surface point.
        skin_drag: C_f of the tangential velocity.
        current: velocity of the water, m/s.
        law: ``normal`` splits the drag as above; ``isotropic`` is eq. 8 to the letter.
        sheltered: leave out faces that other bodies cover at rest.
        points: ``quadrature`` places the points evenly; ``random`` draws them once, as the paper
            says, from ``points_seed``.
        form_resolution: points for form drag: its square on each face of a box.
        skin_resolution: points for skin friction, likewise.
        random_points: points on each body when they are random.
        points_seed: seed of random points.
    """

    density: Positive = 1000.0
    form_drag: NotNegative = 1.0
    skin_drag: NotNegative = 0.02
    current: Vector = (0.0, 0.0, 0.0)
    law: DragLaw = "normal"
    sheltered: bool = True
    points: Literal["quadrature", "random"] = "quadrature"
    form_resolution: Annotated[int, Field(ge=1, le=32)] = 2
    skin_resolution: Annotated[int, Field(ge=1, le=32)] = 1
    random_points: Annotated[int, Field(ge=1, le=10_000)] = 32
    points_seed: Annotated[int, Field(ge=0)] = 0


class GroundConfig(Section):
    """Flat, level ground at height 0.

    Attributes:
        restitution: of the ground's material.
        static_friction: of the ground's material.
        dynamic_friction: of the ground's material.
        restitution_rule: how the body's and the ground's restitution combine.
        friction_rule: how their frictions combine.
        margin: points nearer than this are watched for an impact, m.
        stribeck_speed: sliding speed at which friction is half-way from static to dynamic, m/s.
    """

    restitution: Share = 0.5
    static_friction: NotNegative = 0.8
    dynamic_friction: NotNegative = 0.8
    restitution_rule: Combination = "multiply"
    friction_rule: Combination = "geometric"
    margin: Positive = 0.05
    stribeck_speed: Positive = 0.01


class WorldConfig(Section):
    """Gravity (m/s^2, downwards), water (none: ``water: null``) and ground (none unless given)."""

    gravity: NotNegative = 9.81
    water: WaterConfig | None = WaterConfig()
    ground: GroundConfig | None = None
