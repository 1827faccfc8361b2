"""Limits of a sound gait, and rules that disqualify an individual in training."""

import dataclasses
from typing import Annotated, Any, Literal

from pydantic import Field, create_model

from evo_cpg.io.schema.section import NotNegative, Section
from evo_cpg.simulation.limits import Limits

# Rules that can be checked in every control step of training.
RuleName = Literal["speed", "joint_rate", "power", "penetration", "overlap"]


class _AuditConfig(Section):
    """Limits for a champion, and two settings. A fraction of a distance is of the champion's own.

    Attributes:
        disqualify: names of limits. An individual that exceeds one in training is disqualified, as
            if it had diverged. By default, speed and joint_rate if bodies evolve, overlap with
            plans, and penetration with plans on ground.
        after_training: whether `train` finally replays the champion at half the physics step.
    """

    disqualify: Annotated[list[RuleName], Field(max_length=5)] = Field(default_factory=list)
    after_training: bool = True

    def limits(self) -> Limits:
        """Return the limits for a champion."""
        return Limits(**{each.name: getattr(self, each.name) for each in _FIELDS})


_FIELDS = dataclasses.fields(Limits)
_TYPES: dict[str, Any] = {
    each.name: (
        NotNegative | None if each.default is None else NotNegative,  # pyright: ignore[reportOperatorIssue]
        each.default,
    )
    for each in _FIELDS
}

AuditConfig: type[_AuditConfig] = create_model(
    "AuditConfig", __base__=_AuditConfig, __doc__=_AuditConfig.__doc__, **_TYPES
)
