"""Names that a user gives to the parts of a creature."""

import re
from typing import Annotated

from pydantic import AfterValidator, Field

# Excludes control characters of ASCII and Latin-1, line separators and direction marks.
_PRINTED = r"[^\x00-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069]"


def _require_printed(name: str) -> str:
    """Return a name, and raise ValueError if it is empty or contains control characters."""
    if not name:
        raise ValueError("'': must not be empty")
    if not re.fullmatch(f"{_PRINTED}+", name):
        raise ValueError(f"{name!r}: must be on one line, without control characters")
    return name


PrintedName = Annotated[
    str,
    AfterValidator(_require_printed),
    Field(json_schema_extra={"pattern": f"^{_PRINTED}+$"}),
]
