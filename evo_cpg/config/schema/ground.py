"""What there is to stand on: the ground's material, its shape, and obstacles."""

from typing import Annotated, Literal

from pydantic import Discriminator, Field, Tag, field_validator, model_validator

from evo_cpg.config.schema.choice import by_type
from evo_cpg.config.schema.plausible import Direction
from evo_cpg.config.schema.section import Finite, NotNegative, Positive, Section, Share, Vector
from evo_cpg.physics.footing import Combination
from evo_cpg.physics.terrain import Axis

# Heights are written into the run folder's configuration, and every step looks them up.
MOST_HEIGHTS = 256

Place = tuple[Finite, Finite]


class PlaneConfig(Section):
    """Flat ground.

    Attributes:
        type: ``plane``.
        slope_deg: by which it falls, degrees.
        downhill_deg: direction in which it falls, to the left of straight ahead, degrees.
        height: of the ground at the world's origin, m.
    """

    type: Literal["plane"] = "plane"
    slope_deg: Annotated[float, Field(ge=0, lt=90), Direction()] = 0.0
    downhill_deg: Annotated[Finite, Direction()] = 0.0
    height: Finite = 0.0


class ShoreConfig(Section):
    """A level, a slope, and a level: land that runs into water.

    Attributes:
        type: ``shore``.
        axis: along which the height changes.
        start: where the slope begins, m.
        stop: where it ends, m.
        start_height: of the ground before the slope, m.
        stop_height: of the ground behind it, m.
    """

    type: Literal["shore"]
    axis: Axis = "x"
    start: Finite = 0.0
    stop: Finite
    start_height: Finite = 0.0
    stop_height: Finite

    @model_validator(mode="after")
    def _check(self) -> "ShoreConfig":
        if not self.stop > self.start:
            raise ValueError(f"stop ({self.stop:g}) must be more than start ({self.start:g})")
        return self


class HillsConfig(Section):
    """Rolling ground, smooth and random.

    Attributes:
        type: ``hills``.
        seed: another one gives other hills.
        height: standard deviation of the heights, m.
        length: from hill to hill, roughly, m.
        size: of the square around the origin that they cover, m.
        spacing: of the grid of heights, m.
        clearing: radius of the nearly level place around the origin, m.
    """

    type: Literal["hills"]
    seed: Annotated[int, Field(ge=0)] = 0
    height: NotNegative = 0.1
    length: Positive = 2.0
    size: Positive = 20.0
    spacing: Positive = 0.2
    clearing: NotNegative = 1.0

    @model_validator(mode="after")
    def _check(self) -> "HillsConfig":
        count = self.size / self.spacing + 1
        if not 2 <= count <= MOST_HEIGHTS:
            raise ValueError(
                f"size / spacing gives {count:.0f} heights along each side; allowed: 2 to "
                f"{MOST_HEIGHTS}"
            )
        return self


class ReliefConfig(Section):
    """Heights of one's own on a regular grid.

    Attributes:
        type: ``relief``.
        heights: rows along x, m; with ``file`` they are read from there; at most 256 each way.
        spacing: of the grid, m.
        corner: x and y of the first height, m; the grid lies around the origin unless given.
    """

    type: Literal["relief"]
    heights: tuple[tuple[Finite, ...], ...]
    spacing: Positive = 0.1
    corner: Place | None = None

    @field_validator("heights")
    @classmethod
    def _check(cls, heights: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
        lengths = {len(row) for row in heights}
        if len(lengths) != 1:
            raise ValueError(f"rows must be equally long, got {sorted(lengths)}")
        if not all(2 <= count <= MOST_HEIGHTS for count in (len(heights), *lengths)):
            raise ValueError(
                f"{len(heights)} x {lengths.pop()} heights; allowed: 2 to {MOST_HEIGHTS} each way"
            )
        return heights


class ReliefFileConfig(Section):
    """Keys that name a file in the place of the heights of a relief.

    Attributes:
        file: array (.npy), table (.csv, .txt) or image that the heights are read from.
        lowest: height of an image's black, m.
        highest: height of an image's white, m.
    """

    file: str
    lowest: Finite = 0.0
    highest: Finite = 1.0


FloorConfig = Annotated[
    Annotated[PlaneConfig, Tag("plane")]
    | Annotated[ShoreConfig, Tag("shore")]
    | Annotated[HillsConfig, Tag("hills")]
    | Annotated[ReliefConfig, Tag("relief")],
    by_type("plane"),
]


class BoulderConfig(Section):
    """A sphere that lies about, sunk in or not.

    Attributes:
        type: ``boulder``.
        centre: its place in the world, m.
        radius: from centre to surface, m.
    """

    type: Literal["boulder"]
    centre: Vector
    radius: Positive


class BlockConfig(Section):
    """An upright box: a wall, a step, a pillar.

    Attributes:
        type: ``block``.
        centre: its place in the world, m.
        size: edges along x, y and z before it is turned, m.
        heading_deg: by which it is turned to the left, degrees.
    """

    type: Literal["block"]
    centre: Vector
    size: tuple[Positive, Positive, Positive]
    heading_deg: Annotated[Finite, Direction()] = 0.0


ObstacleConfig = Annotated[
    Annotated[BoulderConfig, Tag("boulder")] | Annotated[BlockConfig, Tag("block")],
    Discriminator("type"),
]


class GroundConfig(Section):
    """Ground: level at height 0 unless it has another ``floor``.

    Attributes:
        restitution: of the ground's material.
        static_friction: of the ground's material.
        dynamic_friction: of the ground's material.
        restitution_rule: how the body's and the ground's restitution become one.
        friction_rule: how their frictions become one.
        margin: points nearer than this are watched for an impact, m.
        stribeck_speed: sliding speed at which friction is half-way from static to dynamic, m/s.
        floor: its shape.
        obstacles: that stand on it.
    """

    restitution: Share = 0.5
    static_friction: NotNegative = 0.8
    dynamic_friction: NotNegative = 0.8
    restitution_rule: Combination = "multiply"
    friction_rule: Combination = "geometric"
    margin: Positive = 0.05
    stribeck_speed: Positive = 0.01
    floor: FloorConfig = PlaneConfig()
    obstacles: tuple[ObstacleConfig, ...] = ()
