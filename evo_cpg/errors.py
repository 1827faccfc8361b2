"""Base class of all errors about the user's input."""

import difflib
from collections.abc import Iterable


class UserError(Exception):
    """Error about the user's input. Its message is written for the user.

    The command line prints it in place of a traceback and exits with code 2.
    """


def nearest(word: str, valid: Iterable[str]) -> str:
    """Return a hint for an invalid word: the nearest valid word, if any, and all valid words."""
    choices = sorted(valid)
    close = difflib.get_close_matches(word, choices, n=1, cutoff=0.5)
    hint = f"did you mean {close[0]!r}? " if close else ""
    return f"{hint}valid here: {', '.join(choices)}"
