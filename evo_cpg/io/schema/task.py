"""Sections of the task that determines fitness."""

import math
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, Tag, field_validator, model_validator

from evo_cpg.creature.algebra.decisions import chosen
from evo_cpg.creature.algebra.numerics import Number, Triple, xp
from evo_cpg.creature.creature import Creature, length_of
from evo_cpg.io.errors import KeyProblem
from evo_cpg.io.schema.section import (
    CustomConfig,
    Direction,
    Finite,
    NotNegative,
    OpenSection,
    Positive,
    Section,
    Vector,
    by_type,
)
from evo_cpg.physics.step.world import World
from evo_cpg.simulation.courses import Follow, Waypoints
from evo_cpg.simulation.task import Task
from evo_cpg.simulation.tasks import Distance, Heading, Point, ReachLight, Walk

Unit = Literal["m", "lengths"]


class LightConfig(OpenSection):
    """Position of the light, relative to the root at the start or in the world.

    Attributes:
        distance: distance from the root at the start, m; the default of `reach_light` is 8.
        bearing_deg: angle to the left of straight ahead, degrees; the default of `reach_light`
            is 30.
        elevation_deg: angle above the horizon, degrees; the default of `reach_light` is 0.
        at: position in the world, m, instead of the other three keys.
    """

    distance: Positive | None = None
    bearing_deg: Annotated[Finite | None, Direction()] = None
    elevation_deg: Annotated[Annotated[float, Field(ge=-90, le=90)] | None, Direction()] = None
    at: Vector | None = None

    @model_validator(mode="after")
    def _check(self) -> "LightConfig":
        given = [name for name, value in self if value is not None]
        if self.at is not None and len(given) > 1:
            others = ", ".join(name for name in given if name != "at")
            raise ValueError(f"at is a position in the world. Leave out {others}, or at")
        return self

    def over(self, other: "LightConfig") -> "LightConfig":
        """Return this light with its open keys filled from another light.

        If the other light has `at`, the open keys are filled from the default light.
        """
        given = {name: value for name, value in self if value is not None}
        if self.at is not None or not given:
            return self if given else other
        seen = DEFAULT_LIGHT if other.at is not None else other
        return seen.model_copy(update=given)

    def position(self, start: Triple, heading: Number) -> Triple:
        """Return the position of the light, m, or NaN if a key is open.

        ``start`` is the position of the root at the start (m), and ``heading`` its rotation to the
        left (rad).
        """
        if self.at is not None:
            return self.at
        distance, bearing_deg, elevation_deg = (
            np.nan if value is None else value
            for value in (self.distance, self.bearing_deg, self.elevation_deg)
        )
        bearing, elevation = xp.deg2rad(bearing_deg), xp.deg2rad(elevation_deg)
        level = distance * xp.cos(elevation)
        ahead, left = level * xp.cos(bearing), level * xp.sin(bearing)
        return (
            start[0] + xp.cos(heading) * ahead - xp.sin(heading) * left,
            start[1] + xp.sin(heading) * ahead + xp.cos(heading) * left,
            start[2] + distance * xp.sin(elevation),
        )


DEFAULT_LIGHT = LightConfig(distance=8.0, bearing_deg=30.0, elevation_deg=0.0)


class ReachLightConfig(Section):
    """Fitness of Iwadate 2010, eqs. 9 and 10, of normalised terms, with weights a > c > b.

    Attributes:
        type: ``reach_light``.
        light: position of the goal.
        distance_weight: a, weight of the remaining distance.
        light_weight: c, weight of the light in sight, less than ``distance_weight``.
        energy_weight: b, weight of the energy spent, less than ``light_weight``.
        energy_max: E_max, J, above which energy costs nothing more; the 95th percentile of the
            first generation if left out.
        final_seconds: final time over which the distance is averaged, s.
    """

    type: Literal["reach_light"] = "reach_light"
    light: LightConfig = DEFAULT_LIGHT
    distance_weight: NotNegative = 1.0
    light_weight: NotNegative = 0.5
    energy_weight: NotNegative = 0.2
    energy_max: Positive | None = None
    final_seconds: Positive = 1.0

    # Whether the task requires ground, and whether it draws courses.
    needs_ground: ClassVar[bool] = False
    draws_course: ClassVar[bool] = False

    @field_validator("light")
    @classmethod
    def _fill(cls, light: LightConfig) -> LightConfig:
        return light.over(DEFAULT_LIGHT)

    @model_validator(mode="after")
    def _check(self) -> "ReachLightConfig":
        if not self.distance_weight > self.light_weight > self.energy_weight:
            raise ValueError(
                "eq. 10 requires distance_weight > light_weight > energy_weight, got "
                f"{self.distance_weight:g}, {self.light_weight:g}, {self.energy_weight:g}"
            )
        return self

    def build(self, light: Triple | None, control_rate: float, **_: Any) -> Task:
        """Build the task.

        Args:
            light: position of the light, m.
            control_rate: control steps per second, 1/s.
            _: the creature, and the world without the task.
        """
        assert light is not None
        final_steps = chosen(lambda: max(1, round(self.final_seconds * control_rate)))
        return self.into(ReachLight, light=light, final_steps=final_steps)


