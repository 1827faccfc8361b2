"""Values of a configuration that are allowed but hardly meant.

The plausible range of a single field is metadata of the field (`config.schema.plausible`). A rule
compares several fields: it is a function that takes a `Case` and yields a `Doubt` for each value
that it doubts. A new rule goes into the file of its kind and into `RULES` there.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from evo_cpg.config.build import build_creature
from evo_cpg.config.errors import Key
from evo_cpg.config.plausible import joints, places, search, sensors, sizes, surroundings
from evo_cpg.config.plausible.doubt import Case, Doubt
from evo_cpg.config.schema.experiment import ExperimentConfig
from evo_cpg.config.schema.plausible import Direction, Plausible


def single_fields(case: Case) -> Iterator[Doubt]:
    """Yield doubts about fields that carry what is plausible."""
    yield from _of_fields((), case.config)


def _of_fields(key: Key, value: Any) -> Iterator[Doubt]:
    if isinstance(value, dict):
        for name, each in value.items():
            yield from _of_fields((*key, name), each)
    elif isinstance(value, (list, tuple)) and value and isinstance(value[0], BaseModel):
        for i, each in enumerate(value):
            yield from _of_fields((*key, i), each)
    elif isinstance(value, BaseModel):
        for name, field in type(value).model_fields.items():
            own, given = (*key, name), getattr(value, name)
            for mark in field.metadata:
                if isinstance(mark, (Plausible, Direction)) and given is not None:
                    problem = mark.problem(given)
                    if problem:
                        yield Doubt(own, given, problem)
            yield from _of_fields(own, given)


RULES = (
    single_fields,
    *sizes.RULES,
    *joints.RULES,
    *places.RULES,
    *surroundings.RULES,
    *sensors.RULES,
    *search.RULES,
)


def doubts(config: ExperimentConfig, source: Path | str) -> list[Doubt]:
    """Return the values of a configuration that are hardly meant, each key once.

    Args:
        config: the configuration.
        source: file it came from, for messages.

    Raises:
        ConfigError: its bodies do not form one tree.
    """
    case = Case(config, build_creature(config, source))
    found: dict[tuple, Doubt] = {}
    for rule in RULES:
        for doubt in rule(case):
            found.setdefault(tuple(doubt.key), doubt)
    return list(found.values())
