"""Access to the real numbers of a configuration by key, such as ``world.water.form_drag``."""

import difflib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from pydantic import BaseModel, ValidationError

from evo_cpg.creature.algebra.numerics import Number
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.keys import follow, inside, parts_of, put
from evo_cpg.io.load import check_config
from evo_cpg.io.schema.experiment import ExperimentConfig

# Sections whose numbers are no parameters of a trial, and keys of lists that are too long to list
# each number.
_OUTSIDE = ("audit", "evolution", "noise")
_LONG = ("vertices", "faces", "heights")


def number_keys(config: ExperimentConfig) -> tuple[str, ...]:
    """Return the keys of all real numbers, except in `_OUTSIDE` sections and `_LONG` lists."""
    data = config.model_dump(mode="json", exclude=set(_OUTSIDE))
    return tuple(".".join(key) for key, _ in _numbers(data, ()))


def number_at(config: ExperimentConfig, key: str, source: Path | str = "") -> float:
    """Return the real number of a configuration at a key.

    Raises:
        ConfigError: there is no real number.
    """
    parts = parts_of(key)
    place, known = follow(config.model_dump(mode="json"), parts)
    if known < len(parts):
        problem = f"does not exist: {_hint(config, key)}"
    elif isinstance(place, float):
        return place
    elif isinstance(place, int) and not isinstance(place, bool):
        problem = f"is a whole number ({place}), and only real numbers can vary"
    elif isinstance(place, (dict, list)):
        problem = f"is a section or a list, not a number: {_hint(config, key)}"
    else:
        problem = f"is {place!r}, not a number"
    raise ConfigError(source, parts, problem)


def with_numbers(
    config: ExperimentConfig, numbers: Mapping[str, float], source: Path | str
) -> ExperimentConfig:
    """Return a configuration with other numbers.

    Args:
        config: the configuration.
        numbers: values by key.
        source: file of the configuration.

    Raises:
        ConfigError: the numbers are not allowed.
    """
    data = config.model_dump(mode="json")
    for key, number in numbers.items():
        data = put(data, parts_of(key), number)
    return check_config(data, source)


def are_allowed(config: ExperimentConfig, columns: Mapping[str, Float[np.ndarray, " n"]]) -> bool:
    """Return whether values lie in the ranges of their fields.

    Each range is one interval, so only the least and the largest value of a key are checked.

    Args:
        config: the configuration, in which each number is checked alone (`are_checked_alone`).
        columns: values by key.
    """
    for key, values in columns.items():
        *_, (section, rest) = _sections(config, key)
        for extreme in (values.min(), values.max()):
            try:
                changed = put(section, rest, float(extreme))
                type(section).model_validate(changed.model_dump(mode="json"))
            except ValidationError:
                return False
    return True


def are_checked_alone(config: ExperimentConfig, keys: Sequence[str]) -> bool:
    """Return whether only the fields' own checks, and no section's check, use some numbers.

    The checks run with traced numbers: a check that uses one fails.

    Args:
        config: a checked configuration.
        keys: keys of the numbers.
    """

    def check(numbers: list[Array]) -> None:
        changed = put_numbers(config, dict(zip(keys, numbers, strict=True)))
        sections = {id(each): each for key in keys for each, _ in _sections(changed, key)}
        for section in sections.values():
            validators = type(section).__pydantic_decorators__.model_validators
            for name, validator in validators.items():
                # Validators before the fields only rename or complete keys.
                if validator.info.mode == "after":
                    getattr(section, name)()

    try:
        jax.eval_shape(check, [jnp.zeros(())] * len(keys))
    except (jax.errors.JAXTypeError, TypeError):
        return False
    return True


def put_numbers(config: ExperimentConfig, numbers: Mapping[str, Number]) -> ExperimentConfig:
    """Return a configuration with other, unchecked numbers, which may be traced.

    Args:
        config: the configuration.
        numbers: values by key.
    """
    for key, number in numbers.items():
        config = put(config, parts_of(key), number)
    return config


def _sections(place: Any, key: str) -> Iterator[tuple[BaseModel, list[str]]]:
    """Yield the sections around a number, outermost first, with the rest of the key in each."""
    names = list(parts_of(key))
    for i, name in enumerate(names):
        if isinstance(place, BaseModel):
            yield place, names[i:]
        place = inside(place, name)


def _numbers(place: Any, key: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], float]]:
    if isinstance(place, float):
        yield key, place
    elif isinstance(place, (dict, list)):
        parts = place.items() if isinstance(place, dict) else enumerate(place)
        for name, inner in parts:
            if name not in _LONG:
                yield from _numbers(inner, (*key, str(name)))


def _hint(config: ExperimentConfig, key: str) -> str:
    """Return a hint with the most similar keys of numbers: below this key, or by spelling."""
    keys = number_keys(config)
    near = [other for other in keys if other.startswith(f"{key}.")]
    last = key.rsplit(".", 1)[-1]
    near += difflib.get_close_matches(key, keys, n=3, cutoff=0.6)
    near += [other for other in keys if other.rsplit(".", 1)[-1] == last]
    return f"did you mean {', '.join(dict.fromkeys(near[:4]))}?" if near else "see docs/config.md"
