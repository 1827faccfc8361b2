"""Sections of the ground: its material, its shape, and obstacles."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Discriminator, Field, Tag, field_validator, model_validator

from evo_cpg.creature.algebra.numerics import Number, xp
from evo_cpg.io.schema.section import (
    DescribedSection,
    Direction,
    Finite,
    Fraction,
    NotNegative,
    Positive,
    Section,
    Vector,
    by_type,
)
from evo_cpg.physics.contact.contact_model import Combination, Ground
from evo_cpg.physics.contact.terrain import (
    Axis,
    Block,
    Boulder,
    GroundPart,
    Obstacle,
    Plane,
    Relief,
    Shore,
)

# Largest number of heights along each axis: the run folder's configuration stores all heights, and
# every step looks them up.
MOST_HEIGHTS = 256

Place = tuple[Finite, Finite]


class PlaneConfig(Section):
    """Flat ground.

    Attributes:
        type: ``plane``.
        slope_deg: angle of the slope, degrees.
        downhill_deg: downhill direction, to the left of straight ahead, degrees.
        height: height of the ground at the world's origin, m.
    """

    type: Literal["plane"] = "plane"
    slope_deg: Annotated[float, Field(ge=0, lt=90), Direction()] = 0.0
    downhill_deg: Annotated[Finite, Direction()] = 0.0
    height: Finite = 0.0

    def build(self) -> GroundPart:
        """Build the floor."""
        slope, downhill = xp.deg2rad(self.slope_deg), xp.deg2rad(self.downhill_deg)
        level = xp.sin(slope)
        normal = (level * xp.cos(downhill), level * xp.sin(downhill), xp.cos(slope))
        return Plane(normal, self.height * normal[2])


class ShoreConfig(DescribedSection):
    """Level ground, a slope, and level ground at another height: land that runs into water.

    Attributes:
        type: ``shore``.
        axis: axis along which the height changes.
        start: coordinate at which the slope begins, m.
        stop: coordinate at which the slope ends, m.
        start_height: height of the ground before the slope, m.
        stop_height: height of the ground behind the slope, m.
    """

    type: Literal["shore"]
    axis: Axis = "x"
    start: Finite = 0.0
    stop: Finite
    start_height: Finite = 0.0
    stop_height: Finite

    described = Shore

    @model_validator(mode="after")
    def _check(self) -> "ShoreConfig":
        if not self.stop > self.start:
            raise ValueError(f"stop ({self.stop:g}) must be more than start ({self.start:g})")
        return self


class HillsConfig(Section):
    """Rolling ground, smooth and random.

    Attributes:
        type: ``hills``.
        seed: seed of the random hills.
        height: standard deviation of the heights, m.
        length: approximate distance from hill to hill, m.
        size: edge of the square of hills around the origin, m.
        spacing: spacing of the grid of heights, m.
        clearing: radius of the nearly level area around the origin, m.
    """

    type: Literal["hills"]
    seed: Annotated[int, Field(ge=0)] = 0
    height: NotNegative = 0.1
    length: Positive = 2.0
    size: Positive = 20.0
    spacing: Positive = 0.2
    clearing: NotNegative = 1.0

    def build(self) -> GroundPart:
        """Build the floor: smoothed noise, 0 at the origin and nearly 0 around it."""
        count = round(self.size / self.spacing) + 1
        place = (np.arange(count) - (count - 1) / 2) * self.spacing
        noise = np.random.default_rng(self.seed).normal(size=(count, count))
        # The Gaussian filter in the frequency domain keeps waves longer than `length`.
        wave = 2 * np.pi * np.fft.fftfreq(count, self.spacing)
        width = self.length / 4
        soft = np.exp(-0.5 * width**2 * (wave[:, None] ** 2 + wave[None] ** 2))
        heights = np.fft.ifft2(np.fft.fft2(noise) * soft).real
        heights = heights * (self.height / max(heights.std(), np.finfo(float).tiny))
        away = np.hypot(*np.meshgrid(place, place, indexing="ij"))
        flat = np.exp(-0.5 * (away / max(self.clearing, self.spacing)) ** 2)
        return _relief(heights * (1 - flat), self.spacing)

    @model_validator(mode="after")
    def _check(self) -> "HillsConfig":
        count = self.size / self.spacing + 1
        if not 2 <= count <= MOST_HEIGHTS:
            raise ValueError(
                f"size / spacing gives {count:.0f} heights along each side. Allowed: 2 to "
                f"{MOST_HEIGHTS}"
            )
        return self


class ReliefConfig(Section):
    """Heights of your own on a regular grid.

    Attributes:
        type: ``relief``.
        heights: rows of heights along x, at most 256 along each axis, m; ``file`` can replace them.
        spacing: spacing of the grid, m.
        corner: x and y of the first height, m; if left out, the grid is centred on the origin.
    """

    type: Literal["relief"]
    heights: tuple[tuple[Finite, ...], ...]
    spacing: Positive = 0.1
    corner: Place | None = None

    def build(self) -> GroundPart:
        """Build the floor."""
        return _relief(np.array(self.heights), self.spacing, self.corner)

    @field_validator("heights")
    @classmethod
    def _check(cls, heights: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
        lengths = {len(row) for row in heights}
        if len(lengths) != 1:
            raise ValueError(f"rows must be equally long, got {sorted(lengths)}")
        if not all(2 <= count <= MOST_HEIGHTS for count in (len(heights), *lengths)):
            raise ValueError(
                f"{len(heights)} x {lengths.pop()} heights. Allowed: 2 to {MOST_HEIGHTS} along "
                "each axis"
            )
        return heights


def _relief(heights: np.ndarray, spacing: Number, corner: Place | None = None) -> Relief:
    """Return heights on a grid, centred on the origin unless a corner is given."""
    if corner is None:
        x, y = (-(count - 1) / 2 * spacing for count in heights.shape)
        corner = (x, y)
    return Relief(heights, corner, spacing)


class ReliefFileConfig(Section):
    """Keys for a file that contains the heights of a relief.

    Attributes:
        file: array (.npy), table (.csv, .txt) or image with the heights.
        lowest: height of black in an image of 8 or 16 bits, m.
        highest: height of white in an image of 8 or 16 bits, m.
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


