"""Errors about what the user wrote: file, key, value, what is allowed, the nearest valid key."""

import difflib
from collections.abc import Iterable, Sequence
from pathlib import Path

Key = Sequence[str | int]


class ConfigError(Exception):
    """A configuration that cannot be used; the message is for the user as it stands."""

    def __init__(self, source: str | Path, key: Key, problem: str):
        where = f"{source}: {'.'.join(map(str, key))}: " if key else f"{source}: "
        super().__init__(where + problem)


def nearest(word: str, valid: Iterable[str]) -> str:
    """A hint for a word that is not among the valid ones."""
    choices = sorted(valid)
    close = difflib.get_close_matches(word, choices, n=1, cutoff=0.5)
    hint = f"did you mean {close[0]!r}? " if close else ""
    return f"{hint}valid here: {', '.join(choices)}"
