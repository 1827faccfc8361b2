"""Errors about what the user wrote: file, key, value, what is allowed, the nearest valid key."""

import copyreg
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from evo_cpg.errors import UserError
from evo_cpg.errors import nearest as nearest

Key = Sequence[str | int]


class ConfigError(UserError):
    """A configuration that cannot be used; the message is for the user as it stands.

    Attributes:
        source: file, or what else the value came from.
        key: of the value.
        problem: what is wrong with it.
        line: of the file in which the value stands; None if that is unknown.
    """

    def __init__(self, source: str | Path, key: Key, problem: str, line: int | None = None):
        self.source, self.key, self.problem = source, tuple(key), problem
        self.line = line
        # What a stranger wrote may be of any length.
        where = [_clipped(str(source)), *([] if line is None else [f"line {line}"])]
        where += [_clipped(".".join(map(str, key)))] if key else []
        super().__init__(": ".join([*where, _clipped(problem, 700)]))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the message and what it is made of, as a pool of processes does."""
        return copyreg.__newobj__, (type(self), *self.args), self.__dict__  # type: ignore[attr-defined]


def _clipped(text: str, most: int = 150) -> str:
    """The beginning and the end of a long text."""
    if len(text) <= most:
        return text
    return f"{text[: most // 2]}...{text[-(most // 2) :]}"
