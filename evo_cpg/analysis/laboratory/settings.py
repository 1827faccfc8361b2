"""Settings of a question: values of knobs, and all their combinations.

A knob is something that an experimenter sets. Knobs of the nerves change the genes of a
`Preparation`. Knobs of the body and the water change numbers of the simulation. A number of the
configuration is a knob, too, under its key.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from evo_cpg.control.preparation import SENSES
from evo_cpg.errors import UserError, nearest

Setting = Mapping[str, Any]
"""Value of each knob."""

NOTHING = "none"
"""Value of a knob of names that changes nothing."""


class LabError(UserError, ValueError):
    """Raised for a question that cannot be asked of this animal."""


class Knob(NamedTuple):
    """Something that an experimenter sets.

    Attributes:
        meaning: meaning of the values, with their unit.
        least: smallest value, or None for names instead of numbers.
        most: largest value.
        unit: unit, or what a pure number counts, for pictures.
    """

    meaning: str
    least: float | None = None
    most: float = float("inf")
    unit: str = ""


_ANY = -float("inf")

# Knobs that replace the brain's signals.
OPEN_LOOP = {
    "u": Knob(
        "tonic input of all oscillators, as a fraction of the largest", 0.0, 1.0, "tonic input"
    ),
    "b": Knob("adaptation gain of all oscillators", 0.0, unit="adaptation gain"),
    "turn": Knob("relative difference between extensor and flexor drive", -1.0, 1.0),
}

NERVES = OPEN_LOOP | {
    "cut": Knob("body in front of whose joint the spinal cord is cut"),
    "behind": Knob(
        "tonic input behind the cut, as a fraction of the largest", 0.0, 1.0, "tonic input"
    ),
    "undriven": Knob("bodies whose oscillators have no drive, as names or patterns"),
    "feedback": Knob("factor of what the spinal cord senses", 0.0, unit="factor"),
    "silence": Knob(f"silenced sense: {', '.join(SENSES)} or all"),
}

BODY = {
    "size": Knob("factor of all lengths", 1e-6, unit="factor"),
    "viscosity": Knob("factor of the water's viscosity", 1e-12, unit="factor"),
    "gravity": Knob("factor of gravity", 0.0, unit="factor"),
    "tow": Knob(
        "speed at which the animal is towed along its heading with its root held, m/s",
        _ANY,
        unit="m/s",
    ),
    "current": Knob(
        "speed of the water against the animal's initial heading, m/s", _ANY, unit="m/s"
    ),
    "passive": Knob("bodies whose joints have no motor, as names or patterns"),
    "stiffness": Knob(
        "stiffness of a spring that is added to every joint, N m/rad", 0.0, unit="N m/rad"
    ),
}

KNOBS = NERVES | BODY

_SECONDS = Knob("duration of each trial, s", 0.1, 1e5, "s")


def combinations(values: Mapping[str, Sequence[Any]], most: int = 10_000) -> list[Setting]:
    """Return all combinations of the values of knobs, the last knob fastest.

    Raises:
        LabError: a knob has no values, or there are too many combinations.
    """
    for name, each in values.items():
        if not len(each):
            raise LabError(f"{name}: no value is given")
    count = 1
    for each in values.values():
        count *= len(each)
    if count > most:
        raise LabError(f"{', '.join(values)}: {count} settings. Allowed: up to {most}")
    return [dict(zip(values, row, strict=True)) for row in itertools.product(*values.values())]


def require_values(values: Mapping[str, Sequence[Any]], seconds: float | None) -> None:
    """Check the names of knobs, and the range of their values. Keys of a configuration pass.

    Raises:
        LabError: a knob is unknown, or a value is not allowed.
    """
    if seconds is not None:
        _require("seconds", _SECONDS, seconds)
    for name, each in values.items():
        knob = KNOBS.get(name)
        if knob is None:
            if "." in name:
                for value in each:
                    _require(name, Knob("number of the configuration", _ANY), value)
                continue
            raise LabError(
                f"{name!r} is no knob: {nearest(name, list(KNOBS))}. A key of the configuration "
                "has a dot, such as world.water.density"
            )
        for value in each:
            _require(name, knob, value)


def _require(name: str, knob: Knob, value: Any) -> None:
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if knob.least is None:
        if is_number or not isinstance(value, str):
            raise LabError(f"{name}={value}: expected a name ({knob.meaning}), got a number")
        return
    if not is_number:
        raise LabError(f"{name}={value}: expected a number ({knob.meaning})")
    if not (knob.least <= value <= knob.most and math.isfinite(value)):
        allowed = f"from {knob.least:g} to {knob.most:g}"
        if knob.most == float("inf"):
            allowed = f"at least {knob.least:g}, finite"
        if knob.least == _ANY:
            allowed = "a finite number"
        raise LabError(f"{name}={value:g}: {knob.meaning}. Allowed: {allowed}")


def worded(setting: Setting) -> str:
    """Return a setting in words, such as ``u=0.5, cut=tail1``."""
    words = (
        f"{name}={value:.3g}" if isinstance(value, float) else f"{name}={value}"
        for name, value in setting.items()
    )
    return ", ".join(words)
