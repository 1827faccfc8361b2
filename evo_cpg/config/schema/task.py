"""What the animals are judged by."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, Tag, model_validator

from evo_cpg.config.schema.choice import CustomConfig, by_type
from evo_cpg.config.schema.section import Finite, NotNegative, Positive, Section
from evo_cpg.simulation.walk import Heading


class LightConfig(Section):
    """Where the light is, seen from the root at the start.

    Attributes:
        distance: m.
        bearing_deg: to the left of straight ahead, degrees.
        elevation_deg: above the horizon, degrees.
    """

    distance: Positive = 8.0
    bearing_deg: Finite = 30.0
    elevation_deg: Annotated[float, Field(ge=-90, le=90)] = 0.0

    def position(self) -> tuple[float, float, float]:
        """Place of the light, m."""
        bearing, elevation = np.deg2rad([self.bearing_deg, self.elevation_deg])
        level = self.distance * np.cos(elevation)
        return (
            float(level * np.cos(bearing)),
            float(level * np.sin(bearing)),
            float(self.distance * np.sin(elevation)),
        )


class ReachLightConfig(Section):
    """Iwadate 2010, eqs. 9 and 10, on normalised terms: a > c > b.

    Attributes:
        type: ``reach_light``.
        light: the goal.
        distance_weight: a.
        light_weight: c.
        energy_weight: b.
        final_seconds: time at the end over which the distance is averaged, s.
    """

    type: Literal["reach_light"] = "reach_light"
    light: LightConfig = LightConfig()
    distance_weight: NotNegative = 1.0
    light_weight: NotNegative = 0.5
    energy_weight: NotNegative = 0.2
    final_seconds: Positive = 1.0

    @model_validator(mode="after")
    def _check(self) -> "ReachLightConfig":
        if not self.distance_weight > self.light_weight > self.energy_weight:
            raise ValueError(
                "eq. 10 asks for distance_weight > light_weight > energy_weight, got "
                f"{self.distance_weight:g}, {self.light_weight:g}, {self.energy_weight:g}"
            )
        return self


class DistanceConfig(Section):
    """Fukui 2003: distance moved, whatever the posture.

    Attributes:
        type: ``distance``.
        heading: ``any`` direction, or ``forward``.
    """

    type: Literal["distance"] = "distance"
    heading: Heading = "any"


class WalkConfig(Section):
    """Distance, less what running has and walking has not; weights in torso lengths of way.

    Attributes:
        type: ``walk``.
        heading: ``any`` direction, or ``forward``.
        distance_weight: of the distance, in torso lengths.
        tilt_weight: of the torso's tilt: 0 upright, 1 on the side, 2 on the back.
        bounce_weight: of the standard deviation of its height, in torso lengths.
        airborne_weight: of the share of time in which nothing touches the ground.
    """

    type: Literal["walk"] = "walk"
    heading: Heading = "any"
    distance_weight: NotNegative = 1.0
    tilt_weight: NotNegative = 20.0
    bounce_weight: NotNegative = 20.0
    airborne_weight: NotNegative = 10.0


TaskConfig = Annotated[
    Annotated[ReachLightConfig, Tag("reach_light")]
    | Annotated[DistanceConfig, Tag("distance")]
    | Annotated[WalkConfig, Tag("walk")]
    | Annotated[CustomConfig, Tag("custom")],
    by_type("reach_light"),
]
