"""Warnings about values of a configuration that are allowed but probably unintended.

The plausible range of a single field is metadata of the field (`config.schema.typical`). A rule
compares several fields. It is a function, decorated with `rule`, that takes a `Case` and yields a
warning for each unintended value. A new rule goes into the file of its kind. Importing the files
below fills `RULES`.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from evo_cpg.io.build import build_creature
from evo_cpg.io.errors import Key
from evo_cpg.io.lint import bodies as bodies
from evo_cpg.io.lint import senses as senses
from evo_cpg.io.lint import world as world
from evo_cpg.io.lint.rule import RULES, Case, LintWarning
from evo_cpg.io.schema.experiment import ExperimentConfig
from evo_cpg.io.schema.typical import Direction, TypicalRange


def lint(config: ExperimentConfig, source: Path | str) -> list[LintWarning]:
    """Return warnings about probably unintended values, at most one for each key.

    Args:
        config: the configuration.
        source: file of the configuration, for messages.

    Raises:
        ConfigError: its bodies do not form one tree.
    """
    case = Case(config, build_creature(config, source))
    found: dict[Key, LintWarning] = {}
    for rule in (single_fields, *RULES):
        for warning in rule(case):
            found.setdefault(warning.key, warning)
    return list(found.values())


def single_fields(case: Case) -> Iterator[LintWarning]:
    """Yield warnings about single fields outside their plausible ranges."""
    for key, problem in _of_fields((), case.config):
        yield case.warning(key, problem)


def _of_fields(key: Key, value: Any) -> Iterator[tuple[Key, str]]:
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
                if isinstance(mark, (TypicalRange, Direction)) and given is not None:
                    problem = mark.problem(given)
                    if problem:
                        yield own, problem
            yield from _of_fields(own, given)
