"""What all errors about the user's input have in common."""

import difflib
from collections.abc import Iterable


class UserError(Exception):
    """About what the user gave or asked for; the message is for them as it stands.

    The command line prints it in place of a traceback and exits with code 2.
    """


def nearest(word: str, valid: Iterable[str]) -> str:
    """Return a hint for a word that is not among the valid ones."""
    choices = sorted(valid)
    close = difflib.get_close_matches(word, choices, n=1, cutoff=0.5)
    hint = f"did you mean {close[0]!r}? " if close else ""
    return f"{hint}valid here: {', '.join(choices)}"
