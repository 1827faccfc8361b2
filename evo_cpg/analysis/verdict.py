"""What an audit asks of a champion, and what it says."""

import dataclasses
import difflib
import math
from collections.abc import Sequence
from typing import NamedTuple

from evo_cpg.errors import UserError
from evo_cpg.spatial.numerics import Number, xp

# Where no limit is given: the deepest of all, m, and of an animal's length; and how many lengths an
# animal falls to become as fast as it may be, under the earth's gravity, m/s^2.
_DEEPEST, _DEPTH, _FALL, _GRAVITY = 0.01, 0.02, 20.0, 9.81


@dataclasses.dataclass(frozen=True)
class Limits:
    """What a sound gait stays within.

    Shares of a way are of the one that the champion makes under its own circumstances; energies are
    shares of what its motors put in and take out.

    Attributes:
        half_step: least share of the way at half the physics step.
        quarter_step: likewise at a quarter.
        friction: likewise with 10 % more and less friction.
        drag: likewise with 10 % more and less drag.
        pose: likewise from slightly different poses.
        surface_points: likewise with other points on the surfaces in water.
        precision: likewise in float64.
        other_engine: likewise computed by the other engine.
        limp_way: largest share of the way with motors that do nothing.
        simulator_energy: largest share of energy that no force accounts for, summed over stretches
            of a quarter of a second in which it is a gain.
        push_out_energy: largest share of energy that comes from lifting sunken points out.
        limb_energy: largest share of energy that comes from limbs that push each other apart.
        limit_energy: largest share of energy that comes from joints pushed back to their limits.
        simulator_momentum: largest share of the surroundings' impulses that no force accounts for.
        penetration: deepest of the ground, m; if None 1 cm, or a fiftieth of the animal's length
            where that is less.
        overlap: deepest of two bodies of the animal, m; likewise if None.
        unsolved: largest share of steps whose equations are not solved to 1e-3.
        slipping: largest share of steps whose friction misses its cone by a tenth.
        airborne_way: largest share of the way while nothing touches the ground.
        overload: by which a motor may exceed its torque limit, as a share of it.
        speed: of the root, in lengths of the animal a second; if None that of a fall from twenty
            times its length.
        power: of all motors together, W for each kg of animal; no limit if None.
        free_energy: by which the energy spent may exceed the most that costs fitness, as a share.
        seen_through_ground: largest share of the light seen with ground in the way.
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
        """With what goes by the length of an animal (m) where it is not given."""
        depth = xp.minimum(_DEEPEST, _DEPTH * length)
        found = {
            "penetration": depth,
            "overlap": depth,
            "speed": xp.sqrt(2 * _GRAVITY * _FALL / length),
        }
        missing = {name: each for name, each in found.items() if getattr(self, name) is None}
        return dataclasses.replace(self, **missing)


def limits_from(settings: Sequence[str], limits: Limits = Limits()) -> Limits:
    """Limits with some of them changed.

    Args:
        settings: as on the command line, ``key=value``.
        limits: the others.

    Raises:
        LimitError: a key that does not exist, or a value that is no limit.
    """
    changed = {}
    for setting in settings:
        key, _, text = setting.partition("=")
        known = [field.name for field in dataclasses.fields(Limits)]
        if key not in known:
            near = difflib.get_close_matches(key, known, 1)
            hint = f"did you mean {near[0]}?" if near else f"allowed: {', '.join(known)}"
            raise LimitError(f"{setting}: there is no limit {key!r}; {hint}")
        try:
            # Python's own separator of digits is no number in YAML.
            value = math.nan if "_" in text else float(text)
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and value >= 0):
            raise LimitError(f"{setting}: {text!r} is no limit; allowed: a number of at least 0")
        changed[key] = value
    return dataclasses.replace(limits, **changed)


class LimitError(UserError, ValueError):
    """A limit that does not exist or cannot be."""


class Check(NamedTuple):
    """One question, and its answer.

    Attributes:
        key: of the limit in `Limits`; of what has none, a name of its own.
        question: what was asked.
        measured: the answer.
        limit: what is allowed; None where it is only reported.
        least: whether the limit is the least that is asked for, and not the most.
        unit: of both.
        detail: what else there is to say.
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
        """None where there is nothing to pass."""
        if self.limit is None:
            return None
        if math.isnan(self.measured):
            return False
        return bool(self.measured >= self.limit if self.least else self.measured <= self.limit)

    @property
    def reason(self) -> str:
        """Why it did not pass, in words."""
        bound = "less than" if self.least else "more than"
        return (
            f"{self.question}: {shown(self.measured, self.unit)}, {bound} "
            f"{shown(self.limit, self.unit)}"
        )


class Verdict(NamedTuple):
    """What an audit came to.

    Attributes:
        checks: all of them.
    """

    checks: tuple[Check, ...]

    @property
    def passed(self) -> bool:
        """Whether nothing failed."""
        return all(check.passed is not False for check in self.checks)

    @property
    def reasons(self) -> list[str]:
        """Why it did not pass."""
        return [check.reason for check in self.checks if check.passed is False]


def shown(value: float | None, unit: str = "") -> str:
    """A number with its unit, shares in per cent."""
    if value is None:
        return ""
    if math.isnan(value):
        return "diverged"
    if unit == "%":
        return f"{100 * value:.3g} %"
    return f"{value:.3g} {unit}".rstrip()
