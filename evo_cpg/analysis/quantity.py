"""A measured number with its definition, and the range of animals beside it."""

import math
from typing import NamedTuple

from evo_cpg.analysis.animals import Animals


class Quantity(NamedTuple):
    """A number with its name, for a table.

    Attributes:
        key: short name of letters and underscores.
        name: name in words.
        value: value, or NaN if it does not exist.
        unit: unit, empty for a pure number.
        definition: definition, and the source of the formula.
        missing: reason why the value does not exist, empty if it does.
        animals: ranges of animals, empty if there are none.
    """

    key: str
    name: str
    value: float
    unit: str
    definition: str
    missing: str = ""
    animals: tuple[Animals, ...] = ()

    @property
    def exists(self) -> bool:
        """Whether there is a value."""
        return math.isfinite(self.value)
