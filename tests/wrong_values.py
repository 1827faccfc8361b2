"""A small configuration, and the message about values that are changed in it."""

import pytest
import yaml

from evo_cpg.io.build import build_experiment
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.load import check_config

BOX = "shape: {type: box, size: [0.2, 0.1, 0.1]}, material: flesh"
JOINT = "at: [-0.11, 0, 0], child_at: [0.11, 0, 0]"
SMALL = f"""
name: small
creature:
  name: pair
  materials: {{flesh: {{density: 1000}}}}
  bodies:
    - {{name: head, {BOX}}}
    - {{name: tail, {BOX}, joint: {{parent: head, {JOINT}, axes: [z]}}}}
  light_sensors: [{{body: head}}]
"""


def small(changes: dict[str, object]) -> dict:
    """Return the small configuration with changed values at keys such as ``task.type``."""
    return with_changes(yaml.safe_load(SMALL), changes)


def with_changes(data: dict, changes: dict[str, object]) -> dict:
    """Change the values at some keys of a mapping, and return it."""
    for key, value in changes.items():
        *parents, last = (int(part) if part.isdigit() else part for part in key.split("."))
        place = data
        for part in parents:
            place = place[part] if isinstance(part, int) else place.setdefault(part, {})
        place[last] = value
    return data


def built(changes: dict[str, object]):
    """Return the experiment of the small configuration with changed values."""
    return build_experiment(check_config(small(changes), "x.yaml"), "x.yaml")


def problem(data: dict) -> str:
    """Return the error message for a configuration, which must fit on one line."""
    with pytest.raises(ConfigError) as caught:
        build_experiment(check_config(data, "x.yaml"), "x.yaml")
    message = str(caught.value)
    assert message.startswith("x.yaml: ") and "\n" not in message
    return message.removeprefix("x.yaml: ")
