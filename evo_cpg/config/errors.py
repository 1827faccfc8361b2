"""Errors about what the user wrote: file, key, value, what is allowed, the nearest valid key."""

import copyreg
import difflib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from evo_cpg.errors import UserError

Key = Sequence[str | int]


class ConfigError(UserError):
    """A configuration that cannot be used; the message is for the user as it stands."""

    def __init__(self, source: str | Path, key: Key, problem: str):
        # What a stranger wrote may be of any length.
        where = [_clipped(str(source)), *([_clipped(".".join(map(str, key)))] if key else [])]
        super().__init__(": ".join([*where, _clipped(problem, 700)]))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the message: a pool of processes hands its errors on so."""
        return copyreg.__newobj__, (type(self), *self.args)  # type: ignore[attr-defined]


def _clipped(text: str, most: int = 150) -> str:
    """The beginning and the end of a long text."""
    if len(text) <= most:
        return text
    return f"{text[: most // 2]}...{text[-(most // 2) :]}"


def nearest(word: str, valid: Iterable[str]) -> str:
    """A hint for a word that is not among the valid ones."""
    choices = sorted(valid)
    close = difflib.get_close_matches(word, choices, n=1, cutoff=0.5)
    hint = f"did you mean {close[0]!r}? " if close else ""
    return f"{hint}valid here: {', '.join(choices)}"
