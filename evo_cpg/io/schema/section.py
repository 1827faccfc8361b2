"""Base class of every section, kinds of numbers and names, and sections of several kinds.

A typical range is narrower than the allowed range. It is part of a field's annotation:
``Annotated[NotNegative, TypicalRange(0, 30, ...)]``. `evo_cpg.io.lint` warns of values outside it.
"""

import dataclasses
import importlib
import inspect
import math
import re
import typing
from collections.abc import Callable, Iterator, Mapping
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, TypeVar

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    create_model,
    model_serializer,
)
from pydantic_core import PydanticCustomError

from evo_cpg.io.errors import KeyProblem

_T = TypeVar("_T")

# Largest allowed number. It exceeds any quantity of an animal in SI units. Its square and its cube
# are finite in float32.
LARGEST = 1e12

Positive = Annotated[float, Field(gt=0, le=LARGEST, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, le=LARGEST, allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Finite = Annotated[float, Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
Vector = tuple[Finite, Finite, Finite]
# The limit is far above any practical count, and fits into 32 bits.
Count = Annotated[int, Field(ge=1, le=1_000_000)]


# Longer lists are printed as their number of entries.
_SHOWN = 3


def pattern(expression: str, words: str) -> tuple[AfterValidator, Any]:
    """Return annotations that restrict a text to a regular expression, with an error message."""

    def check(text: str) -> str:
        if not re.fullmatch(expression, text):
            raise PydanticCustomError("pattern", words)  # pyright: ignore[reportArgumentType]
        return text

    return AfterValidator(check), Field(json_schema_extra={"pattern": expression})


class Section(BaseModel):
    """A part of a configuration file, without unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    def into(self, kind: Callable[..., _T], **others: Any) -> _T:
        """Build an object from the fields that its constructor names, and from ``others``."""
        names = inspect.signature(kind).parameters
        return kind(**{name: value for name, value in self if name in names} | others)

    __str__ = BaseModel.__repr__

    def __repr_args__(self) -> Iterator[tuple[str | None, Any]]:
        """Yield the fields that differ from their defaults, with the length of a long list."""
        for name, value in self:
            default = type(self).model_fields[name].get_default(call_default_factory=True)
            if value != default:
                long = isinstance(value, (list, tuple)) and len(value) > _SHOWN
                yield name, _Count(len(value)) if long else value


class DescribedSection(Section):
    """A section with the fields of a dataclass (see `section_of`)."""

    described: ClassVar[type]

    def build(self, **_: Any) -> Any:
        """Build the dataclass. A null leaves its default."""
        given = {name: value for name, value in self if value is not None and name != "type"}
        return self.described(**given)


def section_of(
    described: type,
    name: str,
    module: str,
    kind: str | None = None,
    default: bool = False,
    base: type[Section] = DescribedSection,
    **hints: Any,
) -> type[Section]:
    """Return the section of a dataclass. A default of infinity becomes null.

    Args:
        described: the dataclass.
        name: name of the section.
        module: module that holds the section under this name, so that it can be pickled.
        kind: value of the section's key ``type``, or None for a section without this key.
        default: whether the key ``type`` may be left out.
        base: base class, whose attribute ``described`` becomes the dataclass.
        hints: types of fields, with the range of their values, in place of their own types.
    """
    hints = typing.get_type_hints(described) | hints
    fields: dict[str, Any] = {}
    if kind is not None:
        fields["type"] = (Literal[kind], kind if default else ...)
    for field in dataclasses.fields(described):
        if not field.init:
            continue
        usual = ... if field.default is dataclasses.MISSING else field.default
        if field.default_factory is not dataclasses.MISSING:
            usual = field.default_factory()
        fields[field.name] = (hints[field.name], None if usual == math.inf else usual)
    fields["described"] = (ClassVar[type], described)
    about = {"__doc__": described.__doc__, "__module__": module}
    return create_model(name, __base__=base, **about, **fields)


class _Count(int):
    """The length of a list, printed instead of the list."""

    def __repr__(self) -> str:
        return f"[{int(self)} entries]"


class OpenSection(Section):
    """A section whose keys may all be null, and are not written if null."""

    @model_serializer(mode="wrap")
    def _leave_out(self, write: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        return {name: value for name, value in write(self).items() if value is not None}


# Excludes control characters of ASCII and Latin-1, line separators and direction marks.
_PRINTED = r"[^\x00-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069]"


PrintedName = Annotated[
    str,
    *pattern(f"^{_PRINTED}+$", "must not be empty, but on one line, without control characters"),
]


def _as_read_again(value: Any, place: str = "") -> Any:
    """Return options as a run folder's ``config.yaml`` stores them, so that a run can resume.

    Raises:
        ValueError: a value would not be read back unchanged.
    """
    if value is None or isinstance(value, bool):
        return value
    for kind in (str, int, float):
        if isinstance(value, kind):
            return kind(value)
    inside = f"{place}." if place else ""
    if isinstance(value, (list, tuple)):
        return [_as_read_again(each, f"{inside}{i}") for i, each in enumerate(value)]
    if isinstance(value, dict):
        for key in value:
            if not isinstance(key, str):
                raise ValueError(f"{place} has the key {key!r}. Allowed: text, such as '{key}'")
        return {str(key): _as_read_again(each, f"{inside}{key}") for key, each in value.items()}
    raise ValueError(
        f"{place} is a {type(value).__name__}. Allowed: text, numbers, true, false, null, and "
        "lists and mappings of these"
    )


# Constructor options of a user's own class.
Options = Annotated[dict[str, Any], AfterValidator(_as_read_again)]


class CustomConfig(Section):
    """A class of your own.

    Attributes:
        type: ``my_module:MyClass``.
        options: keyword arguments of its constructor.
    """

    type: Annotated[
        str, *pattern(r"^[\w.]+:\w+$", "must be a module and a class, such as my_module:MyClass")
    ]
    options: Options = Field(default_factory=dict)

    # Nothing is known about the needs of a user's own class. These values pass every check.
    needs_ground: ClassVar[bool] = False
    draws_course: ClassVar[bool] = True
    body_keys: ClassVar[tuple[str, ...]] = ()
    uses_senses: ClassVar[bool] = True
    genome: ClassVar[None] = None

    def instance(self, kind: Any, **about: Any) -> Any:
        """Import the class and build an instance from its options.

        Args:
            kind: required base class.
            about: further keyword arguments. The constructor gets those that are its parameters.

        Raises:
            KeyProblem: the class does not exist, or cannot be built.
        """
        module, _, name = self.type.partition(":")
        try:
            made = getattr(importlib.import_module(module), name)
        except Exception as error:
            # Any error raised here comes from the user's module.
            problem = f"{self.type!r} cannot be imported ({type(error).__name__}: {error})"
            raise KeyProblem(("type",), problem) from None
        if not (isinstance(made, type) and issubclass(made, kind)):
            problem = f"{self.type!r} is not a subclass of {kind.__module__}:{kind.__name__}"
            raise KeyProblem(("type",), problem)
        taken = inspect.signature(made).parameters
        try:
            return made(**self.options, **{name: about[name] for name in about if name in taken})
        except Exception as error:
            # Any error comes from the user's class. The message of a KeyError is only the key.
            known = isinstance(error, (TypeError, ValueError))
            words = f"{error}" if known else f"{type(error).__name__}: {error}"
            problem = f"{self.type} cannot be built with these options ({words})"
            raise KeyProblem(("options",), problem) from None


def by_type(default: str | None) -> Discriminator:
    """Return a discriminator by ``type``, with the tag ``custom`` for a class of your own.

    Args:
        default: kind of a section without ``type``, or None if ``type`` is required.
    """

    def kind(value: Any) -> str | None:
        written = value.get("type", default) if isinstance(value, dict) else None
        given = getattr(value, "type", default) if written is None else written
        if given is None:
            return None
        return "custom" if isinstance(given, str) and ":" in given else str(given)

    return Discriminator(kind)


# A full turn, degrees. Larger angles were probably converted twice.
TURN = 360.0

# Common angles are multiples of the first number, degrees. In radians they are usually written with
# at least two decimals, so their rounding error is less than the second number.
_COMMON, ROUNDING = 15.0, 0.006


class TypicalRange(NamedTuple):
    """Typical range of a number.

    Attributes:
        low: smallest typical value.
        high: largest typical value.
        unit: unit of both limits.
        units: other likely units, with their factors to ``unit``.
        about: sentence with a value to compare with, reported if no other unit fits.
    """

    low: float
    high: float
    unit: str
    units: Mapping[str, float] = {}
    about: str = ""

    def problem(self, value: float) -> str | None:
        """Return a description of what is wrong with a value, or None if it is plausible."""
        if self.low <= value <= self.high:
            return None
        likely = self.about
        for unit, factor in self.units.items():
            if self.low <= value * factor <= self.high:
                likely = f"If it is in {unit}, write {round(value * factor, 3):g}"
                break
        return f"plausible: {self.low:.3g} to {self.high:g} {self.unit}. {likely}"


class Direction(NamedTuple):
    """Mark of a field that holds directions in degrees. Its check finds values in radians."""

    def problem(self, value: float | tuple[float, ...]) -> str | None:
        """Return a description if all angles look like radians, or one exceeds a full turn."""
        given = np.array([angle for angle in np.ravel(value) if angle])
        if not len(given):
            return None
        meant = np.round(np.rad2deg(given) / _COMMON) * _COMMON
        off = np.abs(given - np.deg2rad(meant))
        crooked = given != np.round(given)
        if (np.abs(given) <= 2 * np.pi + ROUNDING).all() and (
            (off < ROUNDING) & (meant != 0) & crooked
        ).all():
            words = ", ".join(f"{angle:g}" for angle in meant)
            return f"in degrees this is hardly a turn. If it is in radians, write {words}"
        if np.abs(given).max() > TURN:
            return (
                f"plausible: -{TURN:g} to {TURN:g} degrees. Was it converted twice? Write degrees"
            )
        return None


# The ranges cover solids from foam to osmium, and liquids from petrol to the Dead Sea.
_DENSITIES = {"g/cm^3": 1000.0, "g/m^3": 1e-3}
SOLID = TypicalRange(20.0, 23_000.0, "kg/m^3", _DENSITIES, "Water has 1000")
LIQUID = TypicalRange(500.0, 2000.0, "kg/m^3", _DENSITIES, "Water has 1000")

# Water at 20 degrees has 0.001 Pa s, and solutions for worms up to some tenths. The kinematic
# viscosity in m^2/s is a thousand times smaller.
VISCOSITY = TypicalRange(1e-4, 0.5, "Pa s", {"mPa s": 1e-3, "m^2/s": 1000.0}, "water has 0.001")

# The strongest gravity of a planet of the sun is 24.8 m/s^2 (Jupiter).
GRAVITY = TypicalRange(0.0, 30.0, "m/s^2", {"cm/s^2": 0.01}, "Earth has 9.81")

# A narrower field of view is a slit, and is probably given in radians.
VIEW = TypicalRange(
    2 * np.pi + ROUNDING, TURN, "degrees", {"radians": np.rad2deg(1.0)}, "A slit sees no light"
)

# Joints of animals and robots turn at up to 20 rad/s, the fastest servos at 60.
RATE = TypicalRange(
    -60.0, 60.0, "rad/s", {"degrees per second": np.deg2rad(1.0)}, "Fast servos reach 60"
)
