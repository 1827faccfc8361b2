"""Run folders of former versions, whose complete configurations lack newer keys."""

from typing import Any

# Keys that version 1.0 lacked, by section, with the values that give its results.
_SINCE_1_0 = {
    ("world", "water"): {
        "shelter": "facing",
        "viscosity": None,
        "reactive_thrust": False,
        "lift": False,
    }
}

# Keys that version 1.0 lacked, and whose default gives its results.
_SAME_AS_1_0 = {("task",): {"slip_weight": 0.0, "cost_weight": 0.0}}


def with_former_values(data: dict[str, Any]) -> dict[str, Any]:
    """Return the contents of a run's ``config.yaml`` with the keys that version 1.0 lacked."""
    for section, values in _SINCE_1_0.items():
        data = _changed(data, section, lambda found, values=values: values | found)
    return data


def without_former_values(data: dict[str, Any]) -> dict[str, Any]:
    """Return a complete configuration without the keys that mean the same as in version 1.0."""

    def known(found: dict[str, Any], values: dict[str, Any]) -> dict[str, Any]:
        return {k: v for k, v in found.items() if k not in values or values[k] != v}

    for section, values in (*_SINCE_1_0.items(), *_SAME_AS_1_0.items()):
        data = _changed(data, section, lambda found, values=values: known(found, values))
    return data


def _changed(data: Any, section: tuple[str, ...], change: Any) -> Any:
    """Return nested dictionaries with a changed section, or unchanged if there is no section."""
    if not isinstance(data, dict):
        return data
    if not section:
        return change(data)
    first, *rest = section
    if first not in data:
        return data
    return data | {first: _changed(data[first], tuple(rest), change)}
