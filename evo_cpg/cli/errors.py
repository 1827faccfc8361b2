"""Errors that are about the command line itself."""

import os
from pathlib import Path

from evo_cpg.errors import UserError


class UsageError(UserError):
    """Input that no other part of the program is responsible for."""


def require_free(output: Path, overwrite: bool) -> None:
    """Check that a file of the user's is not replaced without being told.

    Raises:
        UsageError: it is there.
    """
    # Unlike a path's own method this does not complain of names that no file can have.
    if os.path.exists(output) and not overwrite:
        raise UsageError(f"{output} exists already; --overwrite replaces it")
