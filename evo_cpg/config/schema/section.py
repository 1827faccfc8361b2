"""What every section is made of: its base class and the kinds of numbers."""

import inspect
import re
from collections.abc import Callable, Iterator
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_serializer
from pydantic_core import PydanticCustomError

_T = TypeVar("_T")

# Of no quantity in SI units that animals have to do with; powers of it are still numbers.
LARGEST = 1e12

Positive = Annotated[float, Field(gt=0, le=LARGEST, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, le=LARGEST, allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Finite = Annotated[float, Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
Vector = tuple[Finite, Finite, Finite]
# Far beyond what anybody waits for, and within 32 bits.
Count = Annotated[int, Field(ge=1, le=1_000_000)]


# Entries of a list that are shown where a section is printed.
_SHOWN = 3


def pattern(expression: str, words: str) -> tuple[AfterValidator, Any]:
    """Return what restricts a text to a regular expression, and says in words what is allowed."""

    def check(text: str) -> str:
        if not re.fullmatch(expression, text):
            raise PydanticCustomError("pattern", words)  # pyright: ignore[reportArgumentType]
        return text

    return AfterValidator(check), Field(json_schema_extra={"pattern": expression})


class Section(BaseModel):
    """A part of a configuration file; unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    def into(self, kind: Callable[..., _T], **others: Any) -> _T:
        """Build an object from the fields that its constructor names, and others."""
        names = inspect.signature(kind).parameters
        return kind(**{name: value for name, value in self if name in names} | others)

    def __str__(self) -> str:
        return repr(self)

    def __repr_args__(self) -> Iterator[tuple[str | None, Any]]:
        """Give what differs from its default, and of long lists how long they are."""
        for name, value in self:
            default = type(self).model_fields[name].get_default(call_default_factory=True)
            if value != default:
                long = isinstance(value, (list, tuple)) and len(value) > _SHOWN
                yield name, _Count(len(value)) if long else value


class _Count(int):
    """The length of a list, in the place of the list."""

    def __repr__(self) -> str:
        return f"[{int(self)} entries]"


class OpenSection(Section):
    """A part of which anything may be left open, as null; what is open is not written."""

    @model_serializer(mode="wrap")
    def _leave_out(self, write: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        return {name: value for name, value in write(self).items() if value is not None}
