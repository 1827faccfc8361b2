"""Base classes of errors and warnings about the user's input, and hints in their messages."""

import difflib
import re
import warnings
from collections.abc import Iterable, Sequence

# Least likeness of a suggested word, and least length of a part that is compared by itself.
_LIKE, _PART = 0.6, 3


class UserError(Exception):
    """Error about the user's input. Its message is written for the user.

    The command line prints it in place of a traceback and exits with code 2.
    """


class UsageError(UserError, ValueError):
    """Wrong argument of an operation, in Python or on the command line."""


class ClusterError(UserError):
    """A cluster that cannot be joined, or that is lost."""


class Advice(UserWarning):
    """Warning about the user's input or results. The command line prints it as a line."""


def advise(words: str) -> None:
    """Warn the caller of an operation."""
    warnings.warn(words, Advice, stacklevel=3)


def nearest(word: str, valid: Iterable[str]) -> str:
    """Return a hint for an invalid word: the nearest valid word, if any, and all valid words."""
    choices = sorted(valid)
    close = difflib.get_close_matches(word, choices, n=1, cutoff=0.5)
    hint = f"did you mean {close[0]!r}? " if close else ""
    return f"{hint}valid here: {', '.join(choices)}"


def similar(word: str, valid: Iterable[str], most: int = 4) -> list[str]:
    """Return at most `most` valid words that resemble a word, the most similar first.

    A valid word also counts if it contains the word, or if one of its parts resembles the word.
    """
    given = word.lower()

    def likeness(choice: str) -> float:
        if len(given) >= _PART and given in choice:
            return 1.0
        # The parts of "fukui2003_model1" are "fukui", "2003", "model" and "1".
        parts = [part for part in re.findall(r"[a-z]+|[0-9]+", choice) if len(part) >= _PART]
        return max(difflib.SequenceMatcher(None, given, each).ratio() for each in (choice, *parts))

    ranked = sorted(valid, key=lambda each: -likeness(each.lower()))
    return [each for each in ranked[:most] if likeness(each.lower()) >= _LIKE]


def question(words: Sequence[str]) -> str:
    """Return the question whether one of some words was meant, or "" without words."""
    quoted = [f"{word!r}" for word in words]
    listed = " or ".join([part for part in (", ".join(quoted[:-1]), *quoted[-1:]) if part])
    return f"did you mean {listed}?" if words else ""
