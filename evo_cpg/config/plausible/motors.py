"""Animals that nothing moves."""

from collections.abc import Iterator
from typing import Any

from evo_cpg.config.plausible.doubt import Case, Doubt


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


RULES = (no_motor, no_rate)
