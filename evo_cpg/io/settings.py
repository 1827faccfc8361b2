"""Settings of a sweep: values for keys of a configuration, and the name of each setting."""

import itertools
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from evo_cpg.io.errors import ConfigError
from evo_cpg.io.keys import replaces
from evo_cpg.io.load import read_yaml

# Largest number of settings: more than a user would compare.
_MOST = 1000

# Longest name of a folder, in characters.
_LONGEST = 80

Values = Mapping[str, Any]


class Setting(NamedTuple):
    """One of the compared configurations.

    Attributes:
        name: name of the setting and of its run folder.
        values: changed values by key.
    """

    name: str
    values: dict[str, Any]


def read_settings(path: Path) -> dict[str, Values]:
    """Read named settings from a YAML file, ``name: {key: value, ...}``.

    Raises:
        ConfigError: the file cannot be read, or contains something else.
    """
    read = read_yaml(path)
    for name, values in read.items():
        if not isinstance(values, dict) or not all(isinstance(key, str) for key in values):
            raise ConfigError(path, (str(name),), "must be settings, such as {key: value}")
    return {str(name): values for name, values in read.items()}


def combine(grid: Mapping[str, Sequence[Any]], named: Mapping[str, Values]) -> list[Setting]:
    """Return all combinations of the grid with each of the named settings.

    If there are no named settings, the grid is used alone.

    Raises:
        ValueError: there are too many settings, two have the same name, or a key of the grid
            replaces a value of a named setting.
    """
    lasts = [key.rpartition(".")[2] for key in grid]
    # A key whose last part is that of another key is named in full.
    short = {
        key: last if lasts.count(last) == 1 else key for key, last in zip(grid, lasts, strict=True)
    }
    count = math.prod(map(len, grid.values())) * max(1, len(named))
    if count > _MOST:
        raise ValueError(f"a sweep has at most {_MOST} settings, got {count}")
    settings: list[Setting] = []
    for name, values in named.items() or [("", {})]:
        for key, other in itertools.product(grid, values):
            if replaces(key, other):
                raise ValueError(f"the grid's {key} would replace {other} of the setting {name!r}")
        for chosen in itertools.product(*grid.values()):
            point = dict(zip(grid, chosen, strict=True))
            parts = [name] if name else []
            parts += [f"{short[key]}={_word(value)}" for key, value in point.items()]
            folder = re.sub(r"[^\w.,=+-]+", "-", ",".join(parts) or "all").strip("-.,")[:_LONGEST]
            settings.append(Setting(folder, {**values, **point}))
    names = [setting.name for setting in settings]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"two settings would be called {twice[0]!r}. Give them different names")
    return settings


def is_folder_name(text: str) -> bool:
    """Return whether a text can be the name of a setting's run folder, as in `combine`."""
    return re.fullmatch(r"[\w=+][\w.,=+-]*", text) is not None


def _word(value: Any) -> str:
    """Return a value as part of a name. A section is named by its algorithm or type."""
    if isinstance(value, dict):
        known = [value[key] for key in ("algorithm", "type") if key in value]
        value = known[0] if known else value
    if isinstance(value, list):
        return "_".join(map(_word, value))
    return f"{value:g}" if isinstance(value, float) else str(value)
