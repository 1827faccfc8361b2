"""Limits, checks and verdict of an audit."""

import dataclasses
import difflib
import math
from collections.abc import Sequence
from typing import NamedTuple

from evo_cpg.errors import UserError
from evo_cpg.spatial.numerics import Number, xp

# Default limits: depth in m, and as a fraction of the animal's length. The largest speed is the
# speed after a fall from `_FALL` lengths, with the earth's gravity in m/s^2.
_DEEPEST, _DEPTH, _FALL, _GRAVITY = 0.01, 0.02, 20.0, 9.81


# Start of the keys of second opinions, and the smallest fraction of the displacement with which one
# of them confirms a champion.
SECOND_OPINION, _CONFIRMS = "mujoco", 0.5

# First words of every check of the displacement in a changed trial. The name of the change follows.
KEPT = "displacement kept: "


@dataclasses.dataclass(frozen=True)
class Limits:
    """Limits of a sound gait.

    Fractions of the displacement refer to the champion's displacement in its own configuration.
    Fractions of energy refer to the absolute work of its motors.

    Attributes:
        half_step: least fraction of the displacement at half the physics step.
        quarter_step: least fraction at a quarter of the physics step.
        friction: least fraction with 10 % more and less friction.
        drag: least fraction with 10 % more and less drag.
        pose: least fraction from slightly different initial poses.
        surface_points: least fraction with other surface points in water.
        precision: least fraction in float64.
        other_engine: least fraction with the other engine.
        limp_way: largest fraction of the displacement with motors that exert no torque.
        simulator_energy: largest fraction of energy that no force explains, summed over intervals
            of a quarter of a second in which it is a gain.
        push_out_energy: largest fraction of energy from lifting sunken points out of the ground.
        limb_energy: largest fraction of energy from limbs that push each other apart.
        limit_energy: largest fraction of energy from soft limits that push joints back.
        simulator_momentum: largest fraction of the environment's impulses that no force explains.
        penetration: largest penetration of the ground, m, or None for 1 cm or a fiftieth of the
            animal's length, whichever is less.
        overlap: deepest overlap of two bodies, m, or None for the default of ``penetration``.
        unsolved: largest fraction of steps whose equations are not solved to 1e-3.
        slipping: largest fraction of steps whose friction misses its cone by a tenth.
        airborne_way: largest fraction of the displacement without contact with ground or water.
        overload: largest torque of a motor beyond its limit, as a fraction of the limit.
        speed: largest speed of the root, in lengths of the animal per second, or None for the speed
            after a fall from twenty times its length.
        power: largest power of all motors, W for each kg of animal, or None for no limit.
        free_energy: largest excess of the energy spent over the most that costs fitness, as a
            fraction of the latter.
        seen_through_ground: largest fraction of the light seen with ground in the way.
    """

    half_step: float = 0.9
    quarter_step: float = 0.8
    friction: float = 0.5
    drag: float = 0.5
    pose: float = 0.5
    surface_points: float = 0.5
    precision: float = 0.5
    other_engine: float = 0.5
    limp_way: float = 0.1
    simulator_energy: float = 0.1
    push_out_energy: float = 0.05
    limb_energy: float = 0.05
    limit_energy: float = 0.05
    simulator_momentum: float = 0.05
    penetration: float | None = None
    overlap: float | None = None
    unsolved: float = 0.01
    slipping: float = 0.05
    airborne_way: float = 0.5
    overload: float = 0.01
    speed: float | None = None
    power: float | None = None
    free_energy: float = 0.0
    seen_through_ground: float = 0.01

    def of_length(self, length: Number) -> "Limits":
        """Return the limits with defaults that depend on the animal's length (m)."""
        depth = xp.minimum(_DEEPEST, _DEPTH * length)
        found = {
            "penetration": depth,
            "overlap": depth,
            "speed": xp.sqrt(2 * _GRAVITY * _FALL / length),
        }
        missing = {name: each for name, each in found.items() if getattr(self, name) is None}
        return dataclasses.replace(self, **missing)


def limits_from(settings: Sequence[str], limits: Limits = Limits()) -> Limits:
    """Return the limits with some of them changed.

    Args:
        settings: as on the command line, ``key=value``.
        limits: limits to change.

    Raises:
        LimitError: a key does not exist, or a value is negative or not a finite number.
    """
    changed = {}
    for setting in settings:
        key, _, text = setting.partition("=")
        known = [field.name for field in dataclasses.fields(Limits)]
        if key not in known:
            near = difflib.get_close_matches(key, known, 1)
            hint = f"Did you mean {near[0]}?" if near else f"Allowed: {', '.join(known)}"
            raise LimitError(f"{setting}: there is no limit {key!r}. {hint}")
        try:
            # Python accepts 1_000, which is no number in YAML.
            value = math.nan if "_" in text else float(text)
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and value >= 0):
            raise LimitError(f"{setting}: {text!r} is no limit. Allowed: a number of at least 0")
        changed[key] = value
    return dataclasses.replace(limits, **changed)


class LimitError(UserError, ValueError):
    """Error for an unknown limit or an invalid value."""


class Check(NamedTuple):
    """Result of one check.

    Attributes:
        key: key of the limit in `Limits`, or a name of its own.
        question: description of the measured quantity.
        measured: measured value.
        limit: allowed value, or None if the value is only reported.
        least: whether the limit is a minimum, not a maximum.
        unit: unit of value and limit.
        detail: additional text.
    """

    key: str
    question: str
    measured: float
    limit: float | None = None
    least: bool = False
    unit: str = ""
    detail: str = ""

    @property
    def passed(self) -> bool | None:
        """Return whether the check passed, or None without a limit."""
        if self.limit is None:
            return None
        if math.isnan(self.measured):
            return False
        return bool(self.measured >= self.limit if self.least else self.measured <= self.limit)

    @property
    def reason(self) -> str:
        """Text that states the violated limit."""
        bound = "less than" if self.least else "more than"
        return (
            f"{self.question}: {shown(self.measured, self.unit)}, {bound} "
            f"{shown(self.limit, self.unit)}"
        )


class Verdict(NamedTuple):
    """Result of an audit.

    Attributes:
        checks: results of all checks.
    """

    checks: tuple[Check, ...]

    @property
    def passed(self) -> bool:
        """Return whether no check failed."""
        return all(check.passed is not False for check in self.checks)

    @property
    def reasons(self) -> list[str]:
        """Reasons of all failed checks."""
        return [check.reason for check in self.checks if check.passed is False]

    @property
    def confirmed(self) -> bool | None:
        """Return whether any second opinion keeps half of the displacement, or None without any."""
        kept = [check.measured >= _CONFIRMS for check in self._second]
        return any(kept) if kept else None

    @property
    def confirmation(self) -> str:
        """Text after the verdict: the fractions that second opinions keep, or "" without any."""
        words = "second opinions keep these fractions of its displacement"
        if self.confirmed is False:
            words = "not confirmed, because no second opinion keeps half of its displacement"
        kept = [
            f"{check.question.removeprefix(KEPT)} {shown(check.measured, check.unit)}"
            for check in self._second
        ]
        return f"{words}: {'; '.join(kept)}" if kept else ""

    @property
    def _second(self) -> list[Check]:
        return [check for check in self.checks if check.key.startswith(SECOND_OPINION)]


def shown(value: float | None, unit: str = "") -> str:
    """Return a number with its unit as text. Fractions are in per cent, and NaN is "diverged"."""
    if value is None:
        return ""
    if math.isnan(value):
        return "diverged"
    if unit == "%":
        return f"{100 * value:.3g} %"
    return f"{value:.3g} {unit}".rstrip()
