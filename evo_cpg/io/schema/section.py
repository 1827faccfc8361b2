"""Base class of every section, and the kinds of numbers."""

import dataclasses
import inspect
import math
import re
from collections.abc import Callable, Iterator
from typing import Annotated, Any, ClassVar, Literal, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    create_model,
    model_serializer,
)
from pydantic_core import PydanticCustomError

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

    def __str__(self) -> str:
        return repr(self)

    def __repr_args__(self) -> Iterator[tuple[str | None, Any]]:
        """Yield the fields that differ from their defaults, with the length of a long list."""
        for name, value in self:
            default = type(self).model_fields[name].get_default(call_default_factory=True)
            if value != default:
                long = isinstance(value, (list, tuple)) and len(value) > _SHOWN
                yield name, _Count(len(value)) if long else value


class DescribedSection(Section):
    """A section with the fields, the defaults and the description of a dataclass (`section_of`)."""

    described: ClassVar[type]

    def build(self) -> Any:
        """Build the dataclass. A null leaves its default."""
        given = {name: value for name, value in self if value is not None and name != "type"}
        return self.described(**given)


def section_of(
    described: type, name: str, kind: str | None = None, default: bool = False, **hints: Any
) -> type[DescribedSection]:
    """Return the section of a dataclass. A default of infinity becomes null.

    Args:
        described: the dataclass.
        name: name of the section.
        kind: value of the section's key ``type``, or None for a section without this key.
        default: whether the key ``type`` may be left out.
        hints: type of each field, with the range of its values.
    """
    fields: dict[str, Any] = {}
    if kind is not None:
        fields["type"] = (Literal[kind], kind if default else ...)
    for field in dataclasses.fields(described):
        usual = ... if field.default is dataclasses.MISSING else field.default
        fields[field.name] = (hints[field.name], None if usual == math.inf else usual)
    made = create_model(name, __base__=DescribedSection, __doc__=described.__doc__, **fields)
    made.described = described
    return made


class _Count(int):
    """The length of a list, printed instead of the list."""

    def __repr__(self) -> str:
        return f"[{int(self)} entries]"


class OpenSection(Section):
    """A section whose keys may all be null, and are not written if null."""

    @model_serializer(mode="wrap")
    def _leave_out(self, write: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        return {name: value for name, value in write(self).items() if value is not None}
