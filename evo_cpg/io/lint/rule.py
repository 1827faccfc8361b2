"""Interface of the rules: their argument and their warnings."""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from evo_cpg.creature.creature import Body, Creature, Joint, neutral_pose
from evo_cpg.io.errors import Key
from evo_cpg.io.keys import value_at
from evo_cpg.io.schema.copies import copies_named
from evo_cpg.io.schema.creature import BodyConfig
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.io.schema.joint import JointConfig


class LintWarning(NamedTuple):
    """A value that is allowed but probably unintended.

    Attributes:
        key: key of the value.
        value: value in the configuration.
        problem: description of the problem, plausible values, and the probable intention.
    """

    key: Key
    value: Any
    problem: str

    def __str__(self) -> str:
        """Return the key, the value and the problem."""
        return f"{'.'.join(map(str, self.key))}: {_written(self.value)}: {self.problem}"


class Jointed(NamedTuple):
    """A body with a joint.

    Attributes:
        key: key of the joint in the configuration.
        given: joint in the configuration.
        repeat: number of bodies in the row of the body.
        built: joint of the creature.
        body: body that hangs on the joint.
        parent: body that carries the joint, or None for a root that hangs on the world.
    """

    key: Key
    given: JointConfig
    repeat: int
    built: Joint
    body: Body
    parent: Body | None


class Case(NamedTuple):
    """Argument of the rules.

    Attributes:
        config: the configuration.
        creature: creature of the configuration.
    """

    config: ExperimentConfig
    creature: Creature

    def warning(self, key: Key, problem: str, value: Any = None) -> LintWarning:
        """Return a warning about a key.

        Args:
            key: key of the value.
            problem: description of the problem.
            value: value to show instead of the value at the key.
        """
        shown = value_at(self.config, key) if value is None else value
        return LintWarning(tuple(key), shown, problem)

    def bodies(self) -> Iterator[tuple[Key, BodyConfig, Body]]:
        """Yield every body, with the key of its entry in the configuration and the entry.

        Further parts of bodies are left out.
        """
        entries = self.config.creature.bodies
        whole = [body for body in self.creature.bodies if body.whole is None]
        for copy, body in zip(self.config.creature.copies(), whole, strict=True):
            yield ("creature", "bodies", copy.entry), entries[copy.entry], body

    def joints(self) -> Iterator[Jointed]:
        """Yield every body that has a joint, also a root that hangs on the world."""
        named = {body.name: body for body in self.creature.bodies}
        for key, entry, body in self.bodies():
            built = self.creature.joint_of(body)
            if entry.joint and built:
                parent, key = body.joint and named[body.joint.parent], (*key, "joint")
                yield Jointed(key, entry.joint, entry.repeat, built, body, parent)

    def named(self, name: str) -> list[str]:
        """Return the names of the bodies that a name in the configuration stands for."""
        copies = self.config.creature.copies()
        return [copy.name for copy in copies_named(name, copies)]

    def sensors(self, kind: str) -> Iterator[tuple[int, Any, Any]]:
        """Yield every sensor, with the index of its entry in the configuration and the entry.

        Args:
            kind: ``light_sensors`` or ``depth_sensors``.
        """
        built = iter(getattr(self.creature, kind))
        for i, entry in enumerate(getattr(self.config.creature, kind)):
            for _ in self.named(entry.body):
                yield i, entry, next(built)

    @property
    def root(self) -> str:
        """Name of the body without a joint."""
        return next(body.name for body in self.creature.bodies if body.joint is None)

    @property
    def length(self) -> float:
        """Upper bound of the creature's length in its neutral pose, m."""
        centres, _ = neutral_pose(self.creature)
        reach = np.array([body.shape.reach for body in self.creature.bodies])
        return float(np.linalg.norm(np.ptp(centres, axis=0)) + 2 * reach.max())

    @property
    def lowest_ground(self) -> float | None:
        """Height of the lowest ground, m, or None if there is no ground, or it is unbounded."""
        ground = self.config.world.ground
        return ground and ground.floor.lowest


Rule = Callable[[Case], Iterator[LintWarning]]

# All rules, in the order of evaluation.
RULES: list[Rule] = []


def rule(function: Rule) -> Rule:
    """Add a function to the rules."""
    RULES.append(function)
    return function


def _written(value: Any) -> str:
    """Return a value in the form of a configuration."""
    if value is None:
        return "null"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(_written(item) for item in value)}]"
    return str(value)