class BoulderConfig(DescribedSection):
    """A fixed sphere, on or partly in the floor.

    Attributes:
        type: ``boulder``.
        centre: position in the world, m.
        radius: distance from centre to surface, m.
    """

    type: Literal["boulder"]
    centre: Vector
    radius: Positive

    described = Boulder


class BlockConfig(Section):
    """An upright box: a wall, a step, a pillar.

    Attributes:
        type: ``block``.
        centre: position in the world, m.
        size: edges along x, y and z before the rotation, m.
        heading_deg: rotation to the left, degrees.
    """

    type: Literal["block"]
    centre: Vector
    size: tuple[Positive, Positive, Positive]
    heading_deg: Annotated[Finite, Direction()] = 0.0

    def build(self) -> Obstacle:
        """Build the obstacle."""
        x, y, z = self.size
        return Block(self.centre, (x / 2, y / 2, z / 2), xp.deg2rad(self.heading_deg))


ObstacleConfig = Annotated[
    Annotated[BoulderConfig, Tag("boulder")] | Annotated[BlockConfig, Tag("block")],
    Discriminator("type"),
]


class GroundConfig(Section):
    """Ground: level at height 0 unless it has another ``floor``.

    Attributes:
        restitution: coefficient of restitution of the ground's material.
        static_friction: coefficient of friction of the ground's material at rest.
        dynamic_friction: coefficient of friction of the ground's material while sliding.
        restitution_rule: rule that combines the restitution of body and ground.
        friction_rule: rule that combines the friction coefficients of body and ground.
        margin: distance below which points are checked for an impact, m.
        stribeck_speed: sliding speed at which friction is half-way from static to dynamic, m/s.
        floor: shape of the ground.
        obstacles: obstacles on the ground.
    """

    restitution: Fraction = 0.5
    static_friction: NotNegative = 0.8
    dynamic_friction: NotNegative = 0.8
    restitution_rule: Combination = "multiply"
    friction_rule: Combination = "geometric"
    margin: Positive = 0.05
    stribeck_speed: Positive = 0.01
    floor: FloorConfig = PlaneConfig()
    obstacles: tuple[ObstacleConfig, ...] = ()

    def build(self) -> Ground:
        """Build the ground."""
        obstacles = tuple(obstacle.build() for obstacle in self.obstacles)
        return self.into(Ground, floor=self.floor.build(), obstacles=obstacles)