class DistanceConfig(Section):
    """Fukui 2003: displacement from start to end, in any posture.

    Attributes:
        type: ``distance``.
        heading: ``any`` direction, or ``forward``.
        settle_seconds: time from the start in which the displacement does not count yet, s, less
            than the trial. Otherwise a tall body scores by falling over.
        point: point that moves: the ``root`` or the ``centre_of_mass``. A long animal moves its
            root by curling up once.
        unit: whether the displacement counts in ``m`` or in ``lengths`` of the animal at rest.
    """

    type: Literal["distance"] = "distance"
    heading: Heading = "any"
    settle_seconds: NotNegative = 0.0
    point: Point = "root"
    unit: Unit = "m"

    needs_ground: ClassVar[bool] = False
    draws_course: ClassVar[bool] = False

    def build(self, creature: Creature, **_: Any) -> Task:
        """Build the task for a creature."""
        length = length_of(creature) if self.unit == "lengths" else None
        return self.into(Distance, length=length)


class WalkConfig(Section):
    """Displacement minus penalties for tilting, bouncing and flight. Lengths are in torso lengths.

    Attributes:
        type: ``walk``.
        heading: ``any`` direction, or ``forward``.
        distance_weight: weight of the displacement (in torso lengths).
        tilt_weight: weight of the torso's tilt: 0 upright, 1 on the side, 2 on the back.
        bounce_weight: weight of the standard deviation of the torso's height (in torso lengths).
        airborne_weight: weight of the fraction of time without ground contact.
        slip_weight: weight of the path that everything on the ground slides, weighted by load (in
            torso lengths).
        cost_weight: weight of the energy of the motors divided by the animal's weight (in torso
            lengths).
    """

    type: Literal["walk"] = "walk"
    heading: Heading = "any"
    distance_weight: NotNegative = 1.0
    tilt_weight: NotNegative = 20.0
    bounce_weight: NotNegative = 20.0
    airborne_weight: NotNegative = 10.0
    slip_weight: NotNegative = 0.0
    cost_weight: NotNegative = 0.0

    needs_ground: ClassVar[bool] = True
    draws_course: ClassVar[bool] = False

    def build(self, creature: Creature, world: World, **_: Any) -> Task:
        """Build the task (see `ReachLightConfig.build`).

        Raises:
            KeyProblem: the energy has a cost, but there is no gravity.
        """

        def priced(weight: Number) -> Number | None:
            """Return a weight, or None for 0, so that a term without a price is not computed."""
            return weight if chosen(lambda: bool(weight > 0), lambda x: (weight > 0) == x) else None

        torso = creature.bodies[creature.root_index]
        parts = [body.shape for body in creature.bodies if body.whole == torso.name]
        if torso.shape.exists:
            length = 2 * torso.shape.half_extents[0]
        elif parts:
            length = 2 * xp.max(xp.array([part.half_extents for part in parts]))
        else:
            length = length_of(creature)
        slip_weight, cost_weight = priced(self.slip_weight), priced(self.cost_weight)
        if cost_weight is not None and not chosen(lambda: world.gravity > 0):
            raise KeyProblem(
                ("cost_weight",), "the cost is undefined without gravity (world.gravity)"
            )
        return self.into(
            Walk, torso_length=length, slip_weight=slip_weight, cost_weight=cost_weight
        )


