"""What is allowed in a configuration, but hardly meant.

One rule is one function: it takes a `Case` and yields a `Doubt` for each value that it doubts. A
new one goes into the file of its kind and into `RULES` there.
"""

from collections.abc import Iterator
from pathlib import Path

from evo_cpg.config.build import build_creature
from evo_cpg.config.plausible import angles, motors, places, search, sensors, sizes, surroundings
from evo_cpg.config.plausible.doubt import Case, Doubt
from evo_cpg.config.schema.experiment import ExperimentConfig

RULES = (
    *sizes.RULES,
    *angles.RULES,
    *places.RULES,
    *surroundings.RULES,
    *sensors.RULES,
    *motors.RULES,
    *search.RULES,
)


def doubts(config: ExperimentConfig, source: Path | str) -> list[Doubt]:
    """What of a configuration is hardly meant, each key once.

    Args:
        config: the configuration.
        source: file it came from, for messages.

    Raises:
        ConfigError: its bodies do not form one tree.
    """
    case = Case(config, build_creature(config, source))
    found: dict[tuple, Doubt] = {}
    for doubt in _all(case):
        found.setdefault(tuple(doubt.key), doubt)
    return list(found.values())


def _all(case: Case) -> Iterator[Doubt]:
    for rule in RULES:
        yield from rule(case)
