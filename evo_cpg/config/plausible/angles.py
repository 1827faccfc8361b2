"""Angles that look like radians where degrees are asked for, or the other way round."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from evo_cpg.config.errors import Key
from evo_cpg.config.plausible.doubt import Case, Doubt
from evo_cpg.config.schema.ground import BlockConfig, PlaneConfig
from evo_cpg.config.schema.task import LightConfig, ReachLightConfig

# Angles that people choose are multiples of this, degrees. In radians they are crooked numbers,
# of which at least two decimals are written.
_COMMON, _ROUNDING = 15.0, 0.006

# A full turn, degrees; what is farther was converted once too often.
_TURN = 360.0

# Joints of animals and robots turn at up to 20 rad/s, the fastest servos at 60; what is faster is
# in degrees per second.
_FASTEST = 60.0


def joint_limits(case: Case) -> Iterator[Doubt]:
    """A joint that turns by three degrees at most, or by more than a full turn."""
    for key, entry, _ in case.bodies():
        if entry.joint is None:
            continue
        for lower, upper in entry.joint.limits:
            widest = max(abs(lower), abs(upper))
            if widest <= np.pi + _ROUNDING:
                problem = (
                    f"the joint turns by {widest:g} degrees at most; plausible are 5 to 180; as "
                    f"radians it would be {np.rad2deg(widest):.3g} degrees"
                )
            elif widest > _TURN:
                problem = (
                    f"the joint turns by {widest:g} degrees; plausible is up to {_TURN:g}; "
                    f"converted twice? then it was {np.deg2rad(widest):.3g}"
                )
            elif lower > 0 or upper < 0:
                problem = (
                    "the neutral pose, 0 degrees, is beyond the limits, which will jerk it back"
                )
            else:
                continue
            yield Doubt((*key, "joint", "limits_deg"), entry.joint.limits_deg, problem)
            break


def directions(case: Case) -> Iterator[Doubt]:
    """Angles of which every one is a common angle, but in radians, or beyond a full turn."""
    for key, value, numbers in _directions(case):
        given = np.array([number for number in numbers if number])
        if not len(given):
            continue
        degrees = np.rad2deg(given)
        meant = np.round(degrees / _COMMON) * _COMMON
        off = np.abs(given - np.deg2rad(meant))
        crooked = given != np.round(given)
        if (np.abs(given) <= 2 * np.pi + _ROUNDING).all() and (
            (off < _ROUNDING) & (meant != 0) & crooked
        ).all():
            words = ", ".join(f"{angle:g}" for angle in meant)
            problem = f"in degrees this is hardly a turn; as radians it would be {words} degrees"
        elif np.abs(given).max() > _TURN:
            problem = f"plausible are -{_TURN:g} to {_TURN:g} degrees; converted twice?"
        else:
            continue
        yield Doubt(key, value, f"{problem}; write degrees")


def _directions(case: Case) -> Iterator[tuple[Key, object, tuple[float, ...]]]:
    """Keys, values and numbers of the angles that are directions."""
    config = case.config
    for key, entry, _ in case.bodies():
        if entry.joint is not None:
            angles = entry.joint.rotation_deg
            yield (*key, "joint", "rotation_deg"), angles, angles
    heading = config.simulation.start_heading_deg
    yield ("simulation", "start_heading_deg"), heading, (heading,)
    if isinstance(config.task, ReachLightConfig):
        yield from _of_light(("task", "light"), config.task.light)
    trials = config.simulation.trials
    for i, entry in enumerate(trials if isinstance(trials, list) else []):
        key = ("simulation", "trials", i)
        if entry.start_heading_deg is not None:
            heading = entry.start_heading_deg
            yield (*key, "start_heading_deg"), heading, (heading,)
        if entry.light is not None:
            yield from _of_light((*key, "light"), entry.light)
    ground = config.world.ground
    if ground is None:
        return
    if isinstance(ground.floor, PlaneConfig):
        for name in ("slope_deg", "downhill_deg"):
            angle = getattr(ground.floor, name)
            yield ("world", "ground", "floor", name), angle, (angle,)
    for i, obstacle in enumerate(ground.obstacles):
        if isinstance(obstacle, BlockConfig):
            angle = obstacle.heading_deg
            yield ("world", "ground", "obstacles", i, "heading_deg"), angle, (angle,)


def _of_light(key: Key, light: LightConfig) -> Iterator[tuple[Key, object, tuple[float, ...]]]:
    for name in ("bearing_deg", "elevation_deg"):
        angle = getattr(light, name)
        if angle is not None:
            yield (*key, name), angle, (angle,)


def field_of_view(case: Case) -> Iterator[Doubt]:
    """An eye that sees a slit of the world."""
    for i, eye in enumerate(case.config.creature.light_sensors):
        angle = eye.field_of_view_deg
        if angle <= 2 * np.pi + _ROUNDING:
            yield Doubt(
                ("creature", "light_sensors", i, "field_of_view_deg"),
                angle,
                f"the eye sees {angle:g} of 360 degrees, and hardly ever a light; plausible are 20 "
                f"to 360; as radians it would be {np.rad2deg(angle):.3g} degrees",
            )


def postures(case: Case) -> Iterator[Doubt]:
    """Postures that differ by a few degrees: these keys have no ``_deg`` but are degrees."""
    # A class made while the schema is read, which pyright cannot follow.
    given: Any = case.config.controller
    if given.type != "postures":
        return
    # However many: refused later.
    reach = given.angle_step * (2.0 ** min(given.bits_per_joint, 60) - 1)
    if reach <= 2 * np.pi:
        yield Doubt(
            ("controller", "angle_step"),
            given.angle_step,
            f"all angles of a joint lie within {reach:.3g} degrees; plausible are 10 to 180; as "
            f"radians a step would be {np.rad2deg(given.angle_step):.3g} degrees: write that",
        )
    for name in ("lowest_angle", "neutral_angle"):
        angle = getattr(given, name)
        if 0 < abs(angle) <= 2 * np.pi and angle != round(angle):
            yield Doubt(
                ("controller", name),
                angle,
                "angles of postures are degrees, 180 straight on by default; as radians it would "
                f"be {np.rad2deg(angle):.3g} degrees: write that",
            )


def rates(case: Case) -> Iterator[Doubt]:
    """Rates of joints, in radians per second, that look like degrees per second."""
    # A class made while the schema is read, which pyright cannot follow.
    given: Any = case.config.controller
    if given.type != "brain_cpg":
        return
    for name in ("max_rate", "rate_gain"):
        rate = getattr(given, name)
        if rate > _FASTEST:
            yield Doubt(
                ("controller", name),
                rate,
                f"joints turn at {rate:g} rad/s; plausible is up to {_FASTEST:g} rad/s; as degrees "
                f"per second it would be {np.deg2rad(rate):.3g} rad/s: write that",
            )


RULES = (joint_limits, directions, field_of_view, postures, rates)
