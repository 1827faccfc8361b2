"""Joint limits and postures that look like radians, and animals that nothing moves."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from evo_cpg.config.plausible.doubt import Case, Doubt
from evo_cpg.config.schema.plausible import ROUNDING, TURN

# What a motor must be able to do to its own body in a trial, degrees.
_LEAST_TURN = 1.0


def joint_limits(case: Case) -> Iterator[Doubt]:
    """A joint that turns by three degrees at most, or by more than a full turn."""
    for key, entry, _ in case.bodies():
        if entry.joint is None:
            continue
        for lower, upper in entry.joint.limits:
            widest = max(abs(lower), abs(upper))
            if widest <= np.pi + ROUNDING:
                problem = (
                    f"the joint turns by {widest:g} degrees at most; plausible are 5 to 180; as "
                    f"radians it would be {np.rad2deg(widest):.3g} degrees"
                )
            elif widest > TURN:
                problem = (
                    f"the joint turns by {widest:g} degrees; plausible is up to {TURN:g}; "
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


def no_motor(case: Case) -> Iterator[Doubt]:
    """Joints of which none has a motor."""
    joints = [(key, entry.joint) for key, entry, _ in case.bodies() if entry.joint is not None]
    if joints and all(joint.actuator is None for _, joint in joints):
        yield Doubt(
            (*joints[0][0], "joint", "actuator"),
            None,
            "no joint has a motor, so the controller moves nothing; give the joints that it is to "
            "move a motor, such as actuator: {gain: 1}",
        )


def no_rate(case: Case) -> Iterator[Doubt]:
    """Motors that are told to stand still."""
    # A class made while the schema is read, which pyright cannot follow.
    given: Any = case.config.controller
    if given.type == "brain_cpg" and given.rate_gain == 0:
        yield Doubt(
            ("controller", "rate_gain"),
            given.rate_gain,
            "the rhythm sets a rate of 0 for every joint, so the animal stays in its neutral pose; "
            "plausible are 1 to 20 rad/s",
        )


def weak_motors(case: Case) -> Iterator[Doubt]:
    """Motors of which none could turn even its own body by a degree in the whole trial."""
    simulation = case.config.simulation
    time = simulation.steps / simulation.control_rate_hz
    found = []
    for key, entry, body in case.bodies():
        motor = entry.joint.actuator if entry.joint is not None else None
        if motor is None:
            continue
        limit = np.inf if motor.torque_limit is None else motor.torque_limit
        # Of a rod that turns about its end: other bodies and water only add to it.
        mass = float(body.mass)
        inertia = mass * (2 * float(body.shape.half_extents.max())) ** 2 / 3
        turn = float(np.rad2deg(limit / inertia * time**2 / 2))
        found.append((turn, (*key, "joint", "actuator", "torque_limit"), limit))
    if not found or max(found)[0] >= _LEAST_TURN:
        return
    turn, key, limit = max(found)
    problem = (
        f"the motors are too weak to move anything: the strongest turns its own body by {turn:.2g} "
        f"degrees in the {time:.3g} s of a trial; torques are in N m"
    )
    yield Doubt(key, limit, problem)


RULES = (joint_limits, postures, no_motor, weak_motors, no_rate)
