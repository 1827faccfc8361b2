"""What is asked of a champion, and what an animal is out for breaking."""

import dataclasses
from typing import Annotated, Any, Literal

from pydantic import Field, create_model

from evo_cpg.analysis.verdict import Limits
from evo_cpg.config.schema.section import NotNegative, Section

# Rules that can be looked at in every control step of training.
RuleName = Literal["speed", "power", "penetration", "overlap"]


class _AuditConfig(Section):
    """What is asked of a champion, and two settings; shares of a way are of its own.

    Attributes:
        disqualify: limits that an individual is out for breaking, as if it had diverged.
        after_training: whether `train` replays the champion at half the step when it is done.
    """

    disqualify: Annotated[list[RuleName], Field(max_length=4)] = Field(default_factory=list)
    after_training: bool = True

    def limits(self) -> Limits:
        """What is asked of a champion."""
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
