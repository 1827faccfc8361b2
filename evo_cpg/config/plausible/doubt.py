"""What the rules are given, and what they yield."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from evo_cpg.config.errors import Key
from evo_cpg.config.schema.copies import copies_named
from evo_cpg.config.schema.creature import BodyConfig
from evo_cpg.config.schema.experiment import ExperimentConfig
from evo_cpg.creature.creature import Body, Creature, neutral_pose


class Doubt(NamedTuple):
    """A value that is hardly meant.

    Attributes:
        key: its place in the configuration.
        value: as it is written.
        problem: what is odd about it, what is plausible, and what was probably meant.
    """

    key: Key
    value: Any
    problem: str

    def __str__(self) -> str:
        """The key, the value and what is odd about it."""
        return f"{'.'.join(map(str, self.key))}: {_written(self.value)}: {self.problem}"


class Case(NamedTuple):
    """What the rules look at.

    Attributes:
        config: the configuration.
        creature: that it describes.
    """

    config: ExperimentConfig
    creature: Creature

    def bodies(self) -> Iterator[tuple[Key, BodyConfig, Body]]:
        """Every body with its entry in the configuration and the key of that."""
        for i, body in enumerate(self.creature.bodies):
            entry = self.config.creature.entry_of(i)
            yield ("creature", "bodies", entry), self.config.creature.bodies[entry], body

    def named(self, name: str) -> list[str]:
        """The bodies that a name in the configuration stands for, placeholders filled in."""
        copies = self.config.creature.copies()
        return [copy.name for copy in copies_named(name, copies)]

    def sensors(self, kind: str) -> Iterator[tuple[int, Any, Any]]:
        """Yield every sensor, with the number of its entry in the configuration and the entry.

        Args:
            kind: ``light_sensors`` or ``depth_sensors``.
        """
        built = iter(getattr(self.creature, kind))
        for i, entry in enumerate(getattr(self.config.creature, kind)):
            for _ in self.named(entry.body):
                yield i, entry, next(built)

    @property
    def root(self) -> str:
        """The name of the body without a joint."""
        return next(body.name for body in self.creature.bodies if body.joint is None)

    @property
    def length(self) -> float:
        """Of the creature in its neutral pose, from its first to its last centre and beyond, m."""
        centres, _ = neutral_pose(self.creature)
        reach = np.array([body.shape.reach for body in self.creature.bodies])
        return float(np.linalg.norm(np.ptp(centres, axis=0)) + 2 * reach.max())


def _written(value: Any) -> str:
    """A value as it stands in a configuration."""
    if value is None:
        return "null"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(_written(item) for item in value)}]"
    return str(value)