class WaypointsConfig(Section):
    """Lights to reach in turn. The next appears when the last was reached.

    Attributes:
        type: ``waypoints``.
        lights: number of lights.
        spacing: distance from the start to the first light, and from each light to the next.
        turn_deg: largest turn from one leg to the next, degrees; turns are uniform on both sides.
        arena: edge of the square around the start in which all lights are drawn, instead of
            ``spacing`` and ``turn_deg``, or ``null``.
        radius: distance at which a light counts as reached.
        enough: number of lights that is a success, or ``null`` for all.
        unit: whether distances count in ``m`` or in ``lengths`` of the animal at rest.
    """

    type: Literal["waypoints"]
    lights: Annotated[int, Field(ge=1, le=100)] = 4
    spacing: Positive = 4.0
    turn_deg: Annotated[float, Field(ge=0, le=180)] = 120.0
    arena: Positive | None = None
    radius: Positive = 0.5
    enough: Annotated[int | None, Field(ge=1)] = None
    unit: Unit = "lengths"

    needs_ground: ClassVar[bool] = False
    draws_course: ClassVar[bool] = True

    @model_validator(mode="after")
    def _check(self) -> "WaypointsConfig":
        if self.enough is not None and self.enough > self.lights:
            raise ValueError(f"enough: {self.enough} of {self.lights} lights cannot be reached")
        return self

    @property
    def light(self) -> LightConfig:
        """Light straight ahead, from which the first turn counts."""
        return LightConfig(distance=1.0, bearing_deg=0.0, elevation_deg=0.0)

    def build(self, creature: Creature, light: Triple | None, **_: Any) -> Task:
        """Build the task for a creature."""
        assert light is not None
        unit = length_of(creature) if self.unit == "lengths" else 1.0
        return Waypoints(
            light=light,
            lights=self.lights,
            spacing=self.spacing * unit,
            turn=xp.deg2rad(self.turn_deg),
            radius=self.radius * unit,
            enough=self.enough or self.lights,
            arena=None if self.arena is None else self.arena * unit,
        )


class FollowConfig(Section):
    """A light to stay near. It rests, turns at random, or flees.

    Attributes:
        type: ``follow``.
        light: position of the light at the start; its ``distance`` is in m.
        speed: speed of the light, per second.
        every: time between two turns of the light, s.
        turn_deg: smallest turn, degrees; turns are uniform up to 180, on both sides.
        flees: distance of the animal from which the light flees straight away, or ``null``.
        radius: distance that counts as near.
        settle_seconds: time from the start that does not count yet, s, less than the trial.
        unit: whether distances count in ``m`` or in ``lengths`` of the animal at rest.
    """

    type: Literal["follow"]
    light: LightConfig = LightConfig(distance=1.0, bearing_deg=0.0, elevation_deg=0.0)
    speed: NotNegative = 0.0
    every: Positive = 5.0
    turn_deg: Annotated[float, Field(ge=0, le=180)] = 90.0
    flees: Positive | None = None
    radius: Positive = 1.0
    settle_seconds: NotNegative = 0.0
    unit: Unit = "lengths"

    needs_ground: ClassVar[bool] = False

    @field_validator("light")
    @classmethod
    def _fill(cls, light: LightConfig) -> LightConfig:
        return light.over(DEFAULT_LIGHT)

    @property
    def draws_course(self) -> bool:
        """Whether the light turns at random."""
        return self.flees is None and bool(self.speed)

    def build(self, creature: Creature, light: Triple | None, seconds: float, **_: Any) -> Task:
        """Build the task for a creature and a trial of some seconds."""
        assert light is not None
        unit = length_of(creature) if self.unit == "lengths" else 1.0
        return Follow(
            light=light,
            speed=self.speed * unit,
            every=self.every,
            turn=xp.deg2rad(self.turn_deg),
            radius=self.radius * unit,
            settle_seconds=self.settle_seconds,
            legs=chosen(lambda: math.ceil(seconds / self.every) if self.draws_course else 0),
            flees=None if self.flees is None else self.flees * unit,
        )


TaskConfig = Annotated[
    Annotated[ReachLightConfig, Tag("reach_light")]
    | Annotated[DistanceConfig, Tag("distance")]
    | Annotated[WalkConfig, Tag("walk")]
    | Annotated[WaypointsConfig, Tag("waypoints")]
    | Annotated[FollowConfig, Tag("follow")]
    | Annotated[CustomConfig, Tag("custom")],
    by_type("reach_light"),
]
