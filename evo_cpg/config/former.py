"""Keys of former versions: run folders without newer keys, and keys with a new name."""

import warnings
from collections.abc import Mapping
from typing import Any

from evo_cpg.config.errors import KeyProblem

# New names of keys, by their former names, which still work.
RENAMED = {"sensory_feedback": "constant_input"}

# Sections of the renamed keys.
_SECTIONS = {"sensory_feedback": ("controller", "cpg")}

# Keys that version 1.0 lacked, by section, with the values that give its results.
_SINCE_1_0 = {
    ("world", "water"): {
        "shelter": "facing",
        "viscosity": None,
        "reactive_thrust": False,
        "lift": False,
    },
    ("controller", "cpg"): {"feedback": None},
}

# Keys that version 1.0 lacked, and whose default gives its results.
_SAME_AS_1_0 = {("task",): {"slip_weight": 0.0, "cost_weight": 0.0}}


class FormerKeyWarning(FutureWarning):
    """Warning about a key with a new name."""


def current_name(place: Any, name: str | int) -> str | int:
    """Return the new name of a key if a mapping or an object has only the new one."""
    new = RENAMED.get(str(name))
    if new is None:
        return name
    known = place if isinstance(place, Mapping) else getattr(place, "__dict__", ())
    return new if name not in known and new in known else name


def newest_key(key: tuple[str, ...]) -> tuple[str, ...]:
    """Return a key of a configuration under its new name."""
    *section, name = key
    return (*section, RENAMED[name]) if _SECTIONS.get(name) == tuple(section) else key


def current_key(key: tuple[str, ...]) -> tuple[str, ...]:
    """Return a key of a configuration under its new name, with a warning if it had another."""
    new = newest_key(key)
    if new == key:
        return key
    _warn(f"{'.'.join(key)} is now called {'.'.join(new)}")
    return new


def use_current_names(data: dict[str, Any]) -> None:
    """Replace the former names of keys in a configuration, in place, with a warning.

    Raises:
        KeyProblem: a key is given under both names.
    """
    for former, section in _SECTIONS.items():
        place: Any = data
        for name in section:
            place = place.get(name) if isinstance(place, dict) else None
        if isinstance(place, dict) and former in place:
            new = current_key((*section, former))[-1]
            if new in place:
                raise KeyProblem((*section, former), f"is given twice, also as {new}")
            place[new] = place.pop(former)
    simulation = data.get("simulation")
    if isinstance(simulation, dict) and {"steps", "seconds"} <= simulation.keys():
        raise KeyProblem(("simulation", "steps"), "is given twice, also as seconds")


def with_seconds(data: dict[str, Any], warns: bool = True) -> dict[str, Any]:
    """Return a configuration in which `seconds` replaces the former number of control steps.

    Call this after all overrides, because the duration depends on the control rate.

    Raises:
        KeyProblem: the number of steps is wrong.
    """
    simulation = data.get("simulation")
    if not isinstance(simulation, dict) or "steps" not in simulation:
        return data
    # Import here, because this module imports JAX, and shell completion reads keys without it.
    from evo_cpg.config.schema.trial import MOST_STEPS, SimulationConfig

    steps = simulation["steps"]
    is_number = isinstance(steps, int | float) and not isinstance(steps, bool)
    if not (is_number and 1 <= steps <= MOST_STEPS and steps == int(steps)):
        raise KeyProblem(
            ("simulation", "steps"),
            f"{repr(steps)[:60]}: must be a whole number of control steps, from 1 to {MOST_STEPS}. "
            "For a duration, set simulation.seconds",
        )
    rest = {key: value for key, value in simulation.items() if key != "steps"}
    rate = rest.get("control_rate_hz", SimulationConfig().control_rate_hz)
    if isinstance(rate, int | float) and rate > 0:
        # The check that follows refuses any other rate.
        rest["seconds"] = steps / rate
        words = f"{steps} control steps are {rest['seconds']:.6g} s"
        if warns:
            _warn(f"simulation.steps is now called simulation.seconds: {words}")
    return data | {"simulation": rest}


def _warn(change: str) -> None:
    words = f"{change}. The former name still works"
    warnings.warn(words, FormerKeyWarning, stacklevel=3)


def _with_name(found: dict[str, Any], old: str, new: str) -> dict[str, Any]:
    """Return a section in which a key, if there is one, has another name."""
    return {new if key == old else key: value for key, value in found.items()}


def with_former_values(data: dict[str, Any]) -> dict[str, Any]:
    """Return the contents of a run's ``config.yaml`` with the keys that version 1.0 lacked."""
    for section, values in _SINCE_1_0.items():
        data = _changed(data, section, lambda found, values=values: values | found)
    for former, section in _SECTIONS.items():
        data = _renamed(data, section, former, RENAMED[former])
    return with_seconds(data, warns=False)


def without_former_values(data: dict[str, Any]) -> dict[str, Any]:
    """Return a complete configuration without the keys that mean the same as in version 1.0."""

    def known(found: dict[str, Any], values: dict[str, Any]) -> dict[str, Any]:
        return {k: v for k, v in found.items() if k not in values or values[k] != v}

    for section, values in (*_SINCE_1_0.items(), *_SAME_AS_1_0.items()):
        data = _changed(data, section, lambda found, values=values: known(found, values))
    for former, section in _SECTIONS.items():
        data = _renamed(data, section, RENAMED[former], former)
    return _changed(data, ("simulation",), _with_steps)


def _with_steps(found: dict[str, Any]) -> dict[str, Any]:
    """Return the section of a trial with the former key for its duration."""
    from evo_cpg.config.schema.trial import SimulationConfig

    if "seconds" not in found:
        return found
    steps = SimulationConfig(**found).steps
    return {key: value for key, value in found.items() if key != "seconds"} | {"steps": steps}


def _renamed(data: dict[str, Any], section: tuple[str, ...], old: str, new: str) -> dict[str, Any]:
    return _changed(data, section, lambda found: _with_name(found, old, new))


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
