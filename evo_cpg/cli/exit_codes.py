"""With what a command ends, one number for each meaning; docs/cli.md lists them for users."""

from enum import IntEnum


class ExitCode(IntEnum):
    """Other than 0, which says that all was done."""

    FAULT = 1
    """Of the program's own; a job of a sweep, or the search for a rhythm, failed."""

    WRONG_INPUT = 2
    """Of the user's; what is wrong was said."""

    NOT_PASSED = 3
    """What was to be checked was, and is not so: an audit, a verification, a comparison."""

    LOST = 4
    """Another process of the same run."""

    INTERRUPTED = 130
    """By the user, as shells have it."""
